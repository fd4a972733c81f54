//! `sandgait robot`

use super::robot_check::StandingReport;
use super::robot_json::{SandContacts, as_json, geometry, kind};
use sandgait::env::options::RobotName;
use sandgait::error::similar;
use sandgait::robots::{self, Import, InertiaSource, Reading, states};
use sandgait::sim::tree::looks::Looks;
use sandgait::sim::tree::packed;
use sandgait::study::layout::{WIDTH, narrow_table, wrapped};
use sandgait::{Error, Result, sim, view};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Width and height of pictures [px]: our choice, the ratio 4:3 for which the camera chooses its distance.
const PICTURE: [u32; 2] = [960, 720];

/// Read a robot from a URDF, MJCF or TOML file, and print masses, joints, limits, and the shapes that touch sand.
///
/// The list "warnings" has the parts of the file that the simulation leaves out. With --accelerations the command
/// computes accelerations of the rigid bodies in free flight, for comparison with other programs: of the joints only the
/// given torques act, without springs, armature, damping, friction and limits.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait robot go1.urdf
  sandgait robot spot.xml --json
  sandgait robot go1.urdf --picture go1.png --touches FL_foot,FR_foot,RL_foot,RR_foot
  sandgait robot go1.urdf --accelerations states.json
  sandgait robot go1.urdf --pack > go1.json
  sandgait robot go1.urdf --check
  sandgait robot xplorer")]
pub struct RobotArgs {
    /// A file with ending .urdf, .xml (MJCF or URDF), .toml or .json (packed), a name that `sandgait robots` lists, or
    /// NAME=FILE, which lays our pose and gains of the named robot over your file
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Draw the robot in its standing pose, with the plates that touch sand, to this PNG file
    #[arg(long, value_name = "PNG", value_parser = png_path)]
    picture: Option<PathBuf>,
    /// Direction of the picture's camera [°]: the angle from the robot's front to its left; default: from its right front
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, requires = "picture")]
    azimuth_deg: Option<f64>,
    /// Angle of the picture's camera above the horizon [°]
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, requires = "picture")]
    elevation_deg: Option<f64>,
    /// Distance of the picture's camera [m]; default: it fits the robot's size
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, requires = "picture")]
    distance: Option<f64>,
    /// Bodies, links or shapes that touch sand; default: feet, lower links and belly
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    touches: Option<Vec<String>>,
    /// Size of the plates into which touching shapes are cut [m]; default: small enough for forces within 2 %
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    plate_size: Option<f64>,
    /// Print the robot as one text, for option `robot` of sandgait/LeggedVelocity-v1; with --json uncompressed
    #[arg(long, conflicts_with_all = ["picture", "azimuth_deg", "elevation_deg", "distance", "ground", "accelerations"])]
    pack: bool,
    /// Let the robot stand in its default pose for five seconds on hard ground and on sand, and print a sheet; the exit code
    /// is 1 if it does not stand
    #[arg(long, conflicts_with_all = ["pack", "accelerations"])]
    pub check: bool,
    /// Folder in which meshes and packages of the description may lie; may be repeated. Variables: SANDGAIT_PACKAGES,
    /// ROS_PACKAGE_PATH, AMENT_PREFIX_PATH
    #[arg(long, value_name = "FOLDER")]
    packages: Vec<PathBuf>,
    /// `file` keeps inertias that no body can have; `plausible` replaces them by those of the body's shapes
    #[arg(long, value_name = "SOURCE", value_parser = InertiaSource::from_str, default_value = "plausible")]
    inertia: InertiaSource,
    /// Ground of --check besides hard ground: a medium's name, zeta=VALUE or mu=VALUE,rho=VALUE; default: poppy-close
    #[arg(long, value_name = "GROUND", requires = "check")]
    ground: Option<String>,
    /// Print accelerations in free flight for the rows {quat, v, w, q, qd, tau} of this JSON file
    #[arg(long, value_name = "FILE", conflicts_with_all = ["json", "picture", "touches", "plate_size"])]
    accelerations: Option<PathBuf>,
}

/// Refuses a picture whose name promises another format.
fn png_path(text: &str) -> std::result::Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
        true => Ok(path),
        false => Err(format!("{text:?} does not end with .png, the only format")),
    }
}

impl RobotArgs {
    pub fn run(self) -> Result<String> {
        let mut import = load(&self.file, &self.reading())?;
        if let Some(rows) = &self.accelerations {
            let rows = states::compute(&import.as_in_file(), rows)?;
            let rows: Vec<Value> = rows.iter().map(|r| json!({"a": r.a, "alpha": r.alpha, "qdd": r.qdd})).collect();
            return Ok(super::json(&rows.into()));
        }
        match check_walks(&import) {
            Err(e) if !self.pack => import.warnings.insert(0, e.to_string()),
            walks => import.warnings.splice(0..0, walks?.map(|(_, line)| line)).for_each(drop),
        }
        let touching = SandContacts::of(&import, self.touches.as_deref(), self.plate_size)?;
        if let (true, Some(packed)) = (self.pack, &import.packed) {
            return packed.compressed();
        }
        if self.pack {
            let (text, note) = if self.json {
                let (looks, note) = looks(&import);
                (packed::pack(&import.tree, &touching.plates, looks.as_ref())?, note)
            } else {
                compressed(&import, &touching)?
            };
            super::warn(note.as_slice(), "");
            return Ok(text);
        }
        if let Some(path) = &self.picture {
            draw(&import, &touching, None, path, &self.camera()?)?;
        }
        match self.json {
            true => Ok(super::json(&as_json(&import, &touching))),
            false => Ok(as_text(&import, &touching)),
        }
    }
}

impl RobotArgs {
    fn reading(&self) -> Reading {
        Reading { packages: self.packages.clone(), inertia: self.inertia }
    }

    fn camera(&self) -> Result<view::CameraOptions> {
        let Self { azimuth_deg, elevation_deg, distance, .. } = *self;
        view::CameraOptions { azimuth_deg, elevation_deg, distance, fixed: false }.check()
    }

    /// The sheet of `--check`, and whether the robot stands everywhere.
    pub fn run_check(&self) -> Result<(String, bool)> {
        let mut import = load(&self.file, &self.reading())?;
        let step = check_walks(&import)?;
        import.warnings.splice(0..0, step.map(|(_, line)| line));
        let touching = SandContacts::of(&import, self.touches.as_deref(), self.plate_size)?;
        let text = match &import.packed {
            Some(packed) => packed.compressed()?,
            None => compressed(&import, &touching)?.0,
        };
        let sheet = StandingReport::of(&text, self.ground.as_deref())?;
        if let (Some(path), Some(state)) = (&self.picture, sheet.last_state()) {
            draw(&import, &touching, Some(state), path, &self.camera()?)?;
        }
        super::warn(&import.warnings, "`--json` lists them");
        let text = if self.json { super::json(&sheet.json()) } else { sheet.text() };
        Ok((text, sheet.stands()))
    }
}

/// The sheet of `--check` for a robot, as JSON, and notes on its description.
pub fn check(
    robot: &str,
    ground: Option<&str>,
    folders: &[PathBuf],
    reading: &Reading,
) -> Result<(String, Vec<String>)> {
    let Packed { text, notes, .. } = pack(robot, folders, reading)?;
    Ok((StandingReport::of(&text, ground)?.json().to_string(), notes))
}

/// Refuses what is no legged robot, and a robot whose motion cannot be computed. Returns the time step that the motion
/// needs if it is finer than the default, and a line that says so.
fn check_walks(import: &Import) -> Result<Option<(f64, String)>> {
    import.check_legged()?;
    let step = if import.packed.is_some() { None } else { import.needed_step()? };
    Ok(step
        .map(|dt| (dt, format!("the robot's motion needs a time step of {} ms, which is taken (option dt)", 1e3 * dt))))
}

/// Draws the robot in its default pose, or at the end of a check.
fn draw(
    import: &Import,
    touching: &SandContacts,
    state: Option<&sim::State>,
    path: &Path,
    camera: &view::CameraOptions,
) -> Result<()> {
    let caption =
        format!("{}: {:.3} kg, {} joints", import.tree.name, import.tree.mass(), import.tree.joints().count());
    let png = view::tree::draw(&import.tree, &import.seen()?, &touching.plates, state, PICTURE, camera, &[caption])?;
    std::fs::write(path, png).map_err(|e| Error::unwritten(path, &e))
}

/// Replaces a robot's name or file in a task's options by its packed text.
pub fn read_option(options: &mut Value) -> Result<()> {
    let mut taken = |name| options.as_object_mut().and_then(|all| all.remove(name));
    let (packages, inertia) = (packages(taken("packages"))?, inertia(taken("inertia"))?);
    let reading = Reading { packages, inertia };
    let name = options.get("robot").and_then(Value::as_str).filter(|name| is_description(name)).map(str::to_owned);
    let Some(name) = name else {
        check_known(options.get("robot").and_then(Value::as_str))?;
        let of_files = "is for a robot that is read from a file";
        return match (reading.packages.is_empty(), reading.inertia) {
            (false, _) => Err(Error::invalid("packages", of_files)),
            (true, InertiaSource::File) => Err(Error::invalid("inertia", of_files)),
            (true, InertiaSource::Plausible) => Ok(()),
        };
    };
    let Packed { text, notes, dt } = pack(&name, &[], &reading)?;
    super::warn(&notes, &format!("`sandgait robot {name}` lists them"));
    options["robot"] = text.into();
    if let (Some(dt), None) = (dt, options.get("dt")) {
        options["dt"] = dt.into();
    }
    Ok(())
}

/// Refuses a misspelt name of a robot; the task knows only its own robots. Longer texts are robots themselves.
fn check_known(robot: Option<&str>) -> Result<()> {
    let own = [&[SANDCAT][..], &sim::Robot::names()].concat();
    let named: Vec<&str> = robots::named::names().into_iter().filter(|name| !own.contains(name)).collect();
    let unknown =
        |name: &&str| name.len() <= LONGEST_NAME && !name.contains(['.', '/', '=', ' ', '\n']) && !own.contains(name);
    let Some(name) = robot.filter(unknown) else { return Ok(()) };
    let all = [&own[..], &named].concat();
    let meant = similar(name, &all).filter(|meant| named.contains(meant));
    meant.map_or(Ok(()), |_| Err(Error::unknown("robot", name, &[&all[..], &["FILE.urdf", "FILE.xml"]].concat())))
}

/// Longest text that may be a robot's name [bytes]: our choice, longer than all of them and shorter than any packed robot.
const LONGEST_NAME: usize = 60;

/// The option `packages`: a folder, or a list of folders.
fn packages(option: Option<Value>) -> Result<Vec<PathBuf>> {
    let Some(option) = option else { return Ok(Vec::new()) };
    let list = if option.is_string() { vec![option] } else { option.as_array().cloned().unwrap_or_default() };
    let all: Option<Vec<PathBuf>> = list.iter().map(|folder| folder.as_str().map(PathBuf::from)).collect();
    all.filter(|all| !all.is_empty()).ok_or_else(|| Error::invalid("packages", "is no folder, and no list of folders"))
}

/// The option `inertia`.
fn inertia(option: Option<Value>) -> Result<InertiaSource> {
    match option {
        None => Ok(InertiaSource::default()),
        Some(Value::String(name)) => name.parse(),
        Some(other) => Err(Error::unknown("inertia", &other.to_string(), &["plausible", "file"])),
    }
}

/// Does the option `robot` name a description, and not a robot that every server knows?
pub fn is_description(robot: &str) -> bool {
    let file = [".urdf", ".xml", ".mjcf", ".json"].iter().any(|end| robot.ends_with(end));
    let named = robots::named::names().iter().any(|name| robot == *name || robot.starts_with(&format!("{name}=")));
    robot != SANDCAT && (file || named)
}

/// The robot that is the default of LeggedVelocity.
const SANDCAT: &str = RobotName::TREE;

/// A robot as one text, with its meshes cut into plates.
pub struct Packed {
    pub text: String,
    /// Notes on the parts that were left out.
    pub notes: Vec<String>,
    /// The time step that the robot's motion needs [s]; None: the default.
    pub dt: Option<f64>,
}

/// Packs a robot. `robot`: a file, a name, or `name=file`; `folders`: further folders with named robots.
pub fn pack(robot: &str, folders: &[PathBuf], reading: &Reading) -> Result<Packed> {
    let import = robots::named::load_any(robot, folders, reading)?;
    if let Some(packed) = &import.packed {
        return Ok(Packed { text: packed.compressed()?, notes: Vec::new(), dt: None });
    }
    let step = check_walks(&import)?;
    let touching = SandContacts::of(&import, None, None)?;
    let (text, note) = compressed(&import, &touching)?;
    let (dt, line) = step.unzip();
    Ok(Packed { text, notes: line.into_iter().chain(import.warnings).chain(note).collect(), dt })
}

/// The packed text. If shapes for pictures do not fit into it, they are left out, and the note says so.
fn compressed(import: &Import, touching: &SandContacts) -> Result<(String, Option<String>)> {
    let (looks, note) = looks(import);
    let text = |looks| packed::compressed(&packed::pack(&import.tree, &touching.plates, looks)?, touching.count());
    match (&looks, text(looks.as_ref())) {
        (Some(_), Err(_)) => Ok((
            text(None)?,
            Some("its plates use the whole packed text, so pictures show it without its visual meshes".into()),
        )),
        (_, text) => Ok((text?, note)),
    }
}

/// Shapes for pictures. A visual mesh that cannot be read is no error, because the motion does not need it.
fn looks(import: &Import) -> (Option<Looks>, Option<String>) {
    match import.looks() {
        Ok(looks) => (looks, None),
        Err(e) => (None, Some(format!("{e}; pictures show the robot without its visual meshes"))),
    }
}

fn load(file: &Path, reading: &Reading) -> Result<Import> {
    match file.to_str() {
        Some(SANDCAT) => Import::of_packed_text(RobotName::built_in()),
        Some(name) if sim::Robot::names().contains(&name) => Import::built_in(name),
        Some(name) => robots::named::load_any(name, &[], reading),
        None => robots::load_from(file, &Default::default(), reading),
    }
}

/// A number such as `1.5`, or `-` if the file gives none.
fn or_dash(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |v| format!("{v:.4}").trim_end_matches('0').trim_end_matches('.').to_owned())
}

/// Units of the columns of the joints' table, for the kinds of joints that the robot has.
fn joint_units(tree: &sim::tree::Tree) -> Vec<String> {
    const HINGE: [&str; 10] =
        ["rad", "rad", "N·m", "rad/s", "N·m·s/rad", "N·m", "kg·m²", "N·m/rad", "N·m·s/rad", "rad"];
    const SLIDE: [&str; 10] = ["m", "m", "N", "m/s", "N·s/m", "N", "kg", "N/m", "N·s/m", "m"];
    let has = |slides: bool| tree.joints().any(|j| (j.kind == sim::tree::JointKind::Slide) == slides);
    let unit = |(hinge, slide)| match [has(false), has(true)] {
        [true, true] => format!("[{hinge}|{slide}]"),
        [false, true] => format!("[{slide}]"),
        _ => format!("[{hinge}]"),
    };
    let units = HINGE.iter().zip(SLIDE).map(unit);
    [String::new(), String::new()].into_iter().chain(units).collect()
}

/// The legs and the standing height.
fn stance(import: &Import) -> String {
    let (stance, names) = (&import.stance, |bodies: &[usize]| {
        bodies.iter().map(|b| import.tree.bodies[*b].name.as_str()).collect::<Vec<_>>().join(", ")
    });
    let line = format!(
        "{} legs of {:.3} m; the hips stand at {:.3} m; feet: {}",
        stance.legs.len(),
        stance.leg_length,
        stance.hips_height(),
        names(&stance.feet)
    );
    format!("\n{}\n", wrapped(&line, WIDTH).join("\n"))
}

fn as_text(import: &Import, touching: &SandContacts) -> String {
    let tree = &import.tree;
    let mut text = format!(
        "{} ({}): {:.4} kg, {} bodies, {} joints\n\n",
        tree.name,
        import.format.name(),
        tree.mass(),
        tree.bodies.len(),
        tree.joints().count()
    );
    let heads = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    let mut rows = vec![
        heads(&["body", "parent", "mass", "Ixx", "Iyy", "Izz", "shapes", "links"]),
        heads(&["", "", "[kg]", "[kg·m²]", "[kg·m²]", "[kg·m²]", "", ""]),
    ];
    for (b, body) in tree.bodies.iter().enumerate() {
        let parent = if b > 0 { tree.bodies[body.parent].name.clone() } else { "-".into() };
        let mut row = vec![body.name.clone(), parent, or_dash(Some(body.mass))];
        row.extend((0..3).map(|k| format!("{:.3e}", body.inertia[(k, k)])));
        row.extend([body.shapes.len().to_string(), import.links[b].len().to_string()]);
        rows.push(row);
    }
    text.push_str(&narrow_table(&rows, 1));
    let mut rows = vec![
        heads(&[
            "joint", "kind", "lower", "upper", "torque", "speed", "damping", "friction", "armature", "kp", "kd", "rest",
        ]),
        joint_units(tree),
    ];
    for joint in tree.joints() {
        let mut row = vec![joint.name.clone(), kind(joint).to_owned()];
        let [lower, upper] = joint.range.map_or([None; 2], |r| r.map(Some));
        let numbers = [lower, upper, joint.torque_limit, joint.speed_limit, Some(joint.damping), Some(joint.friction)];
        row.extend(numbers.into_iter().chain([Some(joint.armature)]).map(or_dash));
        let found = [&import.found.kp, &import.found.kd, &import.found.rest].map(|all| all[rows.len() - 2]);
        let mark = |(value, found)| format!("{}{}", or_dash(value), if found { "*" } else { "" });
        row.extend([joint.kp, joint.kd, joint.rest].into_iter().zip(found).map(mark));
        rows.push(row);
    }
    text.push('\n');
    text.push_str(&narrow_table(&rows, 2));
    if import.found.any() {
        text.push_str("* found, because the file has none: docs/robots_rules.md, \"Pose and gains\"\n");
    }
    text.push_str(&stance(import));
    let mut rows = vec![heads(&["touches sand", "body", "shape", "area [m²]"])];
    for (b, s) in &touching.shapes {
        let (body, shape) = (&tree.bodies[*b], &tree.bodies[*b].shapes[*s]);
        let (name, _) = geometry(&shape.geometry);
        rows.push(vec![shape.name.clone(), body.name.clone(), name.into(), format!("{:.3e}", shape.geometry.area())]);
    }
    text.push('\n');
    text.push_str(&narrow_table(&rows, 1));
    text.push_str(&format!("{} plates, {:.3e} m²\n", touching.count(), touching.area()));
    if !import.warnings.is_empty() {
        text.push_str("\nwarnings\n");
        let lines = import.warnings.iter().map(|line| wrapped(line, WIDTH - 4).join("\n    "));
        lines.for_each(|line| text.push_str(&format!("  {line}\n")));
    }
    text
}

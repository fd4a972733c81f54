//! Measured steady motions in a folder: `validation.toml` describes them, CSV files have the rows.

use crate::calibrate::pushes::Penetration;
use crate::calibrate::read;
use crate::error::{Error, Result, check_range};
use crate::sand::SandDescription;
use crate::sand::intruder::{BodyShape, DepthOrLoad, PlatedBody, Trial};
use crate::table::{self, HeaderColumn, Quantity, ReadOptions};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The two wheels and their sands, included in the program.
const OWN: [(&str, &str); 6] = [
    ("validation.toml", include_str!("../../tests/data/real_wheel/validation.toml")),
    ("wheel_smooth.csv", include_str!("../../tests/data/real_wheel/wheel_smooth.csv")),
    ("wheel_grouser.csv", include_str!("../../tests/data/real_wheel/wheel_grouser.csv")),
    ("sand_discs.toml", include_str!("../../tests/data/real_wheel/sand_discs.toml")),
    ("sand_smooth.toml", include_str!("../../tests/data/real_wheel/sand_smooth.toml")),
    ("sand_grouser.toml", include_str!("../../tests/data/real_wheel/sand_grouser.toml")),
];

const OWN_DISCS: &str = include_str!("../../tests/data/real_wheel/discs.csv");

/// The discs that were pushed into the wheels' sand, included in the program.
pub fn own_discs() -> Result<Vec<Penetration>> {
    let tests = read::parse(Path::new("discs.csv"), OWN_DISCS.as_bytes(), BTreeMap::new(), crate::calibrate::PLATE)?;
    Ok(tests.pushes)
}

/// Largest number of rows of a folder: our choice, because it bounds the time of a comparison.
const MOST_ROWS: usize = 20_000;

/// `validation.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    title: String,
    source: String,
    licence: String,
    /// Rows at larger slip angles than this do not count in the score [°].
    most_slip_angle_deg: f64,
    intruder: Vec<IntruderDescription>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct IntruderDescription {
    name: String,
    body: String,
    rows: PathBuf,
    /// File of the sand that was calibrated without these rows.
    sand: PathBuf,
    /// File of the sand that was fitted to these rows, if there is one.
    fitted: Option<PathBuf>,
    /// Does the wheel carry sand between its grousers?
    #[serde(default)]
    carries_sand: bool,
}

/// One measured steady state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteadyState {
    pub trial: Trial,
    /// Depth of the lowest point [m].
    pub depth: f64,
    /// Forces on the wheel [N].
    pub force: [f64; 3],
    /// Angle between the wheel's heading and its velocity [°].
    pub slip_angle: f64,
    /// Slip ratio: positive when the wheel spins, −1 when it is locked.
    pub slip: f64,
}

impl SteadyState {
    /// The condition of this row; all rows of a condition have the same slip angle and slip ratio.
    pub fn condition(&self) -> (i64, i64) {
        ((self.slip_angle).round() as i64, (self.slip * 10.0).round() as i64)
    }
}

/// A wheel and its measurements.
#[derive(Clone, Debug)]
pub struct Wheel {
    pub name: String,
    pub body: PlatedBody,
    pub shape: String,
    pub rows: Vec<SteadyState>,
    pub sand: SandDescription,
    pub fitted: Option<SandDescription>,
    pub carries_sand: bool,
}

/// All data of a folder.
#[derive(Clone, Debug)]
pub struct DataSet {
    pub title: String,
    pub source: String,
    pub licence: String,
    pub wheels: Vec<Wheel>,
}

/// The measurements that come with the program.
pub fn own() -> Result<DataSet> {
    gather(Path::new(""), PlatedBody::MOST_PLATES, &|file| {
        let found = OWN.iter().find(|(name, _)| Path::new(name) == file);
        found.map(|(_, text)| text.as_bytes().to_vec()).ok_or_else(|| Error::file(file, "is not compiled in"))
    })
}

/// The description of a folder.
pub const DESCRIPTION: &str = "validation.toml";

fn description(folder: &Path, text: &str) -> Result<Description> {
    toml::from_str(text).map_err(|e| Error::file(&folder.join(DESCRIPTION), e.message()))
}

/// The files in `folder` that the `text` of its description names.
pub fn named_files(folder: &Path, text: &str) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for one in description(folder, text)?.intruder {
        all.extend([one.rows, one.sand].into_iter().chain(one.fitted));
        if let BodyShape::Mesh(file) = BodyShape::named(&one.body)? {
            all.push(file);
        }
    }
    Ok(all)
}

/// A folder of the user; `read` gives the contents of its files. The bodies have at most `most_plates` together.
pub fn gather(folder: &Path, most_plates: usize, read: &dyn Fn(&Path) -> Result<Vec<u8>>) -> Result<DataSet> {
    let text =
        |file: &Path| String::from_utf8(read(file)?).map_err(|_| Error::file(&folder.join(file), "not UTF-8 text"));
    let description = description(folder, &text(Path::new(DESCRIPTION))?)?;
    let sand = |file: &Path| SandDescription::from_toml(&text(file)?).map_err(|e| Error::file(&folder.join(file), e));
    let mut wheels: Vec<Wheel> = Vec::new();
    let [mut plates, mut count] = [0, 0];
    for one in description.intruder {
        let most = most_plates - plates;
        let body = match BodyShape::named(&one.body)? {
            BodyShape::Mesh(file) => PlatedBody::of_mesh(&folder.join(&file), &read(&file)?, None, most)?,
            shape => PlatedBody::cut_within(&shape, None, most)?,
        };
        let rows = rows(&folder.join(&one.rows), &text(&one.rows)?, description.most_slip_angle_deg)?;
        (plates, count) = (plates + body.plates.len(), count + rows.len());
        if count > MOST_ROWS {
            return Err(Error::file(&folder.join(&one.rows), format!("more than {MOST_ROWS} rows with those before")));
        }
        wheels.push(Wheel {
            name: one.name,
            body,
            shape: one.body,
            rows,
            sand: sand(&one.sand)?,
            fitted: one.fitted.as_deref().map(sand).transpose()?,
            carries_sand: one.carries_sand,
        });
    }
    if wheels.is_empty() {
        return Err(Error::file(&folder.join(DESCRIPTION), "no [[intruder]]"));
    }
    Ok(DataSet { title: description.title, source: description.source, licence: description.licence, wheels })
}

fn rows(path: &Path, text: &str, most_slip_angle: f64) -> Result<Vec<SteadyState>> {
    const COLUMNS: [HeaderColumn; 9] = [
        HeaderColumn::needed("vx", Quantity::Speed),
        HeaderColumn::needed("vy", Quantity::Speed),
        HeaderColumn::needed("wy", Quantity::AngularSpeed),
        HeaderColumn::needed("depth", Quantity::Length),
        HeaderColumn::needed("Fx", Quantity::Force),
        HeaderColumn::needed("Fy", Quantity::Force),
        HeaderColumn::needed("Fz", Quantity::Force),
        HeaderColumn::needed("slip_angle_deg", Quantity::Degrees),
        HeaderColumn::needed("slip", Quantity::Number),
    ];
    let mut all = Vec::new();
    table::parse(
        path,
        text.as_bytes(),
        &ReadOptions { most_rows: Some(MOST_ROWS), ..ReadOptions::new(&COLUMNS) },
        |row| {
            let mut x = [0.0; 9];
            for (k, value) in x.iter_mut().enumerate() {
                *value = row.needed(k)?;
            }
            let [vx, vy, wy, depth, fx, fy, fz, slip_angle, slip] = x;
            check_range("Fz", fz, 1e-6..=1e6).map_err(|e| row.error(6, e))?;
            let trial = Trial { velocity: [vx, vy, 0.0], spin: [0.0, wy, 0.0], given: DepthOrLoad::Depth(depth) };
            let trial = trial.validated().map_err(|e| Error::file(path, format!("row {}: {e}", row.line)))?;
            if slip_angle.abs() <= most_slip_angle {
                all.push(SteadyState { trial, depth, force: [fx, fy, fz], slip_angle, slip });
            }
            Ok(())
        },
    )?;
    if all.is_empty() { Err(Error::file(path, "no row is to be scored")) } else { Ok(all) }
}

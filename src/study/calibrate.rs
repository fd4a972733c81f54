//! `calibrate`: the scale of a user's sand from slow penetrations.

use super::arguments::{InputPath, OutputPath};
use super::declare::{Study, StudyWork};
use super::inputs::{Inputs, SENT_TABLE};
use super::result::{StudyColumn, StudyFile, StudyResult, StudyTable};
use crate::error::{Error, Result};
use crate::sand::{Law, SandDescription};
use sandgait_calibrate::pushes::{self, Penetration, Pushes, Value};
use sandgait_calibrate::read::{self, Tests};
use sandgait_calibrate::{Calibration, PLATE, figure};
use std::path::Path;

/// Memory of the readings as a multiple of their text: a reading of four characters is two numbers, read, sorted into pushes and
/// compared.
const COPIES: usize = 16;

/// Measure the scale ζ of your sand with slow vertical penetrations of a horizontal plate.
///
/// A file has columns depth (downward from the surface) and force (upward on the plate): a log, or ten readings by
/// hand. They are recorded on the way down at less than 0.5 m/s. The header has the units, for example "depth
/// [mm],force [N]", or the options have them; without either they are m and N. Prints ζ, for --medium zeta=VALUE of
/// every command, and ξ_n of agarwal2023, with 95 % confidence intervals. With --out it writes a sand.toml.
///
/// Three or more pushes in beds that were prepared anew are better than one: only then does the interval contain the
/// scatter between pushes. Give one file for each push, or one file with a column trial. Pushes of several sizes
/// (column diameter, or length and width) show how the resistance grows with size. Prints the law of depth and size
/// that fits, its errors for a push and for a size that its fit did not use, the repeatability of pushes, the
/// compliance of the rig, and the limits of the calibration.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait calibrate push.csv --area 0.00095 --out sand.toml
  sandgait calibrate first.csv second.csv third.csv --out sand.toml
  sandgait calibrate push.csv --depth-unit mm --plot push.svg
  sandgait calibrate discs.csv                                     (columns trial, diameter, depth, force)
  sandgait calibrate discs.csv --compliance 5e-5")]
pub struct Calibrate {
    /// CSV with columns depth and force; of several files each is one push
    #[arg(required = true, value_name = "FILE")]
    data: Vec<InputPath>,
    /// Area of the plate [m²]; default: 3.8 × 2.5 cm, the plate of Li et al. 2012
    #[arg(long, value_name = "M2")]
    area: Option<f64>,
    /// Unit of the depths: m, cm, mm or in
    #[arg(long)]
    depth_unit: Option<String>,
    /// Unit of the forces: N, mN, kN, gf, kgf or lbf
    #[arg(long)]
    force_unit: Option<String>,
    /// Write the sand to this file, for --sand of other commands and option sand of the tasks
    #[arg(long, value_name = "FILE")]
    out: Option<OutputPath>,
    /// Draw the test and the fitted line to this SVG file
    #[arg(long, value_name = "FILE")]
    plot: Option<OutputPath>,
    /// Compliance of the rig for several pushes [m/N]; default: it is fitted
    #[arg(long, value_name = "M_PER_N")]
    compliance: Option<f64>,
}

impl Study for Calibrate {
    const NAME: &'static str = "calibrate";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        self.data.iter().try_for_each(|file| inputs.read(&file.0))
    }

    fn cost(&self, inputs: &Inputs) -> usize {
        self.data.iter().filter_map(|file| inputs.bytes(&file.0, SENT_TABLE).ok()).map(|text| COPIES * text.len()).sum()
    }

    fn next(&self) -> Option<String> {
        Some(match &self.out {
            Some(file) => format!("to learn on this sand: sandgait train --option sand={}", file.0),
            None => "to keep it: the same command with --out sand.toml".into(),
        })
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        if self.plot.as_ref().is_some_and(|plot| Path::new(&plot.0).extension().is_none_or(|end| end != "svg")) {
            return Err(Error::invalid("--plot", "give a file name that ends in .svg"));
        }
        let tests = self.data.iter().map(|file| self.tests(&file.0, inputs)).collect::<Result<Vec<_>>>()?;
        Ok(StudyWork::new(move |_| match &tests[..] {
            [one] if one.pushes.is_empty() => self.single(one),
            [one] => self.compare(&one.pushes),
            several => self.compare(&self.each(several)?),
        }))
    }
}

impl Calibrate {
    fn tests(&self, file: &str, inputs: &Inputs) -> Result<Tests> {
        let units = [("depth", self.depth_unit.clone()), ("force", self.force_unit.clone())];
        let units = units.into_iter().filter_map(|(name, unit)| Some((name.to_owned(), unit?)));
        let tests =
            read::parse(Path::new(file), inputs.bytes(file, SENT_TABLE)?, units.collect(), self.area.unwrap_or(PLATE))?;
        if self.area.is_some() && !tests.pushes.is_empty() && !tests.without_size {
            let reason = "the pushes have their sizes in columns diameter, or length and width";
            return Err(Error::invalid("--area", reason));
        }
        Ok(tests)
    }

    /// One push for each file.
    fn each(&self, tests: &[Tests]) -> Result<Vec<Penetration>> {
        let diameter = read::diameter(self.area.unwrap_or(PLATE));
        let push = |(test, InputPath(file)): (&Tests, &InputPath)| {
            if !test.pushes.is_empty() {
                return Err(Error::file(Path::new(file), "of several files each is one push, without a column trial"));
            }
            let points = test.depth.iter().zip(&test.force).map(|(z, f)| [*z, *f]).collect();
            Ok(Penetration { name: file.clone(), diameter, points, speeds: None })
        };
        tests.iter().zip(&self.data).map(push).collect()
    }

    fn single(&self, test: &Tests) -> Result<StudyResult> {
        if self.compliance.is_some() {
            return Err(Error::invalid("--compliance", "it needs several pushes: several files, or a column trial"));
        }
        let found = sandgait_calibrate::calibrate(&test.depth, &test.force, self.area.unwrap_or(PLATE))?;
        let interval = found.zeta_interval.map(|zeta| format!("{zeta:.4}")).join(" to ");
        let words = format!("one push; 95 % confidence {interval} N/cm³, without the scatter between pushes");
        let mut named_files = self.sand(found.zeta, 0.0, &words)?;
        named_files.extend(
            self.plot
                .iter()
                .map(|OutputPath(name)| StudyFile::new(name, figure::single(&test.depth, &test.force, &found).svg())),
        );
        let columns = StudyColumn::of_rows::<Calibration>(
            std::slice::from_ref(&found),
            &[
                ("zeta", "N/cm³", |c| c.zeta),
                ("zeta_low", "N/cm³", |c| c.zeta_interval[0]),
                ("zeta_high", "N/cm³", |c| c.zeta_interval[1]),
                ("xi_n", "N/cm³", |c| c.xi_n),
                ("xi_n_low", "N/cm³", |c| c.xi_n_interval[0]),
                ("xi_n_high", "N/cm³", |c| c.xi_n_interval[1]),
                ("r_squared", "1", |c| c.r_squared),
                ("surface_offset", "m", |c| c.surface_offset),
                ("samples", "1", |c| c.samples as f64),
                ("area", "m²", |c| c.area),
            ],
        );
        Ok(StudyResult {
            summary: describe(&found, self.area.is_none()) + &self.told(),
            warnings: found.cautions.clone(),
            about: object(&found),
            named_files,
            ..StudyResult::table(StudyTable::new("calibration", columns))
        })
    }

    fn compare(&self, pushes: &[Penetration]) -> Result<StudyResult> {
        let found = pushes::compare(pushes, self.compliance)?;
        let mut named_files = Vec::new();
        if let Some(size) = found.sizes.first() {
            let (zeta, power) = found.sand(size);
            let scatter = size.zeta_interval.map_or_else(
                || "one push of this size".to_owned(),
                |[low, high]| format!("95 % confidence {low:.4} to {high:.4} N/cm³ from {} pushes", size.pushes),
            );
            let words = format!("{:.1} mm, law {}; {scatter}", 1e3 * size.diameter, found.law.formula());
            named_files = self.sand(zeta, power, &words)?;
        }
        let svg = |OutputPath(name): &OutputPath| StudyFile::new(name, figure::several(pushes, &found).svg());
        named_files.extend(self.plot.iter().map(svg));
        Ok(StudyResult {
            summary: describe_several(&found) + &self.told(),
            warnings: found.cautions.clone(),
            about: object(&found),
            tables: vec![sizes(&found), laws(&found)],
            named_files,
            ..StudyResult::default()
        })
    }

    /// The sand as a file, if a name is given for it.
    fn sand(&self, zeta: f64, depth_power: f64, words: &str) -> Result<Vec<StudyFile>> {
        let Some(OutputPath(name)) = &self.out else { return Ok(Vec::new()) };
        let mut sand = SandDescription::named(&format!("zeta={zeta}"), Law::Li2013.name())?;
        let files = self.data.iter().map(|file| file.0.as_str()).collect::<Vec<_>>().join(", ");
        sand.name = format!("zeta={zeta:.4}");
        sand.source = format!("sandgait calibrate {files}: {words}");
        sand.mechanisms.depth_power = depth_power;
        sand.mechanisms.validated()?;
        Ok(vec![StudyFile::new(name, sand.to_toml()?)])
    }

    /// Where the sand is.
    fn told(&self) -> String {
        match &self.out {
            Some(OutputPath(path)) => format!("the sand is in {path}, for --sand and option sand\n"),
            None => "--out sand.toml writes it to a file\n".into(),
        }
    }
}

/// A result as a JSON object.
fn object(found: &impl serde::Serialize) -> serde_json::Map<String, serde_json::Value> {
    serde_json::to_value(found).ok().and_then(|value| value.as_object().cloned()).unwrap_or_default()
}

fn sizes(found: &Pushes) -> StudyTable {
    let end = |size: &pushes::OfSize, k: usize| size.zeta_interval.map_or(f64::NAN, |ends| ends[k]);
    let columns = StudyColumn::of_rows::<pushes::OfSize>(
        &found.sizes,
        &[
            ("diameter", "m", |s| s.diameter),
            ("pushes", "1", |s| s.pushes as f64),
            ("zeta", "N/cm³", |s| s.zeta),
            ("repeatability_percent", "%", |s| s.repeatability_percent.unwrap_or(f64::NAN)),
        ],
    );
    let ends = [("zeta_low", 0), ("zeta_high", 1)];
    let ends = ends.map(|(name, k)| StudyColumn::numbers(name, "N/cm³", found.sizes.iter().map(|s| end(s, k))));
    StudyTable::new("sizes", columns.into_iter().chain(ends).collect())
}

fn laws(found: &Pushes) -> StudyTable {
    let formula = StudyColumn::names("formula", found.laws.iter().map(|law| law.formula));
    let errors = StudyColumn::of_rows::<pushes::LawScore>(
        &found.laws,
        &[
            ("fitted_percent", "%", |l| l.fitted_percent),
            ("other_push_percent", "%", |l| l.other_push_percent),
            ("other_size_percent", "%", |l| l.other_size_percent.unwrap_or(f64::NAN)),
        ],
    );
    StudyTable::new("laws", std::iter::once(formula).chain(errors).collect())
}

fn describe_several(study: &Pushes) -> String {
    let mut text = String::from("size       pushes  zeta [N/cm3]  95 % confidence   repeats within\n");
    for size in &study.sizes {
        let repeats = size.repeatability_percent.map_or("-".into(), |r| format!("{r:.1} %"));
        let interval = size.zeta_interval.map_or("-".into(), |[low, high]| format!("{low:.4} to {high:.4}"));
        let (mm, zeta) = (1e3 * size.diameter, size.zeta);
        text += &format!("{mm:6.1} mm  {:6}  {zeta:12.4}  {interval:16}  {repeats}\n", size.pushes);
    }
    text += "\nlaw                    fitted  another push  another size\n";
    for s in &study.laws {
        let size = s.other_size_percent.map_or("-".into(), |p| format!("{p:.1} %"));
        let mark = if s.law == study.law { "  <- take this one" } else { "" };
        text +=
            &format!("{:21} {:6.1} % {:11.1} % {size:>13}{mark}\n", s.formula, s.fitted_percent, s.other_push_percent);
    }
    let value = |name: &str, v: &Value| {
        format!("{name} {:.3}, 95 % confidence {:.3} to {:.3}\n", v.value, v.interval[0], v.interval[1])
    };
    text += &format!("\n{}", value("power of depth", &study.depth_exponent));
    if let Some(size) = &study.size_exponent {
        text += &value("power of size ", size);
    }
    let mm = |x: f64| 1e3 * x;
    let c = &study.compliance;
    text += &format!(
        "the rig gives way by {:.3} mm/N, 95 % confidence {:.3} to {:.3}\n",
        mm(c.value),
        mm(c.interval[0]),
        mm(c.interval[1])
    );
    if let Some(nearest) = study.sizes.first() {
        text += &format!(
            "for the size of your robot's feet, e.g. {:.0} mm: --medium zeta={:.4}\n",
            1e3 * nearest.diameter,
            nearest.zeta
        );
    }
    text
}

fn describe(c: &Calibration, assumed: bool) -> String {
    let line = |name: &str, value: f64, [low, high]: [f64; 2]| {
        format!("{name} {value:.4} N/cm³, 95 % confidence {low:.4} to {high:.4}\n")
    };
    let plate = if assumed { " (the plate of Li et al. 2012; give --area if yours differs)" } else { "" };
    format!(
        "{}{}{} samples, r² {:.3}, plate {:.2} cm²{plate}\n\
         one push: the intervals do not contain the scatter between pushes; give the files of three or more\n\
         use it as --medium zeta={:.4}\n",
        line("ζ  ", c.zeta, c.zeta_interval),
        line("ξ_n", c.xi_n, c.xi_n_interval),
        c.samples,
        c.r_squared,
        c.area * 1e4,
        c.zeta,
    )
}

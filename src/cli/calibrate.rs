//! `sandgait calibrate`

use sandgait::calibrate::pushes::{self, Penetration, Pushes, Value};
use sandgait::calibrate::read::{self, Tests};
use sandgait::calibrate::{self, Calibration, PLATE, figure};
use sandgait::files;
use sandgait::sand::{Law, SandDescription};
use sandgait::{Error, Result};
use std::path::{Path, PathBuf};

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
pub struct CalibrateArgs {
    /// CSV with columns depth and force; of several files each is one push
    #[arg(required = true, value_name = "FILE")]
    data: Vec<PathBuf>,
    /// Area of the plate [m²]; default: 3.8 × 2.5 cm, the plate of Li et al. 2012
    #[arg(long, value_name = "M2", allow_negative_numbers = true)]
    area: Option<f64>,
    /// Unit of the depths: m, cm, mm or in
    #[arg(long)]
    depth_unit: Option<String>,
    /// Unit of the forces: N, mN, kN, gf, kgf or lbf
    #[arg(long)]
    force_unit: Option<String>,
    /// Write the sand to this file, for --sand of other commands and option sand of the tasks
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Draw the test and the fitted line to this SVG file
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Compliance of the rig for several pushes [m/N]; default: it is fitted
    #[arg(long, value_name = "M_PER_N", allow_negative_numbers = true)]
    compliance: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl CalibrateArgs {
    pub fn run(self) -> Result<String> {
        if self.plot.as_ref().is_some_and(|p| p.extension().is_none_or(|e| e != "svg")) {
            return Err(Error::invalid("--plot", "give a file name that ends in .svg"));
        }
        let tests = self.data.iter().map(|file| self.read(file)).collect::<Result<Vec<_>>>()?;
        match &tests[..] {
            [one] if one.pushes.is_empty() => self.single(one),
            [one] => self.compare(&one.pushes),
            several => self.compare(&self.each(several)?),
        }
    }

    fn read(&self, file: &Path) -> Result<Tests> {
        let units = [("depth", self.depth_unit.clone()), ("force", self.force_unit.clone())];
        let units = units.into_iter().filter_map(|(name, unit)| Some((name.to_owned(), unit?)));
        let tests = read::file(file, units.collect(), self.area.unwrap_or(PLATE))?;
        if self.area.is_some() && !tests.pushes.is_empty() && !tests.without_size {
            let reason = "the pushes have their sizes in columns diameter, or length and width";
            return Err(Error::invalid("--area", reason));
        }
        Ok(tests)
    }

    /// One push for each file.
    fn each(&self, tests: &[Tests]) -> Result<Vec<Penetration>> {
        let diameter = read::diameter(self.area.unwrap_or(PLATE));
        let push = |(test, file): (&Tests, &PathBuf)| {
            if !test.pushes.is_empty() {
                return Err(Error::file(file, "of several files each is one push, without a column trial"));
            }
            let points = test.depth.iter().zip(&test.force).map(|(z, f)| [*z, *f]).collect();
            Ok(Penetration { name: file.display().to_string(), diameter, points, speeds: None })
        };
        tests.iter().zip(&self.data).map(push).collect()
    }

    fn single(&self, test: &Tests) -> Result<String> {
        if self.compliance.is_some() {
            return Err(Error::invalid("--compliance", "it needs several pushes: several files, or a column trial"));
        }
        let result = calibrate::calibrate(&test.depth, &test.force, self.area.unwrap_or(PLATE))?;
        let interval = result.zeta_interval.map(|zeta| format!("{zeta:.4}")).join(" to ");
        let words = format!("one push; 95 % confidence {interval} N/cm³, without the scatter between pushes");
        self.write(result.zeta, 0.0, &words)?;
        if let Some(path) = &self.plot {
            figure::single(&test.depth, &test.force, &result).write(path)?;
        }
        for caution in &result.cautions {
            eprintln!("sandgait: warning: {caution}");
        }
        Ok(match self.json {
            true => super::json(&serde_json::to_value(&result).unwrap_or_default()),
            false => describe(&result, self.area.is_none()) + &self.told(),
        })
    }

    fn compare(&self, pushes: &[Penetration]) -> Result<String> {
        let study = pushes::compare(pushes, self.compliance)?;
        if let Some(size) = study.sizes.first() {
            let (zeta, power) = study.sand(size);
            let scatter = size.zeta_interval.map_or_else(
                || "one push of this size".to_owned(),
                |[low, high]| format!("95 % confidence {low:.4} to {high:.4} N/cm³ from {} pushes", size.pushes),
            );
            let words = format!("{:.1} mm, law {}; {scatter}", 1e3 * size.diameter, study.law.formula());
            self.write(zeta, power, &words)?;
        }
        if let Some(path) = &self.plot {
            figure::several(pushes, &study).write(path)?;
        }
        for caution in &study.cautions {
            eprintln!("sandgait: warning: {caution}");
        }
        Ok(match self.json {
            true => super::json(&serde_json::to_value(&study).unwrap_or_default()),
            false => describe_several(&study) + &self.told(),
        })
    }

    /// Writes the sand, if a file is given for it.
    fn write(&self, zeta: f64, depth_power: f64, words: &str) -> Result<()> {
        let Some(path) = &self.out else { return Ok(()) };
        let mut sand = SandDescription::named(&format!("zeta={zeta}"), Law::Li2013.name())?;
        let files = self.data.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ");
        sand.name = format!("zeta={zeta:.4}");
        sand.source = format!("sandgait calibrate {files}: {words}");
        sand.mechanisms.depth_power = depth_power;
        sand.mechanisms.validated()?;
        files::write(path, sand.to_toml()?.as_bytes())
    }

    /// Where the sand is.
    fn told(&self) -> String {
        match &self.out {
            Some(path) => format!("the sand is in {}, for --sand and option sand\n", path.display()),
            None => "--out sand.toml writes it to a file\n".into(),
        }
    }
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

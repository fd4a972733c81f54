//! `sandgait calibrate`

use sandgait::calibrate::pushes::{self, Penetration, Pushes, Value};
use sandgait::calibrate::{self, Calibration, figure, read};
use sandgait::{Error, Result};
use std::path::PathBuf;

/// The plate of Li et al. 2012, section 2: 3.8 × 2.5 cm [m²].
const PLATE: f64 = 0.038 * 0.025;

/// Measure the scale ζ of your sand with one slow vertical penetration of a horizontal plate.
///
/// The file has columns depth (downward from the surface) and force (upward on the plate). They are recorded on the way
/// down at less than 0.5 m/s. The header has the units, for example "depth [mm],force [N]", or the options have them;
/// without either they are m and N. Prints ζ, for --medium zeta=VALUE of every command, and ξ_n of agarwal2023, with 95
/// % confidence intervals.
///
/// With a column trial, several pushes of discs (column diameter) or plates (columns length and width) are compared.
/// Prints the law of depth and size that fits, its errors for a push and for a size that its fit did not use, the
/// repeatability of pushes, the compliance of the rig, and the limits of the calibration.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait calibrate push.csv --area 0.00095
  sandgait calibrate push.csv --depth-unit mm --plot push.svg
  sandgait calibrate discs.csv                                     (columns trial, diameter, depth, force)
  sandgait calibrate discs.csv --compliance 5e-5")]
pub struct CalibrateArgs {
    /// CSV with columns depth and force
    data: PathBuf,
    /// Area of the plate [m²]; default: 3.8 × 2.5 cm, the plate of Li et al. 2012
    #[arg(long, value_name = "M2", allow_negative_numbers = true)]
    area: Option<f64>,
    /// Unit of the depths: m, cm, mm or in
    #[arg(long)]
    depth_unit: Option<String>,
    /// Unit of the forces: N, mN, kN, gf, kgf or lbf
    #[arg(long)]
    force_unit: Option<String>,
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
        let units = [("depth", self.depth_unit.clone()), ("force", self.force_unit.clone())];
        let units = units.into_iter().filter_map(|(name, unit)| Some((name.to_owned(), unit?)));
        let read = read::file(&self.data, units.collect())?;
        if self.plot.as_ref().is_some_and(|p| p.extension().is_none_or(|e| e != "svg")) {
            return Err(Error::invalid("--plot", "give a file name that ends in .svg"));
        }
        if !read.pushes.is_empty() {
            return self.compare(&read.pushes);
        }
        if self.compliance.is_some() {
            return Err(Error::invalid("--compliance", "it needs several pushes, with a column trial"));
        }
        let result = calibrate::calibrate(&read.depth, &read.force, self.area.unwrap_or(PLATE))?;
        if let Some(path) = &self.plot {
            figure::single(&read.depth, &read.force, &result).write(path)?;
        }
        for caution in &result.cautions {
            eprintln!("sandgait: warning: {caution}");
        }
        Ok(match self.json {
            true => super::json(&serde_json::to_value(&result).unwrap_or_default()),
            false => describe(&result, self.area.is_none()),
        })
    }
}

impl CalibrateArgs {
    fn compare(&self, pushes: &[Penetration]) -> Result<String> {
        if self.area.is_some() {
            return Err(Error::invalid(
                "--area",
                "several pushes have their sizes in columns diameter, or length and width",
            ));
        }
        let study = pushes::compare(pushes, self.compliance)?;
        if let Some(path) = &self.plot {
            figure::several(pushes, &study).write(path)?;
        }
        for caution in &study.cautions {
            eprintln!("sandgait: warning: {caution}");
        }
        Ok(match self.json {
            true => super::json(&serde_json::to_value(&study).unwrap_or_default()),
            false => describe_several(&study),
        })
    }
}

fn describe_several(study: &Pushes) -> String {
    let mut text = String::from("size       pushes  zeta [N/cm3]  repeats within\n");
    for size in &study.sizes {
        let repeats = size.repeatability_percent.map_or("-".into(), |r| format!("{r:.1} %"));
        text += &format!("{:6.1} mm  {:6}  {:12.4}  {repeats}\n", 1e3 * size.diameter, size.pushes, size.zeta);
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
        "{}{}{} samples, r² {:.3}, plate {:.2} cm²{plate}\nuse it as --medium zeta={:.4}\n",
        line("ζ  ", c.zeta, c.zeta_interval),
        line("ξ_n", c.xi_n, c.xi_n_interval),
        c.samples,
        c.r_squared,
        c.area * 1e4,
        c.zeta,
    )
}

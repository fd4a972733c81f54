//! `sandgait calibrate`

use sandgait::calibrate::pushes::{self, Push, Pushes, Value};
use sandgait::calibrate::{self, Calibration};
use sandgait::error::check_range;
use sandgait::plot::png;
use sandgait::table::{self, Asked, Column, Quantity, Row};
use sandgait::{Error, Result};
use std::collections::HashMap;
use std::path::PathBuf;

/// The plate of Li et al. 2012, section 2: 3.8 × 2.5 cm [m²].
const PLATE: f64 = 0.038 * 0.025;

/// Beyond ±1e6 m or N a test is in the wrong unit or broken: our choice, as for force logs.
const MOST: f64 = 1e6;

const COLUMNS: [Column; 7] = [
    Column::needed("depth", Quantity::Length),
    Column::needed("force", Quantity::Force),
    Column { name: "trial", quantity: Quantity::Text, required: false },
    Column { name: "diameter", quantity: Quantity::Length, required: false },
    Column { name: "length", quantity: Quantity::Length, required: false },
    Column { name: "width", quantity: Quantity::Length, required: false },
    Column { name: "speed", quantity: Quantity::Speed, required: false },
];
/// Diameters and sides of plates [m]: our choice, wide.
const SIZES: std::ops::RangeInclusive<f64> = 1e-4..=1.0;

/// Measure your sand: its scale from one slow vertical penetration of a horizontal plate.
///
/// Reads columns depth (downward from the surface) and force (upward on the plate) of the way down, below 0.5 m/s; units
/// stand in the header, as in "depth [mm],force [N]", or in the options, else m and N. Prints ζ, for --medium zeta=VALUE
/// anywhere, and ξ_n of agarwal2023, with 95 % confidence intervals.
///
/// With a column trial, several pushes of discs (diameter) or plates (length, width) are compared: which law of depth and size
/// fits, how well it predicts a push and a size that it has not seen, how pushes repeat, how far the rig gives way, and where a
/// calibration does not carry over.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait calibrate push.csv --area 0.00095
  sandgait calibrate push.csv --depth-unit mm --plot push.svg      (also push.png)
  sandgait calibrate discs.csv                                     (columns trial, diameter, depth, force)
  sandgait calibrate discs.csv --compliance 5e-5")]
pub struct Calibrate {
    /// CSV with columns depth and force
    data: PathBuf,
    /// Area of the plate [m²]; default: 3.8 × 2.5 cm, the plate of Li et al. 2012
    #[arg(long, value_name = "M2", allow_negative_numbers = true)]
    area: Option<f64>,
    /// m, cm, mm or in
    #[arg(long)]
    depth_unit: Option<String>,
    /// N, mN, kN, gf, kgf or lbf
    #[arg(long)]
    force_unit: Option<String>,
    /// Draw the test and its line to this SVG file, and as PNG beside it
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// How far the rig gives way, in metres a newton, for several pushes; default: fitted beside
    #[arg(long, value_name = "M_PER_N", allow_negative_numbers = true)]
    compliance: Option<f64>,
    /// Machine-readable
    #[arg(long)]
    json: bool,
}

impl Calibrate {
    pub fn run(self) -> Result<String> {
        let units = [("depth", self.depth_unit.clone()), ("force", self.force_unit.clone())];
        let units = units.into_iter().filter_map(|(name, unit)| Some((name.to_owned(), unit?)));
        let asked = Asked { units: units.collect(), ..Asked::new(&COLUMNS) };
        let (mut depth, mut force) = (Vec::new(), Vec::new());
        let mut several = Several::default();
        table::read(&self.data, &asked, |row| {
            let [z, f] = [0, 1].map(|k| row.within(k, MOST).and_then(|x| x.ok_or_else(|| row.blank(k))));
            let (z, f) = (z?, f?);
            depth.push(z);
            force.push(f);
            if row.text(2).is_some() { several.take(row, z, f) } else { Ok(()) }
        })?;
        if self.plot.as_ref().is_some_and(|p| p.extension().is_none_or(|e| e != "svg")) {
            return Err(Error::invalid("--plot", "give a file name that ends in .svg"));
        }
        if !several.pushes.is_empty() {
            return self.compare(&several.pushes, depth.len());
        }
        if self.compliance.is_some() {
            return Err(Error::invalid(
                "--compliance",
                "one push alone cannot use it: give several, with a column trial",
            ));
        }
        let result = calibrate::calibrate(&depth, &force, self.area.unwrap_or(PLATE))?;
        if let Some(path) = &self.plot {
            png::write_both(&calibrate::figure(&depth, &force, &result).svg(), path)?;
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

impl Calibrate {
    fn compare(&self, pushes: &[Push], samples: usize) -> Result<String> {
        let held: usize = pushes.iter().map(|p| p.points.len()).sum();
        if held != samples {
            return Err(Error::invalid("trial", format!("blank in {} of {samples} rows", samples - held)));
        }
        if self.area.is_some() {
            return Err(Error::invalid(
                "--area",
                "several pushes have their sizes in columns diameter, or length and width",
            ));
        }
        let study = pushes::compare(pushes, self.compliance)?;
        if let Some(path) = &self.plot {
            png::write_both(&pushes::figure(pushes, &study).svg(), path)?;
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

/// Pushes as they are read.
#[derive(Default)]
struct Several {
    pushes: Vec<Push>,
    /// Place of each trial's push.
    places: HashMap<String, usize>,
    samples: usize,
}

impl Several {
    fn take(&mut self, row: &Row, depth: f64, force: f64) -> Result<()> {
        let name = row.needed_text(2)?;
        let side = |k: usize| {
            let refused = |e: Error| row.error(k, e);
            row.number(k)?.map(|x| check_range(COLUMNS[k].name, x, SIZES).map_err(refused)).transpose()
        };
        let diameter = match (side(3)?, side(4)?, side(5)?) {
            (Some(d), None, None) => d,
            (None, Some(length), Some(width)) => (length * width / std::f64::consts::FRAC_PI_4).sqrt(),
            _ => return Err(row.error(3, "give a diameter, or length and width, of each push")),
        };
        let speed = row.within(6, MOST)?.map(f64::abs);
        self.samples += 1;
        if self.samples > pushes::MOST_SAMPLES {
            return Err(row.error(0, format!("more than {} samples", pushes::MOST_SAMPLES)));
        }
        let new = self.pushes.len();
        let place = *self.places.entry(name.to_owned()).or_insert(new);
        if place == new {
            if new == pushes::MOST_PUSHES {
                return Err(row.error(2, format!("more than {} pushes", pushes::MOST_PUSHES)));
            }
            self.pushes.push(Push { name: name.to_owned(), diameter, points: Vec::new(), speeds: None });
        }
        let push = &mut self.pushes[place];
        if (push.diameter - diameter).abs() > 1e-9 {
            return Err(row.error(2, format!("{name} has two sizes")));
        }
        push.points.push([depth, force]);
        if let Some(speed) = speed {
            let [low, high] = push.speeds.unwrap_or([speed, speed]);
            push.speeds = Some([low.min(speed), high.max(speed)]);
        }
        Ok(())
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

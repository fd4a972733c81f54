//! Writes the sands of tests/data/real_wheel: `cargo run --release --example real_wheel -- tests/data/real_wheel`
//!
//! `sand_discs.toml` is calibrated on the discs only; `sand_smooth.toml` and `sand_grouser.toml` share four numbers
//! that are fitted on the rows of both wheels at slip angles up to 60°, and differ in the friction of the surface.

use sandgait::progress::{Latch, Silent};
use sandgait::sand::intruder::PlatedBody;
use sandgait::sand::{Law, Mechanisms, Medium, SandDescription};
use sandgait::table::{self, HeaderColumn, Quantity, ReadOptions};
use sandgait::validate::{DENSITY, data, fit};
use std::error::Error;
use std::path::{Path, PathBuf};

/// As wide as the wheels [m].
const DIAMETER: f64 = 0.06;
/// Greatest load of a wheel [N]. The discs are used up to this force, because beyond it their force is not proportional
/// to the depth any more.
const MOST_FORCE: f64 = 30.0;
/// Friction coefficient μ_s in the discs' file: tan(0.7 · 35°). It cannot be measured with pushes of discs. The
/// friction angle of steel in dry sand is 0.54 (smooth) to 0.76 (rough) of the sand's own (Potyondy 1961), which is 30°
/// to 40°.
const FRICTION: f64 = 0.46;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("give the folder with the data")?);
    let command = "cargo run --release --example real_wheel -- tests/data/real_wheel";
    let write = |name: &str, said: &str, sand: &SandDescription| -> Result<(), Box<dyn Error>> {
        std::fs::write(folder.join(name), format!("# {said}\n# {command}\n{}", sand.to_toml()?))?;
        Ok(())
    };
    let zeta = (discs(&folder.join("discs.csv"))? * 1e3).round() / 1e3;
    let mechanisms = Mechanisms { friction_clip: 1.0 / FRICTION, slip_bearing: fit::BEARING, ..Mechanisms::PLAIN };
    let discs = SandDescription {
        name: "cmu-discs".into(),
        source: format!(
            "ξ_n was fitted to pushes of a {:.0} mm disc up to {MOST_FORCE} N; this limit and μ_s were chosen after a look at the wheels' rows; \
             slip_bearing is in the prediction, with 1 from Vesic's formula",
            1e3 * DIAMETER
        ),
        law: Law::Agarwal2023,
        bulk_density: DENSITY,
        mechanisms,
        ..SandDescription::plain(&Medium::generic(zeta)?)
    };
    write(
        "sand_discs.toml",
        "ξ_n fitted on discs only. The range of forces and μ_s were chosen after a first comparison with the wheels.",
        &discs,
    )?;
    let read = |file: &Path| std::fs::read(folder.join(file)).map_err(|e| sandgait::Error::file(file, e));
    let wheels = data::gather(&folder, PlatedBody::MOST_PLATES, &read)?.wheels;
    let rows: Vec<_> = wheels.iter().map(|w| w.rows.clone()).collect();
    let parameters = fit::fit(&wheels, &rows, &Latch::new(&Silent))?.rounded();
    println!("{parameters:?}");
    let said =
        "Fitted on both wheels up to 60°: ζ, depth_power, skid_loss, graze_loss shared; friction_clip of this wheel.";
    for (wheel, file) in wheels.iter().zip(["sand_smooth.toml", "sand_grouser.toml"]) {
        let name = file.trim_end_matches(".toml").replace("sand_", "cmu-");
        let source = "fitted on the wheels' rows at slip angles up to 60°";
        write(file, said, &parameters.sand(wheel, &name, source)?)?;
    }
    Ok(())
}

/// ζ [N/cm³]: slope of the line through the origin, of force / area over depth.
fn discs(path: &Path) -> Result<f64, Box<dyn Error>> {
    const COLUMNS: [HeaderColumn; 3] = [
        HeaderColumn::needed("diameter", Quantity::Length),
        HeaderColumn::needed("depth", Quantity::Length),
        HeaderColumn::needed("force", Quantity::Force),
    ];
    let (mut top, mut bottom) = (0.0, 0.0);
    table::read(path, &ReadOptions::new(&COLUMNS), |row| {
        let (diameter, depth, force) = (row.needed(0)?, row.needed(1)?, row.needed(2)?);
        if (diameter - DIAMETER).abs() < 1e-9 && force <= MOST_FORCE {
            top += depth * force;
            bottom += depth * depth;
        }
        Ok(())
    })?;
    Ok(top / bottom / (std::f64::consts::PI / 4.0 * DIAMETER * DIAMETER) * 1e-6)
}

//! `sandgait media`

use sandgait::Result;
use sandgait::sand::Medium;
use sandgait::study::layout::glossary;

/// List the built-in sands with the sources of their numbers.
#[derive(clap::Args)]
#[command(after_help = "Any other sand is zeta=VALUE (N/cm³) on the generic set.

Examples:
  sandgait media
  sandgait walk --leg L --frequency 2 --medium zeta=0.5")]
pub struct MediaArgs {
    /// Print JSON with all coefficients
    #[arg(long)]
    json: bool,
}

impl MediaArgs {
    pub fn run(self) -> Result<String> {
        let media = Medium::names().into_iter().map(Medium::named).collect::<Result<Vec<_>>>()?;
        if self.json {
            return Ok(super::json(&serde_json::to_value(media).unwrap_or_default()));
        }
        let heading = ["name", "ζ [N/cm³]", "bulk density [kg/m³]", "source"].map(String::from).to_vec();
        let row = |m: Medium| {
            let zeta = m.coefficients.penetration() * 1e-6;
            vec![m.name, format!("{zeta:.3}"), format!("{:.0}", m.bulk_density), m.source]
        };
        Ok(glossary(&std::iter::once(heading).chain(media.into_iter().map(row)).collect::<Vec<_>>()))
    }
}

//! `validate`: comparison with measurements.

use super::arguments::FolderPath;
use super::declare::{Study, StudyWork};
use super::inputs::{Content, Inputs, SENT_TABLE};
use super::result::{StudyColumn, StudyFile, StudyResult, StudyTable};
use crate::error::Result;
use crate::progress::{PartialProgress, Progress};
use crate::sand::intruder::{IntruderPlate, PlatedBody};
use sandgait_validate::data::{self, DESCRIPTION, DataSet};
use sandgait_validate::others;
use sandgait_validate::page::Scoreboard;
use sandgait_validate::score::MeasuredPair;
use std::path::{Path, PathBuf};

/// Compare the model with measurements, and print the errors of its predictions.
///
/// Without --data the references are: two wheels and three discs in dry sand, measured at Carnegie Mellon University;
/// legs in simulated grains; walks of independent programs; and robots in pinocchio and MuJoCo. The table has each measured
/// row with its predictions, in each comparison.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait validate
  sandgait validate --out scoreboard               (validation.md, its rows and figures)
  sandgait validate --data my_wheel --out scoreboard")]
pub struct Validate {
    /// Folder with a validation.toml and the files of rows that it names
    #[arg(long, value_name = "DIR")]
    data: Option<FolderPath>,
}

/// Largest number of plates of all bodies that were sent, and memory of the other files as a multiple of their texts: our choice, some
/// six wheels; a row of 18 characters becomes 160 bytes and is predicted four times.
const SENT_PLATES: usize = 20_000;
const COPIES: usize = 40;

impl Study for Validate {
    const NAME: &'static str = "validate";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        let Some(FolderPath(folder)) = &self.data else { return Ok(()) };
        let folder = Path::new(folder);
        let description = name(folder, Path::new(DESCRIPTION));
        inputs.read(&description)?;
        let named = data::named_files(folder, inputs.text(&description)?)?;
        named.iter().try_for_each(|file| inputs.read(&name(folder, file)))
    }

    fn cost(&self, inputs: &Inputs) -> usize {
        let Some(FolderPath(folder)) = &self.data else { return 0 };
        let rows =
            inputs.names().filter(|name| Path::new(name).starts_with(folder)).filter_map(|name| inputs.get(name).ok());
        let text = rows.map(|file| if let Content::Bytes(text) = file { text.len() } else { 0 }).sum::<usize>();
        COPIES * text + SENT_PLATES * 2 * size_of::<IntruderPlate>()
    }

    fn next(&self) -> Option<String> {
        Some("to enter another simulator: sandgait.scoreboard in Python (docs/scoreboard.md)".into())
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        let data = match &self.data {
            None => data::own()?,
            Some(FolderPath(folder)) => {
                let folder = PathBuf::from(folder);
                let most_plates = if inputs.local { PlatedBody::MOST_PLATES } else { SENT_PLATES };
                data::gather(&folder, most_plates, &|file| {
                    inputs.bytes(&name(&folder, file), SENT_TABLE).map(|bytes| bytes.to_vec())
                })?
            }
        };
        let own = self.data.is_none();
        Ok(StudyWork::new(move |progress| result(data, own, progress)))
    }
}

fn name(folder: &Path, file: &Path) -> String {
    folder.join(file).to_string_lossy().into_owned()
}

/// The scores; with our `own` data also those of other references.
fn result(data: DataSet, own: bool, progress: &dyn Progress) -> Result<StudyResult> {
    let board = Scoreboard::new(data, &PartialProgress::new(progress, [0.0, 0.5]))?;
    let others = if own { others::text(&PartialProgress::new(progress, [0.5, 1.0]))? } else { String::new() };
    let files = board.files(&others).into_iter().map(|(name, text)| StudyFile::new(name, text)).collect();
    let summary = format!("{}\n\n{}\n{others}", board.worst(), board.text());
    let table = StudyTable::new("validation_rows", columns(&board.rows()));
    Ok(StudyResult { summary, files, ..StudyResult::table(table) })
}

fn columns(rows: &[(usize, &str, MeasuredPair)]) -> Vec<StudyColumn> {
    let under_load = |p: &MeasuredPair| p.prediction.carried.unwrap_or((f64::NAN, [f64::NAN; 3]));
    let number = |name: &str, unit: &str, of: &dyn Fn(&MeasuredPair) -> f64| {
        StudyColumn::numbers(name, unit, rows.iter().map(|(.., pair)| of(pair)))
    };
    vec![
        StudyColumn::numbers("comparison", "1", rows.iter().map(|(number, ..)| *number as f64)),
        StudyColumn::names("wheel", rows.iter().map(|(_, wheel, _)| *wheel)),
        number("slip_angle_deg", "°", &|p| p.row.slip_angle),
        number("slip", "1", &|p| p.row.slip),
        number("depth", "m", &|p| p.row.depth),
        number("Fx", "N", &|p| p.row.force[0]),
        number("Fy", "N", &|p| p.row.force[1]),
        number("Fz", "N", &|p| p.row.force[2]),
        number("Fx_predicted", "N", &|p| p.prediction.force[0]),
        number("Fy_predicted", "N", &|p| p.prediction.force[1]),
        number("Fz_predicted", "N", &|p| p.prediction.force[2]),
        number("depth_predicted", "m", &|p| under_load(p).0),
        number("Fx_under_load", "N", &|p| under_load(p).1[0]),
        number("Fy_under_load", "N", &|p| under_load(p).1[1]),
    ]
}

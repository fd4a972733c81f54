//! The matrix of sands: how well one policy of LeggedVelocity follows its commands on several grounds, slopes and strengths.

use super::commands::{CommandStudy, CommandTracking, percent};
use super::gait::PolicySource;
use super::no_sand_beside;
use crate::env::Task;
use crate::env::legged::LeggedVelocity;
use crate::env::registry::Blueprint;
use crate::error::{Result, check_range};
use crate::progress::{PartialProgress, Progress};
use serde_json::{Value, json};

/// The ground without sand.
const HARD: &str = "rigid";

/// Largest number of grounds: our choice, some minutes of work.
const MOST_GROUNDS: usize = 200;

/// Grounds as lists: each medium with each slope and strength. An empty list stands for the options' own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GroundLists {
    /// Grounds, as the option `ground` has them.
    pub media: Vec<String>,
    /// Slopes [°].
    pub slopes: Vec<f64>,
    /// Factors on the sand's stress.
    pub strengths: Vec<f64>,
}

/// One ground of the matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct MatrixGround {
    pub medium: String,
    /// Slope [°].
    pub slope_deg: f64,
    /// Factor on the sand's stress; NaN on hard ground, which has none.
    pub strength: f64,
}

/// A checked request.
pub struct SandMatrix {
    policy: PolicySource,
    options: Value,
    grounds: Vec<MatrixGround>,
    /// Memory of the largest study [bytes]; only one is in memory at a time.
    bytes: usize,
}

impl SandMatrix {
    /// `options`: see [`CommandStudy::new`].
    pub fn new(policy: PolicySource, options: Value, lists: &GroundLists) -> Result<Self> {
        let base = Blueprint::new(LeggedVelocity::ID, options.clone())?;
        no_sand_beside(&lists.media, &base)?;
        let own = |list: &[f64], other: f64| if list.is_empty() { vec![other] } else { list.to_vec() };
        let medium = base.task.option("ground").as_str().unwrap_or_default().to_owned();
        let media = if lists.media.is_empty() { vec![medium] } else { lists.media.clone() };
        let slopes = own(&lists.slopes, base.task.option("slope_deg").as_f64().unwrap_or_default());
        let strengths = own(&lists.strengths, 1.0);
        let mut grounds = Vec::new();
        for medium in &media {
            let strengths = if medium == HARD { &[f64::NAN][..] } else { &strengths[..] };
            for &slope_deg in &slopes {
                let ground = |strength: &f64| MatrixGround { medium: medium.clone(), slope_deg, strength: *strength };
                grounds.extend(strengths.iter().map(ground));
            }
        }
        check_range("media times slopes times strengths", grounds.len() as f64, 1.0..=MOST_GROUNDS as f64)?;
        let mut matrix = Self { policy, options, grounds, bytes: 0 };
        for ground in &matrix.grounds {
            matrix.bytes = matrix.bytes.max(matrix.study(ground)?.bytes());
        }
        Ok(matrix)
    }

    /// Memory of one ground's tasks with their episodes [bytes].
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    fn study(&self, ground: &MatrixGround) -> Result<CommandStudy> {
        let mut options = self.options.as_object().cloned().unwrap_or_default();
        options.insert("ground".into(), json!(ground.medium));
        options.insert("slope_deg".into(), json!(ground.slope_deg));
        let strength = if ground.strength.is_nan() { 1.0 } else { ground.strength };
        CommandStudy::on_sand(&self.policy, &Value::Object(options), strength)
    }

    /// Plays all episodes, ground by ground; the strength varies fastest. An error of `progress` stops the work.
    pub fn run(&self, progress: &dyn Progress) -> Result<Vec<(MatrixGround, CommandTracking)>> {
        let count = self.grounds.len() as f64;
        let one = |(k, ground): (usize, &MatrixGround)| {
            let part = PartialProgress::new(progress, [k as f64 / count, (k + 1) as f64 / count]);
            Ok((ground.clone(), self.study(ground)?.run(&part)?))
        };
        self.grounds.iter().enumerate().map(one).collect()
    }
}

/// Cells of the text table, the heading first. The first three columns say the ground.
pub fn cells(rows: &[(MatrixGround, CommandTracking)]) -> Vec<Vec<String>> {
    let heading = ["ground", "slope [°]", "strength", "mean error", "worst error", "fell"];
    let line = |(ground, followed): &(MatrixGround, CommandTracking)| {
        let strength = if ground.strength.is_nan() { "–".into() } else { ground.strength.to_string() };
        vec![
            ground.medium.clone(),
            ground.slope_deg.to_string(),
            strength,
            percent(followed.mean_error),
            percent(followed.worst_error),
            percent(followed.falls),
        ]
    };
    std::iter::once(heading.map(str::to_owned).to_vec()).chain(rows.iter().map(line)).collect()
}

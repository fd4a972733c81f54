//! Diagnosis: finds where the simulation errs, names the cause, extends the model, and measures the gain.
//!
//! 1. [`force_log`], [`walking_log`], [`intruder_log`] or [`trajectory`] reads the data, and [`experiment`] reads the
//!    facts about the data.
//! 2. [`check`] looks at the data before any fit, and refuses what is certainly wrong. A [`forward`] model predicts the data.
//! 3. [`noise_search`] learns the [`noise`] from repetitions, with the errors that a trial shares ([`shared`]), and
//!    [`whiten`] whitens the residuals.
//! 4. [`gauss_newton`] makes [`fit`]s, in which [`nuisance`]s are marginalised.
//! 5. [`select`] chooses: it fits the [`candidates`] and the [`laws`], compares them in one table of [`evidence`], and
//!    takes the [`verdict`] from this table.
//! 6. The leading model must pass the tests of [`gate`]; what passes has a name in the [`verdict`].
//! 7. [`view`] and [`report`] show the result, and [`guard`] looks at it once more.
//!
//! Steps 3 to 6 use only [`observations`] and a [`forward::ForwardModel`]. Another kind of data needs only its own
//! reader and forward model.

use sandgait_base::{error, parallel, progress, student};
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_robots as robots;
use sandgait_sand as sand;
use sandgait_sim as sim;
use sandgait_sweep as sweep;
use sandgait_table as table;

mod acceleration;
mod arm;
mod arm_nuisances;
mod broken;
mod candidates;
pub mod check;
mod compared;
mod conditions;
mod differences;
mod errors;
mod evidence;
pub mod experiment;
mod figures;
mod fit;
pub mod force_log;
pub mod force_model;
mod form;
pub mod forward;
mod gate;
mod gauss_newton;
mod gram;
mod guard;
pub mod hardware;
mod headline;
mod intruder_log;
mod intruder_model;
mod known;
mod laws;
mod left_out;
mod likelihood;
#[cfg(test)]
#[path = "../../tests/testbed/long.rs"]
mod long;
mod measured;
mod measuring;
mod minimise;
mod misfit;
mod motion;
mod nested;
mod next_experiment;
pub mod noise;
mod noise_search;
mod normal_equations;
pub mod nuisance;
mod observations;
mod one_fault;
mod opening;
mod page;
mod profile;
mod repeats;
pub mod report;
mod response;
mod rivals;
mod rows;
mod screen;
mod select;
mod series;
mod settling;
pub mod shared;
mod sides;
mod speed_exponent;
pub mod split;
mod strength;
mod structure;
pub mod study;
mod summary;
mod track;
mod trajectory;
#[cfg(test)]
#[path = "../../tests/testbed/truth.rs"]
mod truth;
pub mod verdict;
mod view;
pub mod walking_log;
mod walking_model;
pub mod whiten;
mod words;

use crate::error::Result;
use crate::progress::{Latch, Progress};
use crate::sand::SandDescription;
use crate::sand::mechanism::{CATALOG, Side};
use candidates::SearchSpace;
use check::Check;
use check::finding::{Finding, settled};
use experiment::{DataKind, Experiment};
use force_log::ForceLogFile;
use force_model::ForceLogModel;
use forward::ForwardModel;
use intruder_model::IntruderModel;
use next_experiment::{KnownNoise, after_too_few};
use noise::{NoiseData, sizes};
use observations::Observations;
use opening::{without_verdict, worded};
use report::{Curves, Diagnosis, Report, Untestable};
use select::{FACTORS, OF_SIZE, select};
use std::path::Path;
use study::FitInputs;
use view::ReportView;
use walking_model::WalkingModel;
use whiten::Whitener;

/// Least number of conditions from which a cause may be named: with fewer, no condition can be predicted from others that differ
/// among themselves.
const LEAST_CONDITIONS: usize = 3;

/// Reads the data and diagnoses them. If data cannot be read, the error names file, row and column. An error of
/// `progress` stops the work and is returned.
pub fn diagnose(data: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<Diagnosis> {
    let progress = &Latch::new(progress);
    progress.report(0.0, "reading the data")?;
    let mut diagnosis = diagnose_kind(data, experiment, progress)?;
    diagnosis.name = data.file_name().map_or_else(Default::default, |name| name.to_string_lossy().into());
    Ok(diagnosis)
}

fn diagnose_kind(data: &Path, experiment: &Experiment, progress: &Latch) -> Result<Diagnosis> {
    match experiment.file.kind {
        DataKind::Intrusion => {
            let ForceLogFile { log, trials, broken } = force_log::read_rows(data, experiment, progress)?;
            let model = ForceLogModel::new(&log, experiment)?.stopped_by(progress);
            let findings = check::force_log::check(data, &trials, &log, &model, broken)?;
            let source = DataSource { sha256: log.sha256, notes: log.notes, findings };
            diagnose_measured(&log.observations, source, &model, progress)
        }
        DataKind::Walking => {
            let log = walking_log::read(data, experiment, progress)?;
            let model = WalkingModel::new(&log, experiment, progress)?;
            let findings = means_checked(data, &log.observations, &model)?;
            let notes = [vec![model.step_note()], log.notes].concat();
            let source = DataSource { sha256: log.sha256, notes, findings };
            diagnose_measured(&log.observations, source, &model, progress)
        }
        DataKind::Trajectory => {
            let log = trajectory::measured(data, experiment, progress)?;
            let source = DataSource { sha256: log.sha256, notes: log.notes, findings: log.findings };
            diagnose_measured(&log.observations, source, &log.model, progress)
        }
        DataKind::Intruder => {
            let log = intruder_log::read(data, experiment, progress)?;
            let model = IntruderModel::new(&log, experiment, progress)?;
            let findings = means_checked(data, &log.observations, &model)?;
            let source = DataSource { sha256: log.sha256, notes: log.notes, findings };
            diagnose_measured(&log.observations, source, &model, progress)
        }
    }
}

/// What a look at means has found.
fn means_checked(data: &Path, observations: &Observations, model: &dyn ForwardModel) -> Result<Vec<Finding>> {
    settled(data, check::means::check(observations, &model.predict(&model.plain_sand())))
}

/// What is known of a file beside its numbers.
struct DataSource {
    sha256: String,
    /// How the numbers were prepared.
    notes: Vec<String>,
    findings: Vec<Finding>,
}

/// Diagnoses measured numbers with a forward model for them.
fn diagnose_measured(
    observations: &Observations,
    data: DataSource,
    model: &dyn ForwardModel,
    progress: &dyn Progress,
) -> Result<Diagnosis> {
    progress.report(0.02, "noise from the repetitions")?;
    let plain_sand = model.plain_sand();
    let plain = model.predict(&plain_sand);
    let all = model.uncertainty(&plain_sand, &plain);
    let sizes = sizes(observations);
    let source = NoiseData { observations, prediction: &plain, sizes: &sizes, uncertainty: &all, left_out: &[] };
    let noise = source.noise(None, &|| model.stopped());
    let supported = source.supported(&noise);
    let mut uncertainty = all.clone();
    uncertainty.shared.retain(|s| supported.contains(&s.name));
    let pruned = supported.len() < all.shared.len();
    let source = NoiseData { uncertainty: &uncertainty, ..source };
    let noise = if pruned { source.noise(None, &|| model.stopped()) } else { noise };
    let whitener = Whitener::new(&source, &noise);
    let study = FitInputs::new(observations, model, &whitener);
    let Causes { ids, unknown, unseen, untestable } = testable(&study);
    let lacks = lacks(&source);
    let selection = match &lacks {
        None => {
            let (ids, untestable, unseen) = (&ids[..], &unknown[..], &unseen[..]);
            let asked = SearchSpace { source: &source, noise: &noise, ids, untestable, unseen };
            Some(select(&study, &asked, progress)?)
        }
        Some(_) => None,
    };
    progress.report(0.95, "report")?;
    let mut report = without_verdict(&study, untestable, data.sha256, data.notes, lacks.as_deref());
    report.check = Check { findings: data.findings, design: check::design::design(&study, &all) };
    let mut report = match &selection {
        Some(selection) => ReportView { study: &study, source: &source, noise: &noise, selection }.report(report),
        None => {
            let names = uncertainty.shared.iter().map(|s| s.name).collect();
            let known = KnownNoise { noise: &noise, names };
            let next = Some(after_too_few(model, &known, lacks.as_deref().unwrap_or_default()));
            worded(Report { next_experiment: next, ..report })
        }
    };
    let found = guard::guard(&mut report);
    debug_assert_eq!(found, Vec::<String>::new());
    let standing = selection.as_ref().filter(|s| s.ruling.model > 0).map(|s| &s.standing);
    let fit = standing.map(|own| &own.fit);
    let mut sand = SandDescription::plain(model.medium());
    if let Some(own) = standing.filter(|own| !(own.stated && own.fit.ids.is_empty())) {
        sand.name = format!("{}-extended", sand.name);
        sand.source = format!("sandgait diagnose, data {}: {}", report.data_sha256, report.summary);
        sand.coefficients = own.study(&study).coefficients(&own.fit.deviations);
        sand.mechanisms = own.fit.mechanisms;
        sand.terms = own.law.as_ref().map(|law| law.term.clone()).into_iter().collect();
    }
    // The diagnosis does not look for hardware that the experiment file states, so the two have no quantity in common.
    let hardware = hardware::found(&report).or(&model.experiment().given.hardware);
    let extended = model.with_hardware(&(sand.mechanisms, sand.coefficients), &hardware);
    let extended = extended.or_else(|| fit.map(|fit| model.as_simulated(&fit.prediction)));
    model.finish(&mut sand);
    let band = noise.standard_deviation(&source);
    let groups = (0..observations.units.len()).map(|u| model.group(u).to_string()).collect();
    let plain = model.as_simulated(&plain);
    let conditions = conditions::described(observations, model);
    let medium = model.medium().name.clone();
    let (sand_is_plain, observations) = (fit.is_none(), observations.clone());
    let curves = Curves { groups, conditions, medium, plain, extended, sand_is_plain, band, observations };
    Ok(Diagnosis { report, sand, hardware, curves, name: "the data".into() })
}

/// Why data do not suffice to name a cause; None if they do.
fn lacks(source: &NoiseData) -> Option<String> {
    let groups = source.observations.repetitions();
    let made = groups.iter().filter(|units| !units.is_empty()).count();
    if !groups.iter().any(|units| units.len() > 1) {
        return Some("no condition is repeated".into());
    }
    if !source.scatters() {
        return Some("repetitions are copies of each other, so their scatter is no noise floor".into());
    }
    let said = |count| if count == 1 { "condition is" } else { "conditions are" };
    (made < LEAST_CONDITIONS).then(|| format!("{made} {} measured", said(made)))
}

/// The causes, by what the data can say of them; ids are indices of the catalogue.
#[derive(Default)]
struct Causes {
    /// The data can show them.
    ids: Vec<usize>,
    /// They act on the data, but cannot be tested because a column is missing.
    unknown: Vec<usize>,
    /// The missing column alone decides whether they act, and they would act as `scale` does.
    unseen: Vec<usize>,
    /// All that cannot be tested, because a column is missing or because they have no effect.
    untestable: Vec<Untestable>,
}

fn testable(study: &FitInputs) -> Causes {
    let mut causes = Causes::default();
    // Effects of the sensor are nuisances, and each of them may be the answer.
    let asked = study.model.testable();
    let asked: Vec<_> = asked.into_iter().filter(|a| CATALOG[a.0].side != Side::Sensor).collect();
    let (tried, there) = screen::tried(study, &asked.iter().map(|a| a.0).collect::<Vec<_>>());
    let plain = study.plain().prediction;
    let felt = |moved: &[f64]| {
        let white = study.whitener.apply(&fit::slope(moved, &plain, 1.0));
        crate::number::dot(&white, &white) > screen::FELT
    };
    for (id, why) in asked {
        let moves = tried.iter().zip(&there).any(|(t, moved)| t.0 == id && felt(moved));
        // Other kinds of data have no column of this kind, whatever the user logs.
        let columns = study.model.experiment().file.kind == DataKind::Intrusion;
        match why {
            Some(_) if CATALOG[id].id == OF_SIZE => (),
            Some(_) if moves => causes.unknown.push(id),
            Some(_) if columns && FACTORS.contains(&CATALOG[id].id) => causes.unseen.push(id),
            _ => (),
        }
        let why = why.or_else(|| (!moves).then(|| "no trial of these data excites it".to_string()));
        match why {
            Some(why) => causes.untestable.push(Untestable { id: CATALOG[id].id.into(), why }),
            None => causes.ids.push(id),
        }
    }
    causes
}

//! Files of a design study's trainings, from which a stopped study continues.

use super::checkpoint;
use super::curve::OpenPoint;
use super::plan::{TrainingPlan, TrainingState};
use crate::error::Result;
use crate::files;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Files of one training, `designD-K.…`: the policy, its checkpoint, and its results.
pub struct TrainingRecord {
    /// Path without an ending.
    path: PathBuf,
    /// Everything that the training's result depends on.
    key: String,
}

impl TrainingRecord {
    /// Training `training` of design number `design`; `before`: the designs of its warm start.
    pub fn new(out: &Path, design: usize, training: usize, plan: &TrainingPlan, before: &[Vec<String>]) -> Self {
        let model = plan.spec.blueprint.as_ref().map(|blueprint| blueprint.task.model());
        let key = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "instruction_set": plan.networks.isa.name(),
            "task": plan.spec.id,
            "options": plan.spec.options,
            "robot": model.map(|model| &model.robot),
            "scene": model.map(|model| &model.scene),
            "settings": plan.settings.json(),
            "seed": plan.seed,
            "before": before,
        });
        Self { path: out.join(format!("design{design}-{training}")), key: key.to_string() }
    }

    fn file(&self, ending: &str) -> PathBuf {
        self.path.with_extension(ending)
    }

    /// The results of the training, if it was finished before: its state, and its measures.
    pub fn read(&self, plan: &TrainingPlan) -> Option<(TrainingState, [f64; 3])> {
        let about: Value = serde_json::from_slice(&std::fs::read(self.file("json")).ok()?).ok()?;
        if about["key"].as_str() != Some(&self.key) {
            return None;
        }
        let measures = about["measures"].as_array()?.iter().map(|m| m.as_f64().unwrap_or(f64::INFINITY));
        let measures = <[f64; 3]>::try_from(measures.collect::<Vec<_>>()).ok()?;
        Some((checkpoint::load(&self.file("safetensors"), plan, false).ok()?.learnt, measures))
    }

    /// Saves the results of the training. The last file is written when the others are complete.
    pub fn write(&self, plan: &TrainingPlan, learnt: &TrainingState, onnx: &[u8], measures: &[f64; 3]) -> Result<()> {
        let keep = |ending: &str, content: &[u8]| files::write(&self.file(ending), content);
        let policy = TrainingState { environments: None, ..learnt.clone() };
        checkpoint::save(&self.file("safetensors"), plan, &policy, &OpenPoint::default())?;
        keep("onnx", onnx)?;
        let about = json!({"measures": measures, "steps": learnt.steps, "seconds": learnt.seconds, "key": self.key});
        keep("json", format!("{about:#}\n").as_bytes())
    }
}

//! What a training knows of its environments, which are those of a task or of another program.
//!
//! Environments on a server, and those of other packages, are behind `RemoteEnvironments`. Those of other packages step in the
//! thread that called `sandgait.train`, where their code expects to run.

use crate::env::Column;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use serde_json::{Map, Value};

/// What a training knows of its environments.
pub struct TrainingSpec {
    /// The task's id, or the name of another program's environment.
    pub id: String,
    /// All options of the task, or what identifies another program's environment.
    pub options: Map<String, Value>,
    pub observation: Vec<Column>,
    pub action: Vec<Column>,
    /// The task; None if the environments are those of another program.
    pub blueprint: Option<Blueprint>,
}

/// Bounds of each number of another program's observations and actions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExternalSpaces {
    pub observation: Vec<[f64; 2]>,
    pub action: Vec<[f64; 2]>,
}

impl TrainingSpec {
    pub fn of_task(blueprint: Blueprint) -> Self {
        let spec = blueprint.task.spec();
        Self {
            id: spec.id.into(),
            options: blueprint.task.options(),
            observation: spec.observation.clone(),
            action: spec.action.clone(),
            blueprint: Some(blueprint),
        }
    }

    /// Another program's environments, which `id` and `options` identify.
    pub fn external(id: &str, options: Map<String, Value>, spaces: &ExternalSpaces) -> Self {
        let column = |name: &str, bounds: &[[f64; 2]]| -> Vec<Column> {
            let named = |(k, [low, high]): (usize, &[f64; 2])| Column::new(format!("{name}[{k}]"), "", *low, *high);
            bounds.iter().enumerate().map(named).collect()
        };
        Self {
            id: id.into(),
            options,
            observation: column("observation", &spaces.observation),
            action: column("action", &spaces.action),
            blueprint: None,
        }
    }

    /// The task.
    pub fn task(&self) -> Result<&Blueprint> {
        let missing = || Error::Internal(format!("{} is no task of this program", self.id));
        self.blueprint.as_ref().ok_or_else(missing)
    }

    /// Bounds of the policy's actions. For another program's environments they are ±1, which stand for the ends of the action
    /// space.
    pub fn action_bounds(&self) -> Vec<[f32; 2]> {
        let own = |column: &Column| [column.low as f32, column.high as f32];
        self.action.iter().map(|c| if self.blueprint.is_some() { own(c) } else { [-1.0, 1.0] }).collect()
    }
}

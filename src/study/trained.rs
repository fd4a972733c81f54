//! Task and options of a learnt policy: `sandgait train` and `examples/train.py` leave them in settings.json beside it.

use super::inputs::OptionReader;
use super::options::OptionArgs;
use crate::env::registry::task_id;
use crate::error::{Error, Result};
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// The file of a policy in the folder that a training wrote.
pub fn in_folder(folder: &str) -> String {
    Path::new(folder).join("policy.onnx").to_string_lossy().into_owned()
}

/// The file of a policy: `named`, or that in the folder `named`.
pub fn policy_file(named: &Path) -> PathBuf {
    if named.is_dir() { in_folder(&named.to_string_lossy()).into() } else { named.into() }
}

/// The task and the options of a training.
pub struct TrainedTask {
    pub id: String,
    options: Map<String, Value>,
}

impl TrainedTask {
    /// From the text of a settings.json; `path` names it in errors.
    pub fn from_settings(path: &Path, text: &[u8]) -> Result<Self> {
        let settings: Value = serde_json::from_slice(text).map_err(|e| Error::file(path, e))?;
        let id = settings["task"].as_str().ok_or_else(|| Error::file(path, "it has no task"))?;
        let options = settings["options"].as_object().cloned().unwrap_or_default();
        Ok(Self { id: task_id(id).to_owned(), options })
    }

    /// From settings.json in the folder of `policy`; None if there is no such file.
    pub fn beside(policy: &Path) -> Result<Option<Self>> {
        let path = policy.with_file_name("settings.json");
        match std::fs::read(&path) {
            Ok(text) => Self::from_settings(&path, &text).map(Some),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(Error::file(&path, e)),
        }
    }

    /// The options of the training, with those `given` in their place.
    pub fn options(&self, given: &OptionArgs, files: OptionReader) -> Result<Value> {
        given.over(self.options.clone(), files)
    }
}

/// A task, its options, and a line for the user.
pub type ChosenTask = (String, Value, Option<String>);

/// The task and the options with which a policy runs: those of its training where `task` and `given` say nothing. A policy
/// without settings.json, and one that runs in another task, has the options that are given only.
pub fn task_and_options(
    trained: Option<TrainedTask>,
    task: Option<&str>,
    given: &OptionArgs,
    default: &str,
    files: OptionReader,
) -> Result<ChosenTask> {
    match (trained, task.map(task_id)) {
        (Some(trained), None) => Ok((trained.id.clone(), trained.options(given, files)?, None)),
        (Some(trained), Some(task)) if trained.id == task => {
            Ok((trained.id.clone(), trained.options(given, files)?, None))
        }
        (Some(trained), Some(task)) => {
            let line = format!("the policy was trained in {}: its options are not those of {task}", trained.id);
            Ok((task.to_owned(), Value::Object(given.read(files)?), Some(line)))
        }
        (None, task) => Ok((task.unwrap_or(default).to_owned(), Value::Object(given.read(files)?), None)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_s_folder_has_its_task_and_options() {
        let folder = tempfile::tempdir().unwrap();
        let policy = folder.path().join("policy.onnx");
        let none = OptionArgs::default();
        let beside = || TrainedTask::beside(&policy);
        let run = |task: Option<&str>| {
            let (task, options, _) =
                task_and_options(beside().unwrap(), task, &none, "sandgait/HexapodGait-v1", |_| Ok(())).unwrap();
            (task, options)
        };
        assert_eq!(run(None), ("sandgait/HexapodGait-v1".into(), serde_json::json!({})));
        let settings = r#"{"task": "sandgait/HexapodLegs-v2", "options": {"slope_deg": 5}}"#;
        std::fs::write(folder.path().join("settings.json"), settings).unwrap();
        for task in [None, Some("HexapodLegs")] {
            assert_eq!(run(task), ("sandgait/HexapodLegs-v2".into(), serde_json::json!({"slope_deg": 5})));
        }
        assert_eq!(run(Some("HexapodGait")), ("sandgait/HexapodGait-v1".into(), serde_json::json!({})));
        std::fs::write(folder.path().join("settings.json"), "{}").unwrap();
        let refused = beside().err().unwrap().to_string();
        assert!(refused.ends_with("settings.json: it has no task"), "{refused}");
    }
}

//! Reads states of a robot from a JSON file and computes the accelerations in free flight, to compare the dynamics with
//! other programs.

use super::files::SourceFile;
use crate::error::{Error, Result};
use crate::sim::tree::Tree;
use crate::sim::tree::flight::{TreeAccelerations, TreePose, accelerations};
use serde::Deserialize;
use std::path::Path;

/// Largest file [bytes]: our choice, 10⁵ rows of 12 joints.
const MOST_BYTES: u64 = 128 << 20;

#[derive(Deserialize)]
struct StateRow {
    quat: [f64; 4],
    v: [f64; 3],
    w: [f64; 3],
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
}

/// The file's rows: as a list, or in a table with the names of the joints, whose other keys are ignored.
#[derive(Deserialize)]
#[serde(untagged)]
enum JointRows {
    Named { joints: Option<Vec<String>>, rows: Vec<StateRow> },
    Bare(Vec<StateRow>),
}

/// The accelerations at each row of `path`. Joints are in the order of the file's `joints` or, without these, in the tree's order.
pub fn compute(tree: &Tree, path: &Path) -> Result<Vec<TreeAccelerations>> {
    let source = SourceFile::read(path, MOST_BYTES)?;
    let file: JointRows = serde_json::from_str(source.text()?).map_err(|e| {
        let reason = match e.classify() {
            serde_json::error::Category::Data => {
                "needs rows {quat, v, w, q, qd, tau}, bare or as {\"joints\": […], \"rows\": […]}".to_owned()
            }
            _ => format!("no JSON: {e}"),
        };
        Error::file(path, reason)
    })?;
    let own: Vec<&str> = tree.joints().map(|j| j.name.as_str()).collect();
    let (joints, rows) = match file {
        JointRows::Named { joints, rows } => (joints, rows),
        JointRows::Bare(rows) => (None, rows),
    };
    // For each joint of the tree its index in the rows.
    let places = match joints {
        None => (0..own.len()).collect(),
        Some(names) => matched(&own, &names).map_err(|reason| Error::file(path, reason))?,
    };
    let one = |(k, row): (usize, &StateRow)| {
        row.compute(tree, &places).map_err(|reason| Error::file(path, format!("row {}: {reason}", k + 1)))
    };
    rows.iter().enumerate().map(one).collect()
}

fn matched(own: &[&str], names: &[String]) -> std::result::Result<Vec<usize>, String> {
    if let Some(other) = names.iter().find(|n| !own.contains(&n.as_str())) {
        return Err(format!("the robot has no joint {other:?}; it has {}", own.join(", ")));
    }
    let place =
        |joint: &&str| names.iter().position(|n| n == joint).ok_or_else(|| format!("joint {joint:?} is missing"));
    let places: Vec<usize> = own.iter().map(place).collect::<std::result::Result<_, _>>()?;
    if names.len() > own.len() { Err("a joint is named twice".into()) } else { Ok(places) }
}

impl StateRow {
    fn compute(&self, tree: &Tree, places: &[usize]) -> std::result::Result<TreeAccelerations, String> {
        for (name, list) in [("q", &self.q), ("qd", &self.qd), ("tau", &self.tau)] {
            if list.len() != places.len() {
                return Err(format!("{name} has {} numbers; the robot has {} joints", list.len(), places.len()));
            }
        }
        let norm = self.quat.iter().map(|x| x * x).sum::<f64>().sqrt();
        // Our choice of the bounds: numbers beyond them are mistakes.
        if !(norm > 1e-6 && norm < 1e6) {
            return Err("quat is no rotation".into());
        }
        let ordered = |list: &[f64]| places.iter().map(|k| list[*k]).collect();
        let pose = TreePose {
            quat: self.quat.map(|x| x / norm),
            v: self.v,
            w: self.w,
            q: ordered(&self.q),
            qd: ordered(&self.qd),
            tau: ordered(&self.tau),
        };
        let found = accelerations(tree, &pose);
        let mut qdd = vec![0.0; places.len()];
        for (place, value) in places.iter().zip(&found.qdd) {
            qdd[*place] = *value;
        }
        if found.a.iter().chain(&found.alpha).chain(&qdd).any(|x| !x.is_finite()) {
            return Err("the accelerations are not finite".into());
        }
        Ok(TreeAccelerations { qdd, ..found })
    }
}

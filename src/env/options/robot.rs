//! The option `robot`: a name, or a whole robot as text.

use super::value::OptionValue;
use crate::error::{Error, Result};
use crate::sim::MemoryCount;
use crate::sim::tree::{TreeModel, packed};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::{Arc, OnceLock};

/// A built-in robot's name, or the text of a packed one ([`packed::pack`]). The robot is read once, and all
/// environments share it.
#[derive(Clone)]
pub struct RobotName(Arc<Held>);

struct Held {
    text: String,
    tree: OnceLock<TreeModel>,
}

/// Built-in robots that are trees.
const TREES: [(&str, &str); 1] = [("sandcat", include_str!("sandcat.json"))];

impl RobotName {
    /// The default robot of LeggedVelocity.
    pub const TREE: &'static str = TREES[0].0;

    /// The description of the default robot, as `sandgait robot --pack --json` prints it.
    pub fn built_in() -> &'static str {
        TREES[0].1
    }

    /// The name or text that the user gave.
    pub fn name(&self) -> &str {
        &self.0.text
    }

    /// The robot as a tree.
    pub fn tree(&self) -> Result<TreeModel> {
        if let Some(tree) = self.0.tree.get() {
            return Ok(tree.clone());
        }
        let text = self.name();
        let tree = match TREES.iter().find(|t| t.0 == text) {
            Some((_, json)) => packed::unpack(json)?,
            None if packed::is_packed(text) => packed::unpack_compressed(text)?,
            None => {
                let known = [
                    TREES[0].0,
                    "a name of `sandgait robots`, a .urdf or MJCF file (for a server: packed by `sandgait robot FILE --pack`)",
                ];
                return Err(Error::unknown("robot", text, &known));
            }
        };
        Ok(self.0.tree.get_or_init(|| tree).clone())
    }
}

impl OptionValue for RobotName {
    /// The tree is a part of the model that is made from it.
    fn count_memory(&self, count: &mut MemoryCount) {
        count.add_shared(&self.0, |held| size_of::<Held>() + held.text.len());
    }
}

impl From<&str> for RobotName {
    fn from(text: &str) -> Self {
        Self(Arc::new(Held { text: text.to_owned(), tree: OnceLock::new() }))
    }
}

impl PartialEq for RobotName {
    fn eq(&self, o: &Self) -> bool {
        Arc::ptr_eq(&self.0, &o.0) || self.0.text == o.0.text
    }
}

impl std::fmt::Debug for RobotName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.name())
    }
}

impl Serialize for RobotName {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for RobotName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        String::deserialize(deserializer).map(|text| Self::from(text.as_str()))
    }
}

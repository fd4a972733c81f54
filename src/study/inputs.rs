//! What a study gets beside its arguments: the contents of files.

use super::result::StudyTable;
use crate::error::{Error, Result};
use bytes::Bytes;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Replaces the files that options of a task name by their contents, on the machine that has the files.
pub type OptionReader = fn(&mut Value) -> Result<()>;

/// A file's bytes, or a table that was in memory and never in a file.
#[derive(Clone, Debug)]
pub enum Content {
    Bytes(Bytes),
    Table(StudyTable),
}

/// Files by the names that the arguments give them.
#[derive(Clone)]
pub struct Inputs {
    contents: BTreeMap<String, Content>,
    pub options: OptionReader,
    /// Are the user's files on this machine?
    pub local: bool,
}

/// Largest file [bytes]: that of the reader of tables.
const MOST_BYTES: u64 = 256 << 20;

/// Largest file that was sent and is parsed as a whole, such as TOML, whose values take many times as much memory [bytes]: our
/// choice. The text of a sand or a robot has some kB.
pub const SENT_TEXT: usize = 256 << 10;

/// Largest mesh or table of text that was sent [bytes]: our choice, 80,000 triangles in binary STL.
pub const SENT_TABLE: usize = 4 << 20;

impl Inputs {
    /// No files yet, on the user's own machine.
    pub fn local(options: OptionReader) -> Self {
        Self { contents: BTreeMap::new(), options, local: true }
    }

    /// Files as they were sent.
    pub fn sent(contents: BTreeMap<String, Content>) -> Self {
        Self { contents, options: |_| Ok(()), local: false }
    }

    /// Adds what is in memory and not on the disk.
    pub fn add(&mut self, name: &str, content: Content) {
        self.contents.insert(name.to_owned(), content);
    }

    pub fn names(&self) -> impl Iterator<Item = &String> {
        self.contents.keys()
    }

    pub fn has(&self, name: &str) -> bool {
        self.contents.contains_key(name)
    }

    /// Reads a file, unless its content is there already.
    pub fn read(&mut self, name: &str) -> Result<()> {
        if !self.has(name) {
            let bytes = sandgait_base::files::read(Path::new(name), MOST_BYTES)?;
            self.add(name, Content::Bytes(bytes.into()));
        }
        Ok(())
    }

    /// Reads a file if it exists.
    pub fn read_if_there(&mut self, name: &str) -> Result<()> {
        if Path::new(name).exists() { self.read(name) } else { Ok(()) }
    }

    /// All files, to send them.
    pub fn into_contents(self) -> BTreeMap<String, Content> {
        self.contents
    }

    pub fn get(&self, name: &str) -> Result<&Content> {
        self.contents
            .get(name)
            .ok_or_else(|| Error::invalid(name, "a server reads no files; send the content of this one"))
    }

    /// The content of a file. One that was sent may have `most_sent` bytes, because a server is not the user's own machine.
    pub fn bytes(&self, name: &str, most_sent: usize) -> Result<&Bytes> {
        match self.get(name)? {
            Content::Bytes(bytes) if !self.local && bytes.len() > most_sent => {
                let reason = format!("{} bytes are more than the {most_sent} that a server takes", bytes.len());
                Err(Error::invalid(name, reason))
            }
            Content::Bytes(bytes) => Ok(bytes),
            Content::Table(_) => Err(Error::invalid(name, "is a table where a file is expected")),
        }
    }

    /// A text that is parsed as a whole.
    pub fn text(&self, name: &str) -> Result<&str> {
        std::str::from_utf8(self.bytes(name, SENT_TEXT)?).map_err(|_| Error::file(Path::new(name), "not UTF-8 text"))
    }
}

//! Notes on the parts of a description that this project does not use. Each part that is left out gives a note.

use super::xml::Element;
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of lines of one kind that are shown; further ones are only counted. Our choice: they fit on a screen.
const MOST_LINES: usize = 20;

/// Collected while a file is read.
#[derive(Default)]
pub struct Notes {
    lines: Vec<String>,
    elements: BTreeMap<String, usize>,
    attributes: BTreeMap<String, BTreeSet<String>>,
}

impl Notes {
    /// Adds one sentence.
    pub fn say(&mut self, line: impl Into<String>) {
        let line = line.into();
        if !self.lines.contains(&line) {
            self.lines.push(line);
        }
    }

    /// Notes that an element is left out.
    pub fn left_out(&mut self, element: &Element) {
        *self.elements.entry(element.tag.chars().take(60).collect()).or_default() += 1;
    }

    /// Notes the attributes of `element` that are not in `known`.
    pub fn others(&mut self, element: &Element, known: &[&str]) {
        for (name, _) in element.attributes.iter().filter(|(n, _)| !known.contains(&n.as_str())) {
            let of = self.attributes.entry(element.tag.chars().take(60).collect()).or_default();
            of.insert(name.chars().take(60).collect());
        }
    }

    /// Notes the children of `element` that are not in `known`.
    pub fn other_children(&mut self, element: &Element, known: &[&str]) {
        element.children.iter().filter(|c| !known.contains(&c.tag.as_str())).for_each(|c| self.left_out(c));
    }

    /// All notes, the important ones first.
    pub fn into_lines(self) -> Vec<String> {
        let mut lines = self.lines;
        if lines.len() > MOST_LINES {
            let more = lines.len() - MOST_LINES;
            lines.truncate(MOST_LINES);
            lines.push(format!("and {more} warnings more"));
        }
        let counted: Vec<_> =
            self.elements.iter().take(2 * MOST_LINES).map(|(tag, n)| format!("{n} <{tag}>")).collect();
        if !counted.is_empty() {
            lines.push(format!("left out: {}", counted.join(", ")));
        }
        for (tag, names) in self.attributes.iter().take(MOST_LINES) {
            let names: Vec<_> = names.iter().take(MOST_LINES).map(String::as_str).collect();
            lines.push(format!("left out of <{tag}>: {}", names.join(", ")));
        }
        lines
    }
}

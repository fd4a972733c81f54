//! Notes on the parts of a description that this project changes or does not use. One line names all parts that are treated
//! alike, and says what was done with them.

use super::effects::{self, shortened};
use super::xml::Element;
use crate::error::Error;
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of lines, and of names in a line: our choice, because the lines then fit on a screen. Names are
/// cut after 60 characters.
const MOST_LINES: usize = 20;
const MOST_NAMES: usize = 4;

/// Parts that are treated alike.
struct SimilarNotes {
    noun: &'static str,
    done: String,
    names: Vec<String>,
}

/// Collected while a file is read.
#[derive(Default)]
pub struct Notes {
    lines: Vec<String>,
    alike: Vec<SimilarNotes>,
    /// Parts that change the motion and are not simulated: what each is, and its effect.
    missing: BTreeMap<String, (usize, &'static str)>,
    elements: BTreeMap<String, usize>,
    attributes: BTreeMap<String, BTreeSet<String>>,
    /// Number of visuals that cannot be read, and why the first of them cannot.
    undrawn: Option<(usize, String)>,
}

impl Notes {
    /// Adds one sentence.
    pub fn say(&mut self, line: impl Into<String>) {
        let line = line.into();
        if !self.lines.contains(&line) {
            self.lines.push(line);
        }
    }

    /// Adds the part called `name`. `noun` is its kind in the singular, `done` says what is wrong with it and what was
    /// done. Parts with equal `done` share a line.
    pub fn part(&mut self, noun: &'static str, name: &str, done: impl Into<String>) {
        let (done, name) = (done.into(), name.chars().take(60).collect());
        match self.alike.iter_mut().find(|a| a.noun == noun && a.done == done) {
            Some(alike) if alike.names.contains(&name) => {}
            Some(alike) => alike.names.push(name),
            None => self.alike.push(SimilarNotes { noun, done, names: vec![name] }),
        }
    }

    /// Takes back what was said of the parts called `name`.
    pub fn forget(&mut self, noun: &str, name: &str) {
        self.alike.iter_mut().filter(|a| a.noun == noun).for_each(|a| a.names.retain(|n| n != name));
        self.alike.retain(|a| !a.names.is_empty());
    }

    /// Notes that an element is left out.
    pub fn left_out(&mut self, element: &Element) {
        let parts = effects::of_parts(element);
        if !parts.is_empty() {
            parts.into_iter().for_each(|(what, effect)| self.not_simulated(what, effect));
            return;
        }
        *self.elements.entry(element.tag.chars().take(60).collect()).or_default() += 1;
    }

    /// Notes a part that changes the motion and is not simulated: what it is, and its effect.
    pub fn not_simulated(&mut self, what: impl Into<String>, effect: &'static str) {
        self.missing.entry(what.into()).or_insert((0, effect)).0 += 1;
    }

    /// Notes a visual that cannot be read, and so is not drawn.
    pub fn undrawn(&mut self, reason: &Error) {
        self.undrawn.get_or_insert_with(|| (0, reason.to_string())).0 += 1;
    }

    /// Notes the attributes of `element` that are not in `known`.
    pub fn others(&mut self, element: &Element, known: &[&str]) {
        for (name, value) in element.attributes.iter().filter(|(n, _)| !known.contains(&n.as_str())) {
            if let Some(effect) = effects::of_attribute(&element.tag, name, value) {
                self.missing.insert(format!("{} of <{}>", shortened(name), shortened(&element.tag)), (0, effect));
                continue;
            }
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
        let mut lines = Vec::new();
        if !self.missing.is_empty() {
            let one = |(what, (count, effect)): (&String, &(usize, &str))| match count {
                0 => format!("{what} ({effect})"),
                _ => format!("{count} {what} ({effect})"),
            };
            let all: Vec<_> = self.missing.iter().take(MOST_LINES).map(one).collect();
            lines.push(format!(
                "changes the motion in other programs or on the robot, and is not simulated here: {}",
                all.join("; ")
            ));
        }
        lines.extend(self.lines);
        if let Some((count, first)) = self.undrawn {
            let visuals = if count == 1 { "visual is" } else { "visuals are" };
            lines.push(format!("{count} {visuals} not drawn, because of errors in the file; the first: {first}"));
        }
        lines.extend(self.alike.iter().map(SimilarNotes::line));
        if lines.len() > MOST_LINES {
            let more = lines.len() - MOST_LINES;
            lines.truncate(MOST_LINES);
            lines.push(format!("and {more} warnings more"));
        }
        let mut left: Vec<_> = self.elements.iter().take(MOST_LINES).map(|(tag, n)| format!("{n} <{tag}>")).collect();
        for (tag, names) in self.attributes.iter().take(MOST_LINES) {
            let names: Vec<_> = names.iter().take(MOST_LINES).map(String::as_str).collect();
            left.push(format!("of <{tag}> {}", names.join(", ")));
        }
        if !left.is_empty() {
            lines.push(format!("left out, without effect on the motion here: {}", left.join("; ")));
        }
        lines
    }
}

impl SimilarNotes {
    /// `links a, b, c, d and 3 more: …`
    fn line(&self) -> String {
        let shown = self.names.iter().take(MOST_NAMES).map(String::as_str).collect::<Vec<_>>().join(", ");
        let more = match self.names.len().saturating_sub(MOST_NAMES) {
            0 => String::new(),
            n => format!(" and {n} more"),
        };
        let plural = match (self.names.len(), self.noun) {
            (1, noun) => noun.to_owned(),
            (_, "body") => "bodies".into(),
            (_, "mesh") => "meshes".into(),
            (_, noun) => format!("{noun}s"),
        };
        format!("{plural} {shown}{more}: {}", self.done)
    }
}

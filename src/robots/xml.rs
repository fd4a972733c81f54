//! XML as elements with attributes. Size, number and depth are bounded, and every error names its line.

use super::files::SourceFile;
use super::{xml_bounds, xml_mended};
use crate::error::{Error, Result};
use std::path::Path;
use std::sync::Arc;

/// Largest number of nodes of a file: our choice, fifty times that of the largest robot file we have seen (go1.urdf,
/// 4000).
const MOST_NODES: u32 = 200_000;
/// Deepest nesting: our choice, a leg of twenty links is less than half of it.
const DEEPEST: usize = 100;
/// Largest number of characters of a malformed number in a message, and of an element's text that is kept: our choice, so that the message stays readable.
pub const QUOTED: usize = 40;

/// An element. Of its text only the beginning is kept, because robots' own elements have none.
#[derive(Clone, Debug)]
pub struct Element {
    pub tag: String,
    /// Trimmed, at most [`QUOTED`] characters.
    pub text: String,
    pub attributes: Vec<(String, String)>,
    pub children: Vec<Element>,
    file: Arc<Path>,
    line: u32,
}

/// The root element of a file. Document types with entities are refused: no robot needs them, and entities can expand
/// without bound. A text that is not quite XML is read as MuJoCo and ROS read it. `say` gets a note on this, and on the file's
/// encoding, if there is one.
pub fn parse(source: &SourceFile, mut say: impl FnMut(String)) -> Result<Element> {
    let (text, note) = source.xml()?;
    note.into_iter().for_each(&mut say);
    let failed = |reason: String| Error::file(&source.path, reason);
    let strict = parsed(&text, source);
    if !matches!(strict, Err(Unread::NoXml(..))) {
        return strict.map_err(|e| failed(e.reason()));
    }
    let mended = xml_mended::mended(&text);
    match (parsed(&mended, source), strict) {
        (Ok(root), Err(Unread::NoXml(line, why))) => {
            say(format!("line {line} is no XML ({why}); it was read as MuJoCo and ROS read it"));
            Ok(root)
        }
        (result, _) => result.map_err(|e| failed(e.reason())),
    }
}

/// Why a text is not read.
enum Unread {
    /// Its elements are wrong.
    Wrong(Error),
    /// Where it ends to be XML, and why.
    NoXml(u32, String),
    Other(String),
}

impl Unread {
    fn reason(self) -> String {
        match self {
            Self::Wrong(Error::File { reason, .. }) | Self::Other(reason) => reason,
            Self::Wrong(other) => other.to_string(),
            Self::NoXml(line, why) => {
                format!(
                    "line {line}: no XML: {why}; mend it, or write the file again (`xmllint --noout FILE` lists all such places)"
                )
            }
        }
    }
}

fn parsed(text: &str, source: &SourceFile) -> std::result::Result<Element, Unread> {
    xml_bounds::check(text).map_err(Unread::Other)?;
    let entities = text.find("<!ENTITY");
    let options =
        roxmltree::ParsingOptions { allow_dtd: entities.is_none(), nodes_limit: MOST_NODES, ..Default::default() };
    let lines = LineStarts::of(text);
    let document = roxmltree::Document::parse_with_options(text, options).map_err(|e| match e {
        roxmltree::Error::NodesLimitReached => Unread::Other(format!("more than {MOST_NODES} nodes")),
        roxmltree::Error::DtdDetected => Unread::Other(format!(
            "line {}: a document type with entities (<!ENTITY …>) is not read: write their values in their places (`xmllint \
             --noent --dropdtd FILE`)",
            lines.at(entities.unwrap_or(0))
        )),
        other => Unread::NoXml(place(&other, text), shortened(&other.to_string(), 200)),
    })?;
    element(&document.root_element(), &Arc::from(source.path.as_path()), &lines, 1).map_err(Unread::Wrong)
}

/// The line of an error. Of a text that ends too early it is the last one.
fn place(error: &roxmltree::Error, text: &str) -> u32 {
    let ends = matches!(error, roxmltree::Error::UnexpectedEndOfStream | roxmltree::Error::UnclosedRootNode);
    if ends { text.lines().count().max(1) as u32 } else { error.pos().row }
}

fn element(node: &roxmltree::Node, file: &Arc<Path>, lines: &LineStarts, depth: usize) -> Result<Element> {
    let line = lines.at(node.range().start);
    let name = |namespace: Option<&str>, name: &str| match namespace {
        // Elements of other name spaces (xacro, sensor) keep the name space in their name, so that they are not
        // mistaken for elements of the robot.
        Some(space) => format!("{space}:{name}"),
        None => name.to_owned(),
    };
    let tag = name(node.tag_name().namespace(), node.tag_name().name());
    if depth > DEEPEST {
        return Err(Error::file(file, format!("line {line}: elements are nested deeper than {DEEPEST}")));
    }
    let attributes = node.attributes().map(|a| (name(a.namespace(), a.name()), a.value().to_owned())).collect();
    let inner = node.children().filter(roxmltree::Node::is_element);
    let children = inner.map(|c| element(&c, file, lines, depth + 1)).collect::<Result<_>>()?;
    let text = node.text().unwrap_or_default().trim().chars().take(QUOTED).collect();
    Ok(Element { tag, text, attributes, children, file: file.clone(), line })
}

/// Offsets at which lines end.
struct LineStarts(Vec<usize>);

impl LineStarts {
    fn of(text: &str) -> Self {
        Self(text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i).collect())
    }

    fn at(&self, byte: usize) -> u32 {
        self.0.partition_point(|end| *end < byte) as u32 + 1
    }
}

/// The beginning of a text, so that messages stay readable.
fn shortened(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

impl Element {
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    pub fn set(&mut self, name: &str, value: &str) {
        match self.attributes.iter_mut().find(|(n, _)| n == name) {
            Some(found) => found.1 = value.to_owned(),
            None => self.attributes.push((name.to_owned(), value.to_owned())),
        }
    }

    pub fn all<'a>(&'a self, tag: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |c| c.tag == tag)
    }

    pub fn first(&self, tag: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.tag == tag)
    }

    /// An error with its place: `robot.urdf: line 12, <joint name="knee">: …`.
    pub fn error(&self, reason: impl std::fmt::Display) -> Error {
        let name = self.get("name").map(|n| format!(" name={:?}", shortened(n, QUOTED))).unwrap_or_default();
        let tag = shortened(&self.tag, QUOTED);
        Error::file(&self.file, format!("line {}, <{tag}{name}>: {reason}", self.line))
    }

    /// An error that names this element and one of its attributes.
    pub fn wrong(&self, attribute: &str, reason: impl std::fmt::Display) -> Error {
        self.error(format!("{attribute}: {reason}"))
    }

    pub fn required(&self, attribute: &str) -> Result<&str> {
        self.get(attribute).ok_or_else(|| self.error(format!("{attribute} is missing")))
    }

    /// All numbers of an attribute; each must be finite.
    pub fn list(&self, attribute: &str) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.get(attribute) else { return Ok(None) };
        let number = |word: &str| {
            let value = word.parse::<f64>();
            let value =
                value.map_err(|_| self.wrong(attribute, format!("{:?} is no number", shortened(word, QUOTED))))?;
            if value.is_finite() { Ok(value) } else { Err(self.wrong(attribute, format!("{value} is not finite"))) }
        };
        text.split_whitespace().map(number).collect::<Result<_>>().map(Some)
    }

    pub fn numbers<const N: usize>(&self, attribute: &str) -> Result<Option<[f64; N]>> {
        let Some(list) = self.list(attribute)? else { return Ok(None) };
        let count = list.len();
        let fits = <[f64; N]>::try_from(list);
        fits.map(Some).map_err(|_| self.wrong(attribute, format!("{count} numbers in place of {N}")))
    }

    pub fn number(&self, attribute: &str) -> Result<Option<f64>> {
        Ok(self.numbers::<1>(attribute)?.map(|[x]| x))
    }

    /// A number of at least 0.
    pub fn not_negative(&self, attribute: &str) -> Result<Option<f64>> {
        match self.number(attribute)? {
            Some(x) if x < 0.0 => Err(self.wrong(attribute, format!("{x} is negative"))),
            other => Ok(other),
        }
    }

    /// A length above 0 [m]; the upper bound catches wrong units, our choice.
    pub fn length(&self, attribute: &str, value: f64) -> Result<f64> {
        match value {
            v if v > 0.0 && v <= 100.0 => Ok(v),
            v => Err(self.wrong(attribute, format!("{v} m is not a length from 0 to 100 m"))),
        }
    }
}

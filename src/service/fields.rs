//! Counts the fields and values of a message before it is unpacked. What a message may contain follows from the
//! descriptors of the protos, and [`LONGEST`] has the bounds of the fields that may be long, by their names.
//!
//! A field that no descriptor has is skipped when the message is unpacked, so it only counts as a field.

use super::proto::DESCRIPTORS;
use crate::error::{Error, Result};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FileDescriptorSet};
use std::collections::HashMap;
use std::sync::LazyLock;

/// Messages of at most this size [bytes] need no share of the memory for requests, because the number of calls is
/// limited (`price::CALL`).
pub const SMALL: usize = 16 << 10;

/// Longest options of a session or a reset [bytes]: our choice. A packed robot, the longest option, has up to 224 KiB,
/// and the text of a `sand.toml` some 2 KiB.
pub const LONGEST_OPTIONS: usize = 256 << 10;

/// Largest number of fields of one message: our choice, twice the number of seeds of the largest usual session, if each seed is a
/// field.
const MOST_FIELDS: usize = 1 << 17;

/// Largest number of messages inside one message: our choice, enough for some 1,000 values of options. All options of a task
/// together have some 50.
const MOST_MESSAGES: usize = 4_096;

/// Deepest nesting of messages: our choice, below prost's 100. A list inside a list takes two levels, a table three.
const DEEPEST: usize = 48;

/// Longest id [bytes]: our choice; an id has 32 characters, and the longest task's id 30.
const ID: usize = 256;

/// Largest files of a study together [bytes]: our choice. 40,000 rows of a force log, the most that a diagnosis takes, have
/// about 8 MB; logs of robots may have more rows. A million motions of a body have 64 MB.
const LARGEST_FILES: usize = 65 << 20;

/// Bounds of fields [bytes]; of all its values together, if a field may occur more than once. Any other text, list of
/// numbers or field of `bytes` has at most [`SMALL`] bytes, and any `Struct` at most [`LONGEST_OPTIONS`]. The bound of a
/// file is that of its content. Fields without an end are bounded by `--max-message-mib`, and by the number of the
/// session's environments.
const LONGEST: &[(&str, usize)] = &[
    ("sandgait.v1.CreateSessionRequest.task_id", ID),
    ("sandgait.v1.DescribeSessionRequest.session_id", ID),
    ("sandgait.v1.CloseSessionRequest.session_id", ID),
    ("sandgait.v1.RunSessionRequest.session_id", ID),
    ("sandgait.v1.Reset.seeds", usize::MAX),
    ("sandgait.v1.Reset.mask", usize::MAX),
    ("sandgait.v1.Step.actions", usize::MAX),
    ("sandgait.v1.Step.held", usize::MAX),
    ("sandgait.v1.SetCommand.commands", usize::MAX),
    ("sandgait.v1.Restore.snapshot", usize::MAX),
    ("sandgait.v1.Restore.sources", usize::MAX),
    ("sandgait.v1.Rollout.actions", usize::MAX),
    // Its reader has a bound, too.
    ("sandgait.v1.PolicyRollout.onnx", usize::MAX),
    // Indices of environments: one byte of a message can become four.
    ("sandgait.v1.Render.indices", 256 << 10),
    ("sandgait.v1.StudyRequest.name", ID),
    // A packed robot, or lists of some ten thousand numbers.
    ("sandgait.v1.StudyRequest.arguments", LONGEST_OPTIONS + SMALL),
    ("sandgait.v1.StudyRequest.files", LARGEST_FILES),
    ("dm_env_rpc.v1.CreateWorldRequest.settings", LONGEST_OPTIONS),
    ("dm_env_rpc.v1.JoinWorldRequest.settings", LONGEST_OPTIONS),
    ("dm_env_rpc.v1.ResetRequest.settings", LONGEST_OPTIONS),
    ("dm_env_rpc.v1.ResetWorldRequest.settings", LONGEST_OPTIONS),
];

/// Messages that are values of the field that holds them, with its name and bound: options, files, tensors. Entries of
/// maps are values, too.
const VALUES: [&str; 6] = [
    "google.protobuf.",
    "sandgait.v1.File",
    "sandgait.v1.StudyInput",
    "sandgait.v1.Table",
    "sandgait.v1.Series",
    "dm_env_rpc.v1.Tensor",
];

/// The bound of a field that has none of its own, because it contains other fields or is a part of a value.
const UNBOUNDED: usize = usize::MAX;

/// The fields of a message.
pub struct MessageLayout {
    fields: HashMap<u64, FieldLayout>,
    /// Is it a value of the field that holds it?
    is_value: bool,
}

struct FieldLayout {
    name: String,
    /// Largest size of all its values together [bytes].
    longest: usize,
    /// May the field occur more than once?
    repeated: bool,
    /// The fields of a `oneof` have the same number.
    oneof: Option<i32>,
    /// The message that it contains.
    inside: Option<String>,
}

/// All messages, and the message that each method takes, by their full names.
struct Layouts {
    messages: HashMap<String, MessageLayout>,
    requests: HashMap<String, String>,
}

static LAYOUTS: LazyLock<Layouts> = LazyLock::new(|| Layouts::new(DESCRIPTORS));

/// The layout of the requests of the method with this path: `/package.Service/Method`. A method that is not ours has
/// none.
pub fn of_method(path: &str) -> Option<&'static MessageLayout> {
    LAYOUTS.messages.get(LAYOUTS.requests.get(path)?)
}

/// Paths of all methods.
pub fn methods() -> impl Iterator<Item = &'static str> {
    LAYOUTS.requests.keys().map(String::as_str)
}

impl Layouts {
    fn new(descriptors: &[u8]) -> Self {
        let mut layouts = Self { messages: HashMap::new(), requests: HashMap::new() };
        // Descriptors that were compiled in can be read, which a test checks.
        let files = FileDescriptorSet::decode(descriptors).unwrap_or_default();
        for file in &files.file {
            file.message_type.iter().for_each(|message| layouts.add(file.package(), message));
            for service in &file.service {
                for method in &service.method {
                    let path = format!("/{}.{}/{}", file.package(), service.name(), method.name());
                    layouts.requests.insert(path, method.input_type().trim_start_matches('.').to_owned());
                }
            }
        }
        layouts
    }

    /// Adds `message` and the messages that are declared in it.
    fn add(&mut self, scope: &str, message: &DescriptorProto) {
        let name = format!("{scope}.{}", message.name());
        message.nested_type.iter().for_each(|nested| self.add(&name, nested));
        let is_entry = message.options.as_ref().is_some_and(|options| options.map_entry());
        let is_value = is_entry || VALUES.iter().any(|value| name.starts_with(value));
        let field = |field: &prost_types::FieldDescriptorProto| {
            let inside =
                (field.r#type() == Type::Message).then(|| field.type_name().trim_start_matches('.').to_owned());
            let full = format!("{name}.{}", field.name());
            let longest = LONGEST.iter().find(|(field, _)| *field == full).map(|(_, longest)| *longest);
            let longest = longest.unwrap_or(match inside.as_deref() {
                Some("google.protobuf.Struct") => LONGEST_OPTIONS,
                Some(_) => UNBOUNDED,
                None if is_value => UNBOUNDED,
                None => SMALL,
            });
            let repeated = field.label() == Label::Repeated;
            let layout =
                FieldLayout { name: field.name().to_owned(), longest, repeated, oneof: field.oneof_index, inside };
            (field.number() as u64, layout)
        };
        let fields = message.field.iter().map(field).collect();
        self.messages.insert(name, MessageLayout { fields, is_value });
    }
}

impl MessageLayout {
    /// Largest message [bytes]: all its long fields, of which those of a `oneof` are alternatives, and [`SMALL`] for the
    /// others together.
    pub fn largest(&self) -> usize {
        self.long_fields(0).saturating_add(SMALL)
    }

    fn long_fields(&self, depth: usize) -> usize {
        let (mut sum, mut alternatives) = (0_usize, HashMap::<i32, usize>::new());
        // The bound of a value is that of the field that holds it.
        for field in self.fields.values().filter(|_| !self.is_value) {
            let inside = field.inside.as_ref().and_then(|name| LAYOUTS.messages.get(name));
            let size = match inside {
                Some(inside) if field.longest == UNBOUNDED && depth < DEEPEST => inside.long_fields(depth + 1),
                _ if field.longest <= SMALL => 0,
                _ => field.longest,
            };
            match field.oneof {
                Some(group) => {
                    let largest = alternatives.entry(group).or_default();
                    *largest = size.max(*largest);
                }
                None => sum = sum.saturating_add(size),
            }
        }
        alternatives.into_values().fold(sum, usize::saturating_add)
    }

    /// Refuses a message that would unpack to more than it may.
    pub fn check(&self, bytes: &[u8]) -> Result<()> {
        FieldCount::default().message(bytes, self, None, 0)
    }
}

/// The counts so far.
#[derive(Default)]
struct FieldCount {
    fields: usize,
    messages: usize,
}

impl FieldCount {
    /// `holder`: name and bound of the field that holds the message.
    fn message(
        &mut self,
        mut bytes: &[u8],
        layout: &MessageLayout,
        holder: Option<(&str, usize)>,
        depth: usize,
    ) -> Result<()> {
        let mut sizes: HashMap<u64, usize> = HashMap::new();
        while !bytes.is_empty() {
            self.fields += 1;
            if self.fields > MOST_FIELDS {
                return Err(Error::invalid("message", format!("more than {MOST_FIELDS} fields")));
            }
            let (number, value) = field(&mut bytes).ok_or_else(unreadable)?;
            let (Some(field), Some(value)) = (layout.fields.get(&number), value) else { continue };
            let FieldLayout { name, longest, repeated, inside, .. } = field;
            let inside = inside.as_ref().and_then(|name| LAYOUTS.messages.get(name));
            let (name, longest) = match holder.filter(|_| layout.is_value) {
                Some((name, longest)) => (name, longest),
                None => (&name[..], *longest),
            };
            let before = sizes.insert(number, value.len());
            if before.is_some() && !repeated {
                return Err(Error::invalid(name, "given twice"));
            }
            let size = before.unwrap_or(0) + value.len();
            sizes.insert(number, size);
            // A file has a name beside its content.
            let beside = if inside.is_some_and(|inside| inside.is_value) { SMALL } else { 0 };
            if size > longest.saturating_add(beside) {
                return Err(Error::invalid(name, format!("{size} bytes are more than {longest}")));
            }
            let Some(inside) = inside else { continue };
            self.messages += 1;
            if self.messages > MOST_MESSAGES || depth >= DEEPEST {
                return Err(Error::invalid(name, "too many values, or nested too deeply"));
            }
            self.message(value, inside, Some((name, longest)), depth + 1)?;
        }
        Ok(())
    }
}

fn unreadable() -> Error {
    Error::invalid("message", "cannot be read: it is no protobuf or is cut off")
}

/// Takes one field off `bytes`: its number, and its value if that has a length. None if this is no valid field.
fn field<'a>(bytes: &mut &'a [u8]) -> Option<(u64, Option<&'a [u8]>)> {
    let key = varint(bytes)?;
    let mut skip = |length: usize| bytes.split_off(..length);
    let value = match key & 7 {
        0 => varint(bytes).map(|_| None)?,
        1 => skip(8).map(|_| None)?,
        2 => {
            let length = usize::try_from(varint(bytes)?).ok()?;
            Some(bytes.split_off(..length)?)
        }
        5 => skip(4).map(|_| None)?,
        // Groups; our messages have none.
        _ => return None,
    };
    Some((key >> 3, value))
}

fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = *bytes.split_off_first()?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests;

//! Messages that are refused by their size before they are unpacked.

use super::*;
use crate::proto::run_session_request::Request;
use crate::proto::{CreateSessionRequest, Reset, RunSessionRequest, SetCommand, Step};
use prost_types::value::Kind;
use prost_types::{ListValue, Struct, Value};
use std::collections::HashSet;

fn of(path: &str) -> &'static MessageLayout {
    of_method(path).unwrap()
}

fn create() -> &'static MessageLayout {
    of("/sandgait.v1.EnvironmentService/CreateSession")
}

fn run() -> &'static MessageLayout {
    of("/sandgait.v1.EnvironmentService/RunSession")
}

fn list(values: Vec<Value>) -> Value {
    Value { kind: Some(Kind::ListValue(ListValue { values })) }
}

fn creation(value: Value) -> Vec<u8> {
    let options = Some(Struct { fields: [("dt".to_owned(), value)].into() });
    CreateSessionRequest { options, ..Default::default() }.encode_to_vec()
}

fn refusal(layout: &MessageLayout, bytes: &[u8]) -> String {
    layout.check(bytes).unwrap_err().to_string()
}

#[test]
fn options_are_counted_before_they_are_unpacked() {
    let empty = |count| list(vec![list(Vec::new()); count]);
    create().check(&creation(empty(1_000))).unwrap();
    assert!(refusal(create(), &creation(empty(5_000))).starts_with("options: too many values"));
    assert!(refusal(create(), &creation(list(vec![Value::default(); 5_000]))).starts_with("options: too many"));
    let nested = |depth| (0..depth).fold(list(Vec::new()), |inner, _| list(vec![inner]));
    create().check(&creation(nested(10))).unwrap();
    assert!(refusal(create(), &creation(nested(40))).starts_with("options: too many values"));
    let text = |length| Value { kind: Some(Kind::StringValue("x".repeat(length))) };
    create().check(&creation(text(250_000))).unwrap();
    let long = refusal(create(), &creation(text(300_000)));
    assert!(long.starts_with("options: 3000") && long.ends_with("bytes are more than 262144"), "{long}");
}

#[test]
fn a_field_that_comes_again_does_not_add_up() {
    let options = Some(Struct { fields: [("leg".to_owned(), list(Vec::new()))].into() });
    let reset = Request::Reset(Reset { options, ..Default::default() });
    let once = RunSessionRequest { request: Some(reset), ..Default::default() }.encode_to_vec();
    run().check(&once).unwrap();
    assert_eq!(refusal(run(), &[&once[..], &once].concat()), "reset: given twice");
}

#[test]
fn fields_are_counted() {
    let step = Request::Step(Step { actions: vec![0; 1 << 20].into(), held: vec![0; 1 << 20].into() });
    let whole = RunSessionRequest { request: Some(step), ..Default::default() }.encode_to_vec();
    run().check(&whole).unwrap();
    // Field 9, a varint, repeated.
    assert!(refusal(run(), &[0x48, 0].repeat(MOST_FIELDS + 1)).starts_with("message: more than"));
    for broken in [&whole[..whole.len() - 1], &[0xff; 20], &[0x0b], &[0x08]] {
        assert!(refusal(run(), broken).starts_with("message: cannot be read"));
    }
}

/// Every name in the table of bounds is a field of a message.
#[test]
fn bounds_are_those_of_fields() {
    let exists = |full: &str| {
        let (message, field) = full.rsplit_once('.').unwrap();
        LAYOUTS.messages.get(message).is_some_and(|m| m.fields.values().any(|f| f.name == field))
    };
    for (name, _) in LONGEST {
        assert!(exists(name), "{name}");
    }
    assert_eq!(methods().count(), 8, "the methods of three services");
}

/// Walks through all fields of all requests: a message, text or list may come once only, unless it is a list, and none
/// is longer than its bound, whatever field it is. A new field has a bound without a line of code.
#[test]
fn every_field_of_every_request_is_bounded() {
    let mut walked = HashSet::new();
    for method in methods() {
        fields_of(of(method), &mut walked);
    }
    assert!(walked.len() > 100, "{}", walked.len());
    let commands = SetCommand { commands: vec![0; 12].into() };
    let message = RunSessionRequest { request: Some(Request::SetCommand(commands)), ..Default::default() };
    let once = message.encode_to_vec();
    assert_eq!(refusal(run(), &[&once[..], &once].concat()), "set_command: given twice");
}

fn fields_of(layout: &'static MessageLayout, walked: &mut HashSet<String>) {
    for (number, field) in &layout.fields {
        let inside = field.inside.as_ref().and_then(|name| LAYOUTS.messages.get(name));
        if !walked.insert(format!("{layout:p} {}", field.name)) {
            continue;
        }
        let one = field_bytes(*number, &[]);
        let twice = layout.check(&[&one[..], &one].concat());
        assert_eq!(twice.is_err(), !field.repeated, "{}", field.name);
        if field.longest < 1 << 20 {
            let refused =
                layout.check(&field_bytes(*number, &vec![0; field.longest + SMALL + 1])).unwrap_err().to_string();
            assert!(refused.contains("bytes are more than"), "{}: {refused}", field.name);
        }
        match inside {
            Some(inside) => fields_of(inside, walked),
            None => {
                let listed = LONGEST.iter().any(|(name, _)| name.ends_with(&field.name));
                assert!(field.longest <= SMALL || listed || layout.is_value, "{}", field.name);
            }
        }
    }
}

/// A field of this number that has a length.
fn field_bytes(number: u64, value: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    prost::encoding::encode_varint(number << 3 | 2, &mut bytes);
    prost::encoding::encode_varint(value.len() as u64, &mut bytes);
    bytes.extend_from_slice(value);
    bytes
}

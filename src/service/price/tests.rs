//! Messages that are refused by their size before they are decoded, and rows of data.

use super::*;
use crate::env::registry::Blueprint;
use crate::proto::{CreateSessionRequest, Reset, RunSessionRequest, Step};
use prost::Message as _;
use prost_types::value::Kind;
use prost_types::{ListValue, Struct, Value};

#[test]
fn rows_end_as_the_reader_ends_them() {
    let memory = 10 * DIAGNOSED_ROW;
    for end in ["\n", "\r", "\r\n"] {
        assert!(check_diagnosis(format!("1{end}").repeat(9).as_bytes(), memory).is_ok(), "{end:?}");
        assert!(check_diagnosis(format!("1{end}").repeat(12).as_bytes(), memory).is_err(), "{end:?}");
    }
}

fn list(values: Vec<Value>) -> Value {
    Value { kind: Some(Kind::ListValue(ListValue { values })) }
}

fn creation(value: Value) -> Vec<u8> {
    let options = Some(Struct { fields: [("dt".to_owned(), value)].into() });
    CreateSessionRequest { options, ..Default::default() }.encode_to_vec()
}

fn refusal(bytes: &[u8], layout: MessageLayout) -> String {
    check(bytes, layout).unwrap_err().to_string()
}

#[test]
fn options_are_counted_before_they_are_unpacked() {
    let empty = |count| list(vec![list(Vec::new()); count]);
    check(&creation(empty(1_000)), &CREATE_SESSION).unwrap();
    assert!(refusal(&creation(empty(5_000)), &CREATE_SESSION).starts_with("options: too many values"));
    assert!(refusal(&creation(list(vec![Value::default(); 5_000])), &CREATE_SESSION).starts_with("options: too many"));
    let nested = |depth| (0..depth).fold(list(Vec::new()), |inner, _| list(vec![inner]));
    check(&creation(nested(10)), &CREATE_SESSION).unwrap();
    assert!(refusal(&creation(nested(40)), &CREATE_SESSION).starts_with("options: too many values"));
    let text = |length| Value { kind: Some(Kind::StringValue("x".repeat(length))) };
    check(&creation(text(250_000)), &CREATE_SESSION).unwrap();
    let long = refusal(&creation(text(300_000)), &CREATE_SESSION);
    assert!(long.starts_with("options: 3000") && long.ends_with("bytes are more than 262144"), "{long}");
}

#[test]
fn a_field_that_comes_again_does_not_add_up() {
    let options = Some(Struct { fields: [("leg".to_owned(), list(Vec::new()))].into() });
    let reset = Request::Reset(Reset { options, ..Default::default() });
    let once = RunSessionRequest { request: Some(reset), ..Default::default() }.encode_to_vec();
    check(&once, &RUN_SESSION).unwrap();
    assert_eq!(refusal(&[&once[..], &once].concat(), &RUN_SESSION), "reset: given twice");
}

#[test]
fn fields_are_counted() {
    let step = Request::Step(Step { actions: vec![0; 1 << 20].into(), held: vec![0; 1 << 20].into() });
    let whole = RunSessionRequest { request: Some(step), ..Default::default() }.encode_to_vec();
    check(&whole, &RUN_SESSION).unwrap();
    // Field 9, a varint, repeated.
    assert!(refusal(&[0x48, 0].repeat(MOST_FIELDS + 1), &RUN_SESSION).starts_with("message: more than"));
    for broken in [&whole[..whole.len() - 1], &[0xff; 20], &[0x0b], &[0x08]] {
        assert!(refusal(broken, &RUN_SESSION).starts_with("message: cannot be read"));
    }
}

/// The price of an observation covers its header, nearly all of which are the shapes of the robot.
#[test]
fn headers_of_observations_are_priced() {
    let go1 = Blueprint::new("sandgait/LeggedVelocity-v1", serde_json::json!({})).unwrap();
    let mut batch = Batch::new(&go1, 1).unwrap();
    let price = |batch: &Batch| of_request(&Request::Observe(proto::Observe::default()), batch).unwrap();
    assert_eq!(price(&batch), 0);
    let reset = batch.reset(None, Some(vec![1]), crate::env::ResetOptions::default()).unwrap();
    batch = crate::pool::Pool::new(1).wait(batch, reset).unwrap();
    let (shapes, header) = (price(&batch) / HEADERS, view::observe(&batch, 0, false).unwrap().0.len());
    assert!(shapes > 1000 && (shapes..shapes + 16_384).contains(&header), "{shapes} of {header}");
}

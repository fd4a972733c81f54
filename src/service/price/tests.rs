//! Prices of answers.

use super::*;
use crate::env::registry::Blueprint;
use serde_json::Value;

/// The price of an observation covers its header, nearly all of which are the shapes of the robot.
#[test]
fn headers_of_observations_are_priced() {
    let go1 = Blueprint::new("sandgait/LeggedVelocity-v1", Value::Null).unwrap();
    let mut batch = Batch::new(&go1, 1).unwrap();
    let price = |batch: &Batch| of_request(&Request::Observe(proto::Observe::default()), batch).unwrap();
    assert_eq!(price(&batch), 0);
    let reset = batch.reset(None, Some(vec![1]), crate::env::ResetOptions::default()).unwrap();
    batch = crate::pool::Pool::new(1).wait(batch, reset).unwrap();
    let (shapes, header) = (price(&batch) / HEADERS, view::observe(&batch, 0, false).unwrap().0.len());
    assert!(shapes > 1000 && (shapes..shapes + 16_384).contains(&header), "{shapes} of {header}");
}

/// The size on the wire tells how much memory an answer takes when it is unpacked: tasks with many columns, with large
/// options, and lists of sessions.
#[test]
fn answers_say_their_size() {
    let note = "a long note; ".repeat(4_000);
    let options = serde_json::json!({"history": 64, "hardware": format!("source = {note:?}")});
    let wide = Blueprint::new("sandgait/HexapodGait-v1", options).unwrap();
    let plain = Blueprint::new("sandgait/LeggedVelocity-v1", Value::Null).unwrap();
    let column = |column: &proto::Column| size_of::<proto::Column>() + column.name.capacity() + column.unit.capacity();
    for blueprint in [wide, plain] {
        let task = crate::encode::task(&blueprint);
        let columns: usize =
            [&task.observation, &task.action, &task.info].iter().map(|c| c.iter().map(column).sum::<usize>()).sum();
        let option = |o: &proto::Option| {
            size_of::<proto::Option>() + o.name.len() + o.summary.len() + value_bytes(&o.default_value)
        };
        let unpacked = columns + task.options.iter().map(option).sum::<usize>();
        let whole = unpacked + task.encoded_len();
        println!("{}: {unpacked} bytes unpacked, {} on the wire", task.id, task.encoded_len());
        assert!(whole <= answer_bytes(&task) && answer_bytes(&task) < 3 * whole, "{whole} {}", answer_bytes(&task));
    }
}

/// Memory of an option's value.
fn value_bytes(value: &Option<prost_types::Value>) -> usize {
    use prost_types::value::Kind;
    let size = size_of::<prost_types::Value>();
    match value.as_ref().and_then(|v| v.kind.as_ref()) {
        Some(Kind::StringValue(text)) => size + text.len(),
        Some(Kind::ListValue(list)) => size + list.values.iter().map(|v| value_bytes(&Some(v.clone()))).sum::<usize>(),
        Some(Kind::StructValue(table)) => {
            // A node of a map has eleven entries, six of which are used at least.
            let entry = |(key, v): (&String, &prost_types::Value)| 2 * (key.len() + 24 + value_bytes(&Some(v.clone())));
            size + table.fields.iter().map(entry).sum::<usize>()
        }
        _ => size,
    }
}

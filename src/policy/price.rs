//! What a network costs at most. Every file is checked against these bounds before it takes the memory or the time that
//! it asks for.
//!
//! | part | bound |
//! |---|---|
//! | reading a file of n bytes | [`reading_bytes`] |
//! | fields of the file, counted before it is decoded | [`MOST_FIELDS`] |
//! | numbers that one observation makes: the widths of all steps | [`MOST_VALUES`] |
//! | products of one observation | [`MOST_PRODUCTS`] |

use super::Lanes;
use super::operator::{Operator, Program};
use crate::error::{Error, Result};
use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

/// Limits of a network: our choice, far above the needs of walking. The largest network takes some milliseconds for a shard.
pub const MOST_NODES: usize = 256;
pub const MOST_WIDTH: usize = 4096;
pub const MOST_PRODUCTS: usize = 2 << 20;
/// Our choice, sixteen layers of [`MOST_WIDTH`].
pub const MOST_VALUES: usize = 16 * MOST_WIDTH;
/// Largest number of fields of a file: our choice, 64 for each node. Weights are one field.
const MOST_FIELDS: usize = 64 * MOST_NODES;
/// Largest memory that a field of two bytes takes when it is decoded [bytes]: its struct, with its part of the spare
/// room of the list that holds it. A test measures it.
const FIELD: usize = 512;

/// What a network costs while it is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Price {
    /// Memory of the network itself, once [bytes].
    pub bytes: usize,
    /// Memory of each thread that computes actions [bytes].
    pub scratch_bytes: usize,
    /// Products, sums and function values of one action.
    pub operations: usize,
}

impl Price {
    pub(super) fn of(program: &Program, observation: usize) -> Self {
        let values = observation + program.steps.iter().map(|step| step.width).sum::<usize>();
        let of_step = |operator: &Operator| match operator {
            Operator::Dense { weights, bias, .. } => [weights.len() + bias.len(), weights.len()],
            Operator::Both { left, right, .. } => [left.constants() + right.constants(), 0],
            Operator::Concat { inputs } => [2 * inputs.len(), 0],
            Operator::Each { .. } => [0, 0],
        };
        let sums =
            program.steps.iter().map(|step| of_step(&step.operator)).fold([0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
        Self {
            bytes: size_of_val(&program.steps[..]) + size_of::<f32>() * sums[0],
            scratch_bytes: size_of::<Lanes>() * values,
            operations: values + sums[1],
        }
    }
}

/// Largest memory that reading a file of `file` bytes takes, besides the file itself [bytes]. An integer of one byte
/// becomes eight bytes, then four more as a constant. The program has at most [`MOST_PRODUCTS`] weights.
pub const fn reading_bytes(file: usize) -> usize {
    let fields = if file / 2 < MOST_FIELDS { file / 2 } else { MOST_FIELDS };
    // A list doubles when it grows, and meanwhile holds both its old and its new memory.
    3 * (8 + 4) * file + FIELD * fields + size_of::<f32>() * (MOST_PRODUCTS + 2 * MOST_VALUES)
}

/// The messages inside a message, by their fields' numbers.
struct NestedMessages(&'static [(u32, &'static NestedMessages)]);

static PLAIN: NestedMessages = NestedMessages(&[]);
static SHAPE: NestedMessages = NestedMessages(&[(1, &PLAIN)]);
static TENSOR_TYPE: NestedMessages = NestedMessages(&[(2, &SHAPE)]);
static TYPE: NestedMessages = NestedMessages(&[(1, &TENSOR_TYPE)]);
static VALUE_INFO: NestedMessages = NestedMessages(&[(2, &TYPE)]);
static ATTRIBUTE: NestedMessages = NestedMessages(&[(5, &PLAIN)]);
static NODE: NestedMessages = NestedMessages(&[(5, &ATTRIBUTE)]);
static GRAPH: NestedMessages = NestedMessages(&[(1, &NODE), (5, &PLAIN), (11, &VALUE_INFO), (12, &VALUE_INFO)]);
static MODEL: NestedMessages = NestedMessages(&[(7, &GRAPH), (8, &PLAIN)]);

/// Refuses a file with more than [`MOST_FIELDS`] fields in the messages that [`super::format`] decodes.
pub fn check_fields(onnx: &[u8]) -> Result<()> {
    count(onnx, &MODEL, &mut 0)
}

fn count(mut bytes: &[u8], layout: &NestedMessages, fields: &mut usize) -> Result<()> {
    let unreadable = |e: &dyn std::fmt::Display| Error::invalid("policy", format!("this is no ONNX file: {e}"));
    while !bytes.is_empty() {
        *fields += 1;
        if *fields > MOST_FIELDS {
            let reason = format!("it has more than {MOST_FIELDS} fields; are the weights packed, as in `raw_data`?");
            return Err(Error::invalid("policy", reason));
        }
        let (tag, kind) = decode_key(&mut bytes).map_err(|e| unreadable(&e))?;
        match layout.0.iter().find(|(number, _)| *number == tag) {
            Some((_, inside)) if kind == WireType::LengthDelimited => {
                let length = decode_varint(&mut bytes).map_err(|e| unreadable(&e))?;
                let length = usize::try_from(length).unwrap_or(usize::MAX);
                let part = bytes.split_off(..length).ok_or_else(|| unreadable(&"it is cut off"))?;
                count(part, inside, fields)?;
            }
            _ => skip_field(kind, tag, &mut bytes, DecodeContext::default()).map_err(|e| unreadable(&e))?,
        }
    }
    Ok(())
}

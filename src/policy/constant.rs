//! Weights and other numbers that do not depend on the observation.

use super::format::{DOUBLE, FLOAT, INT64, Tensor};
use crate::error::{Error, Result};

/// The beginning of a name in the file, because the whole name may be long. Our choice: 100 characters fit in a line.
pub(super) fn shown(name: &str) -> &str {
    name.char_indices().nth(100).map_or(name, |(end, _)| &name[..end])
}

/// Numbers of at most two dimensions, row-major. Integers and `f64` are rounded to `f32`.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    /// Sizes of the dimensions; empty for a single number.
    pub dims: Vec<usize>,
    pub data: Vec<f32>,
}

impl Constant {
    pub fn read(name: &str, tensor: &Tensor) -> Result<Self> {
        let wrong = |why: String| Error::invalid("policy", format!("the numbers of {:?} {why}", shown(name)));
        if tensor.data_location != 0 {
            return Err(wrong("are in another file; export everything into one file".into()));
        }
        if tensor.dims.len() > 2 {
            return Err(wrong(format!("have {} dimensions; 2 are the most", tensor.dims.len())));
        }
        let dims = tensor.dims.iter().map(|d| usize::try_from(*d)).collect::<std::result::Result<Vec<_>, _>>();
        let dims = dims.map_err(|_| wrong("have a negative dimension".into()))?;
        let data = match tensor.data_type {
            FLOAT => numbers(&tensor.float_data, &tensor.raw_data, f32::from_le_bytes, |x| x),
            INT64 => numbers(&tensor.int64_data, &tensor.raw_data, i64::from_le_bytes, |x| x as f32),
            DOUBLE => numbers(&tensor.double_data, &tensor.raw_data, f64::from_le_bytes, |x| x as f32),
            other => return Err(wrong(format!("are of type {other}; f32, f64 and i64 are known"))),
        };
        let data = data.ok_or_else(|| wrong("are cut off".into()))?;
        let expected = dims.iter().try_fold(1_usize, |n, d| n.checked_mul(*d));
        if expected != Some(data.len()) {
            return Err(wrong(format!("are {}, which does not suit their shape {dims:?}", data.len())));
        }
        Ok(Self { dims, data })
    }

    /// The numbers as integers, for a shape. `f32` is exact for such small integers.
    pub fn whole(&self) -> Vec<i64> {
        self.data.iter().map(|x| *x as i64).collect()
    }

    /// The number, if there is only one.
    pub fn scalar(&self) -> Option<f32> {
        if let [x] = self.data[..] { Some(x) } else { None }
    }

    /// The numbers as a row that can be added to, or multiplied with, every environment's row: [1], [k] or [1, k].
    pub fn row(&self) -> Option<&[f32]> {
        match self.dims[..] {
            [] | [_] | [1, _] => Some(&self.data),
            _ => None,
        }
    }
}

/// The numbers, which the file has in one of two fields; None if the number of bytes is wrong.
fn numbers<T: Copy, const N: usize>(
    typed: &[T],
    raw: &[u8],
    read: fn([u8; N]) -> T,
    convert: fn(T) -> f32,
) -> Option<Vec<f32>> {
    let (whole, rest) = raw.as_chunks::<N>();
    if whole.is_empty() {
        return rest.is_empty().then(|| typed.iter().map(|x| convert(*x)).collect());
    }
    rest.is_empty().then(|| whole.iter().map(|bytes| convert(read(*bytes))).collect())
}

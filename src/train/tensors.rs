//! Named arrays of numbers in one file: the format safetensors (huggingface.co/docs/safetensors), which Python reads too.
//!
//! ```text
//!  length of the header u64 │ header: JSON, name → dtype, shape, place of its bytes; texts under "__metadata__" │ bytes
//! ```

use crate::error::{Error, Result};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Largest file that is read [bytes]: our choice. A usual one has 1 MiB, nearly all of it environments.
const MOST: u64 = 1 << 30;

/// An array; its numbers are stored unchanged.
#[derive(Clone, Debug, PartialEq)]
pub enum Numbers {
    F32(Vec<f32>),
    F64(Vec<f64>),
    I64(Vec<i64>),
    U8(Vec<u8>),
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors {
    /// Texts by their names.
    pub about: Map<String, Value>,
    arrays: Vec<(String, Vec<usize>, Numbers)>,
}

impl Tensors {
    pub fn add(&mut self, name: impl Into<String>, shape: &[usize], numbers: Numbers) {
        self.arrays.push((name.into(), shape.to_vec(), numbers));
    }

    pub fn f32(&self, name: &str, count: usize) -> Result<Vec<f32>> {
        match self.get(name)? {
            Numbers::F32(numbers) if numbers.len() == count => Ok(numbers.clone()),
            _ => Err(wrong(format!("{name:?} is not {count} numbers of f32"))),
        }
    }

    pub fn f64(&self, name: &str, count: usize) -> Result<Vec<f64>> {
        match self.get(name)? {
            Numbers::F64(numbers) if numbers.len() == count => Ok(numbers.clone()),
            _ => Err(wrong(format!("{name:?} is not {count} numbers of f64"))),
        }
    }

    pub fn bytes(&self, name: &str) -> Result<Vec<u8>> {
        match self.get(name)? {
            Numbers::U8(bytes) => Ok(bytes.clone()),
            _ => Err(wrong(format!("{name:?} is not bytes"))),
        }
    }

    fn get(&self, name: &str) -> Result<&Numbers> {
        let found = self.arrays.iter().find(|(n, ..)| n == name);
        found.map(|(.., numbers)| numbers).ok_or_else(|| wrong(format!("it has no {name:?}")))
    }

    pub fn has(&self, name: &str) -> bool {
        self.get(name).is_ok()
    }

    /// A text under "__metadata__".
    pub fn text(&self, name: &str) -> Result<&str> {
        self.about.get(name).and_then(Value::as_str).ok_or_else(|| wrong(format!("it does not say its {name}")))
    }

    pub fn encode(&self) -> Vec<u8> {
        let (mut header, mut bytes) = (Map::new(), Vec::new());
        header.insert("__metadata__".into(), Value::Object(self.about.clone()));
        for (name, shape, numbers) in &self.arrays {
            let start = bytes.len();
            let dtype = match numbers {
                Numbers::F32(all) => {
                    bytes.extend(all.iter().flat_map(|x| x.to_le_bytes()));
                    "F32"
                }
                Numbers::F64(all) => {
                    bytes.extend(all.iter().flat_map(|x| x.to_le_bytes()));
                    "F64"
                }
                Numbers::I64(all) => {
                    bytes.extend(all.iter().flat_map(|x| x.to_le_bytes()));
                    "I64"
                }
                Numbers::U8(all) => {
                    bytes.extend_from_slice(all);
                    "U8"
                }
            };
            let entry = json!({"dtype": dtype, "shape": shape, "data_offsets": [start, bytes.len()]});
            header.insert(name.clone(), entry);
        }
        let mut header = Value::Object(header).to_string().into_bytes();
        // Blanks at the end of the header align the numbers.
        header.resize(header.len().next_multiple_of(8), b' ');
        [&(header.len() as u64).to_le_bytes()[..], &header, &bytes].concat()
    }

    pub fn decode(file: &[u8]) -> Result<Self> {
        let (length, rest) = file.split_first_chunk::<8>().ok_or_else(|| wrong("it is cut off"))?;
        let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
        let (header, bytes) = rest.split_at_checked(length).ok_or_else(|| wrong("it is cut off"))?;
        let header: Map<String, Value> =
            serde_json::from_slice(header).map_err(|e| wrong(format!("its header is not JSON: {e}")))?;
        let mut tensors = Self::default();
        for (name, entry) in &header {
            if name == "__metadata__" {
                tensors.about = entry.as_object().cloned().unwrap_or_default();
                continue;
            }
            let numbers = array(entry, bytes).ok_or_else(|| wrong(format!("{name:?} is not as its header says")))?;
            tensors.arrays.push((name.clone(), numbers.0, numbers.1));
        }
        Ok(tensors)
    }

    pub fn load(path: &Path) -> Result<Self> {
        let broken = |e: &dyn std::fmt::Display| Error::file(path, e);
        let size = std::fs::metadata(path).map_err(|e| broken(&e))?.len();
        if size > MOST {
            return Err(broken(&format!("{size} bytes are more than {MOST}")));
        }
        let bytes = std::fs::read(path).map_err(|e| broken(&e))?;
        Self::decode(&bytes).map_err(|e| Error::file(path, e))
    }

    /// Writes a temporary file and renames it, so that readers find either the old file or the new one, complete.
    pub fn save(&self, path: &Path) -> Result<()> {
        let beside = path.with_extension("partial");
        std::fs::write(&beside, self.encode()).map_err(|e| Error::file(&beside, e))?;
        std::fs::rename(&beside, path).map_err(|e| Error::file(path, e))
    }
}

fn wrong(why: impl Into<String>) -> Error {
    Error::invalid("checkpoint", why)
}

fn array(entry: &Value, bytes: &[u8]) -> Option<(Vec<usize>, Numbers)> {
    let whole = |v: &Value| v.as_u64().and_then(|n| usize::try_from(n).ok());
    let list = |name: &str| entry[name].as_array()?.iter().map(whole).collect::<Option<Vec<_>>>();
    let (shape, [start, end]) = (list("shape")?, <[usize; 2]>::try_from(list("data_offsets")?).ok()?);
    let bytes = bytes.get(start..end)?;
    let count = shape.iter().try_fold(1_usize, |n, d| n.checked_mul(*d))?;
    let numbers = match entry["dtype"].as_str()? {
        "F32" => Numbers::F32(cut(bytes, count, f32::from_le_bytes)?),
        "F64" => Numbers::F64(cut(bytes, count, f64::from_le_bytes)?),
        "I64" => Numbers::I64(cut(bytes, count, i64::from_le_bytes)?),
        "U8" => Numbers::U8(cut(bytes, count, u8::from_le_bytes)?),
        _ => return None,
    };
    Some((shape, numbers))
}

fn cut<T, const N: usize>(bytes: &[u8], count: usize, read: fn([u8; N]) -> T) -> Option<Vec<T>> {
    let (all, rest) = bytes.as_chunks::<N>();
    (rest.is_empty() && all.len() == count).then(|| all.iter().map(|b| read(*b)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read() {
        let mut tensors = Tensors::default();
        tensors.about.insert("task".into(), "a".into());
        tensors.add("x", &[2, 1], Numbers::F32(vec![1.5, f32::MIN_POSITIVE]));
        tensors.add("y", &[], Numbers::F64(vec![0.1]));
        tensors.add("z", &[1], Numbers::I64(vec![-7]));
        let bytes = tensors.encode();
        let read = Tensors::decode(&bytes).unwrap();
        assert_eq!(read.f32("x", 2).unwrap(), [1.5, f32::MIN_POSITIVE]);
        assert_eq!((read.f64("y", 1).unwrap(), read.text("task").unwrap()), (vec![0.1], "a"));
        assert!(read.f32("y", 1).is_err() && read.f32("x", 3).is_err() && !read.has("w"));
        // A file that was cut off or changed gives an error or valid numbers.
        for end in 0..bytes.len() {
            assert!(Tensors::decode(&bytes[..end]).is_err());
        }
        for place in 0..bytes.len() {
            let mut other = bytes.clone();
            other[place] ^= 0x11;
            let _ = Tensors::decode(&other);
        }
    }
}

//! A safetensors file (huggingface.co/docs/safetensors) being written or read: named arrays, and texts under
//! "__metadata__". Python reads these files too.

use crate::error::{Error, Result};
use crate::files;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::path::Path;

/// Largest file that is written or read [bytes]: our choice, to bound the memory of a reader, which needs three times as
/// much. A usual one has 1 MiB, nearly all of it environments.
pub const MOST: u64 = 4 << 30;

/// Length of a file's header for each array, and for all texts together, at most [bytes]: our choice, ten times that of
/// usual files. A file's size is estimated before it is made.
const HEAD: usize = 1 << 10;
const TEXTS: usize = 4 << 20;

/// A number of an array, stored unchanged.
pub trait TensorNumber: Copy {
    const TYPE: Dtype;
    fn bytes(self) -> impl IntoIterator<Item = u8>;
    fn read(bytes: &[u8]) -> Option<Vec<Self>>;
}

macro_rules! elements {
    ($($number:ty: $name:ident),*) => {$(
        impl TensorNumber for $number {
            const TYPE: Dtype = Dtype::$name;

            fn bytes(self) -> impl IntoIterator<Item = u8> {
                self.to_le_bytes()
            }

            fn read(bytes: &[u8]) -> Option<Vec<Self>> {
                let (all, rest) = bytes.as_chunks();
                rest.is_empty().then(|| all.iter().map(|b| Self::from_le_bytes(*b)).collect())
            }
        }
    )*};
}

elements!(f32: F32, f64: F64, i64: I64, u8: U8);

/// Name of the text with [`Tensors::digest`].
const DIGEST: &str = "sha256";

#[derive(Default)]
pub struct Tensors {
    /// Texts by their names.
    pub about: HashMap<String, String>,
    /// Type, shape and bytes by name.
    arrays: HashMap<String, (Dtype, Vec<usize>, Vec<u8>)>,
}

impl Tensors {
    pub fn add<T: TensorNumber>(&mut self, name: impl Into<String>, shape: &[usize], numbers: &[T]) {
        let bytes = numbers.iter().flat_map(|x| x.bytes()).collect();
        self.arrays.insert(name.into(), (T::TYPE, shape.to_vec(), bytes));
    }

    /// The `count` numbers of an array.
    pub fn get<T: TensorNumber>(&self, name: &str, count: usize) -> Result<Vec<T>> {
        let all = self.all::<T>(name)?;
        if all.len() == count { Ok(all) } else { Err(wrong(format!("{name:?} has not {count} numbers"))) }
    }

    /// All numbers of an array.
    pub fn all<T: TensorNumber>(&self, name: &str) -> Result<Vec<T>> {
        match self.arrays.get(name) {
            Some((dtype, _, bytes)) if *dtype == T::TYPE => {
                T::read(bytes).ok_or_else(|| wrong(format!("{name:?} is cut off")))
            }
            Some((dtype, ..)) => Err(wrong(format!("{name:?} is {dtype}, not {}", T::TYPE))),
            None => Err(wrong(format!("it has no {name:?}"))),
        }
    }

    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// A text under "__metadata__".
    pub fn text(&self, name: &str) -> Result<&str> {
        self.about.get(name).map(String::as_str).ok_or_else(|| wrong(format!("it does not say its {name}")))
    }

    /// Size of the file, if `more` bytes are added: not less than it will be.
    pub fn size_with(&self, more: usize) -> u64 {
        let texts: usize = self.about.iter().map(|(name, text)| 2 * (name.len() + text.len())).sum();
        let arrays: usize = self.arrays.values().map(|(.., bytes)| HEAD + bytes.len()).sum();
        (TEXTS + texts + arrays + more) as u64
    }

    /// SHA-256 of all texts but itself and of all arrays, in the order of their names.
    fn digest(&self) -> String {
        let mut hash = Sha256::new();
        let mut about: Vec<_> = self.about.iter().filter(|(name, _)| *name != DIGEST).collect();
        about.sort();
        let mut add = |bytes: &[u8]| {
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        };
        about.iter().for_each(|(name, text)| [name, text].iter().for_each(|t| add(t.as_bytes())));
        let mut arrays: Vec<_> = self.arrays.iter().collect();
        arrays.sort_by_key(|(name, _)| *name);
        for (name, (dtype, shape, bytes)) in arrays {
            [name.as_bytes(), format!("{dtype} {shape:?}").as_bytes(), bytes].iter().for_each(|b| add(b));
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    fn encode(&self) -> Result<Vec<u8>> {
        let broken = |e| wrong(format!("it cannot be written: {e}"));
        let mut views = Vec::with_capacity(self.arrays.len());
        for (name, (dtype, shape, bytes)) in &self.arrays {
            views.push((name, TensorView::new(*dtype, shape.clone(), bytes).map_err(broken)?));
        }
        let mut about = self.about.clone();
        about.insert(DIGEST.into(), self.digest());
        safetensors::serialize(views, Some(about)).map_err(broken)
    }

    fn decode(file: &[u8]) -> Result<Self> {
        let broken = |e| wrong(format!("it is cut off or broken: {e}"));
        let (_, header) = SafeTensors::read_metadata(file).map_err(broken)?;
        let all = SafeTensors::deserialize(file).map_err(broken)?;
        let array = |(name, view): (&str, TensorView)| {
            (name.to_owned(), (view.dtype(), view.shape().to_vec(), view.data().to_vec()))
        };
        let about = header.metadata().clone().unwrap_or_default();
        let read = Self { about, arrays: all.iter().map(array).collect() };
        // Files of earlier versions have no digest.
        match read.about.get(DIGEST) {
            Some(digest) if *digest != read.digest() => Err(wrong("it is damaged: its SHA-256 is another")),
            _ => Ok(read),
        }
    }

    pub fn load(path: &Path) -> Result<Self> {
        let broken = |e: &dyn std::fmt::Display| Error::file(path, e);
        let size = std::fs::metadata(path).map_err(|e| broken(&e))?.len();
        if size > MOST {
            return Err(broken(&too_large(size)));
        }
        let bytes = std::fs::read(path).map_err(|e| broken(&e))?;
        Self::decode(&bytes).map_err(|e| match e {
            Error::Invalid { reason, .. } => broken(&reason),
            other => other,
        })
    }

    /// Writes a file that [`Self::load`] reads.
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes = self.encode()?;
        if bytes.len() as u64 > MOST {
            return Err(wrong(too_large(bytes.len() as u64)));
        }
        files::write(path, &bytes)
    }
}

fn too_large(size: u64) -> String {
    format!("{size} bytes are more than {MOST}")
}

fn wrong(why: impl Into<String>) -> Error {
    Error::invalid("checkpoint", why)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read() {
        let mut tensors = Tensors::default();
        tensors.about.insert("task".into(), "a".into());
        tensors.add("x", &[2, 1], &[1.5, f32::MIN_POSITIVE]);
        tensors.add("y", &[], &[0.1]);
        tensors.add("z", &[1], &[-7_i64]);
        let bytes = tensors.encode().unwrap();
        let read = Tensors::decode(&bytes).unwrap();
        assert_eq!(read.get::<f32>("x", 2).unwrap(), [1.5, f32::MIN_POSITIVE]);
        assert_eq!((read.get("y", 1).unwrap(), read.text("task").unwrap()), (vec![0.1], "a"));
        assert!(read.get::<f32>("y", 1).is_err() && read.get::<f32>("x", 3).is_err() && !read.has("w"));
        // A file that was cut off, or whose arrays were changed, gives an error; a changed header an error or the same.
        let arrays = bytes.len() - (2 * size_of::<f32>() + size_of::<f64>() + size_of::<i64>());
        for end in 0..bytes.len() {
            assert!(Tensors::decode(&bytes[..end]).is_err());
        }
        for place in 0..bytes.len() {
            let mut other = bytes.clone();
            other[place] ^= 0x11;
            assert!(Tensors::decode(&other).is_err() || place < arrays);
        }
    }
}

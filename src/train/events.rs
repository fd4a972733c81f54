//! Files that TensorBoard reads: records with checksums (TFRecord), each a protobuf message `tensorflow.Event`.

use crate::error::{Error, Result};
use prost::Message as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// A subset of `tensorflow/core/util/event.proto` (Apache-2.0).
#[derive(Clone, PartialEq, prost::Message)]
struct TensorBoardEvent {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<EventSummary>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct EventSummary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Scalar>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Scalar {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// An open file.
pub struct EventFile {
    file: File,
    path: PathBuf,
}

/// Seconds since 1970.
fn now() -> f64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

impl EventFile {
    /// A new file in `folder`, which is created if necessary; TensorBoard joins the files of a folder.
    pub fn new(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(|e| Error::unwritten(folder, &e))?;
        let path = folder.join(format!("events.out.tfevents.{:.0}.sandgait.{}", now() * 1e3, std::process::id()));
        let file = File::create(&path).map_err(|e| Error::unwritten(&path, &e))?;
        let mut events = Self { file, path };
        events.write(&TensorBoardEvent {
            wall_time: now(),
            file_version: Some("brain.Event:2".into()),
            ..TensorBoardEvent::default()
        })?;
        Ok(events)
    }

    /// Writes numbers with their tags; a number that is not finite is left out.
    pub fn scalars(&mut self, step: u64, scalars: &[(&str, f64)]) -> Result<()> {
        let known = scalars.iter().filter(|(_, value)| value.is_finite());
        let value =
            known.map(|(tag, value)| Scalar { tag: (*tag).into(), simple_value: Some(*value as f32) }).collect();
        self.write(&TensorBoardEvent {
            wall_time: now(),
            step: step as i64,
            summary: Some(EventSummary { value }),
            ..TensorBoardEvent::default()
        })
    }

    fn write(&mut self, event: &TensorBoardEvent) -> Result<()> {
        self.file.write_all(&record(&event.encode_to_vec())).map_err(|e| Error::unwritten(&self.path, &e))
    }
}

/// Length, its checksum, content, its checksum; little-endian.
fn record(content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    let sum = |bytes: &[u8]| masked(crc32c(bytes)).to_le_bytes();
    [&length[..], &sum(&length), content, &sum(content)].concat()
}

/// TFRecord's mask for checksums, which avoids problems with checksums of data that contain checksums.
fn masked(crc: u32) -> u32 {
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

/// Cyclic redundancy check by the polynomial of Castagnoli (RFC 3720, appendix B.4).
fn crc32c(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// RFC 3720, appendix B.4.
    #[test]
    fn checksums_are_those_of_the_standard() {
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(crc32c(&(0..32).collect::<Vec<u8>>()), 0x46dd_794e);
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
    }
}

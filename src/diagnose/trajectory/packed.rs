//! Decompression of parts of a log, by libraries written in Rust. The file states the size of each part; a part that is larger than
//! this, or than [`LARGEST`], is an error before more memory is used.

use lz4_flex::block;
use lz4_flex::frame::FrameDecoder;
use ruzstd::decoding::StreamingDecoder;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use std::io::Read;

/// Largest size of a part after decompression [bytes]: our choice; writers make parts of about a megabyte. It is also the largest
/// window of zstd.
pub const LARGEST: u64 = 64 << 20;

/// Compression of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Packing {
    Plain,
    Gzip,
    /// One block without a frame, as in Parquet.
    Lz4Block,
    Lz4,
    Snappy,
    Zstd,
}

type Unpacked<T> = std::result::Result<T, String>;

impl Packing {
    /// Decompresses a part whose stated size is `size` bytes.
    pub fn unpack(self, packed: &[u8], size: u64) -> Unpacked<Vec<u8>> {
        if size > LARGEST {
            return Err(format!("a compressed part has {} MiB; at most {} MiB are read", size >> 20, LARGEST >> 20));
        }
        let mut all = Vec::new();
        match self {
            Self::Plain => all.extend_from_slice(packed),
            Self::Gzip => more(flate2::read::MultiGzDecoder::new(packed), size, &mut all)?,
            Self::Lz4 => more(FrameDecoder::new(packed), size, &mut all)?,
            Self::Zstd => zstd(packed, size, &mut all)?,
            Self::Lz4Block => all = block::decompress(packed, size as usize).map_err(|e| format!("lz4: {e}"))?,
            // The library allocates the size that the part itself states, so this is compared first.
            Self::Snappy if snap::raw::decompress_len(packed).ok() == Some(size as usize) => {
                all = snap::raw::Decoder::new().decompress_vec(packed).map_err(|e| e.to_string())?;
            }
            Self::Snappy => return Err(other(size)),
        }
        match all.len() as u64 == size {
            true => Ok(all),
            false => Err(other(size)),
        }
    }
}

fn other(size: u64) -> String {
    format!("a compressed part does not have the {size} bytes that the file states")
}

/// Reads at most one byte more than the stated size.
fn more(source: impl Read, size: u64, all: &mut Vec<u8>) -> Unpacked<()> {
    let left = (size + 1).saturating_sub(all.len() as u64);
    source.take(left).read_to_end(all).map(drop).map_err(|e| e.to_string())
}

/// Decompresses all frames of a part; skippable frames have no data.
fn zstd(mut packed: &[u8], size: u64, all: &mut Vec<u8>) -> Unpacked<()> {
    while !packed.is_empty() && all.len() as u64 <= size {
        match StreamingDecoder::new_with_max_window_size(&mut packed, LARGEST) {
            Ok(frame) => more(frame, size, all)?,
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                packed = packed.get(length as usize..).ok_or("zstd: a frame is longer than its part")?;
            }
            Err(e) => return Err(format!("zstd: {e}")),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{LARGEST, Packing};
    use std::io::Write;

    /// 3,000 bytes with a repeating pattern.
    fn plain() -> Vec<u8> {
        (0..3000u32).map(|i| (i % 251) as u8).collect()
    }

    /// The same bytes in each compression. Files compressed by the reference implementations of zstd and lz4 are in readers.rs.
    fn all() -> Vec<(Packing, Vec<u8>)> {
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        gzip.write_all(&plain()).unwrap();
        let mut lz4 = lz4_flex::frame::FrameEncoder::new(Vec::new());
        lz4.write_all(&plain()).unwrap();
        let zstd = ruzstd::encoding::compress_to_vec(&plain()[..], ruzstd::encoding::CompressionLevel::Fastest);
        vec![
            (Packing::Plain, plain()),
            (Packing::Gzip, gzip.finish().unwrap()),
            (Packing::Lz4Block, lz4_flex::block::compress(&plain())),
            (Packing::Lz4, lz4.finish().unwrap()),
            (Packing::Snappy, snap::raw::Encoder::new().compress_vec(&plain()).unwrap()),
            (Packing::Zstd, zstd),
        ]
    }

    #[test]
    fn parts_of_another_size_are_refused() {
        for (packing, packed) in all() {
            assert_eq!(packing.unpack(&packed, 3000).as_ref(), Ok(&plain()), "{packing:?}");
            for size in [0, 1, 2999, 3001, LARGEST] {
                assert!(packing.unpack(&packed, size).is_err(), "{packing:?} {size}");
            }
            assert!(packing.unpack(&packed, LARGEST + 1).unwrap_err().contains("at most 64 MiB"));
            assert!(packing.unpack(&packed[..packed.len() - 5], 3000).is_err(), "{packing:?}");
        }
    }

    /// A skippable frame, then two frames of data.
    #[test]
    fn zstd_reads_several_frames() {
        let data = all().pop().unwrap().1;
        let note = [0x50, 0x2a, 0x4d, 0x18, 3, 0, 0, 0, 1, 2, 3];
        let twice = [plain(), plain()].concat();
        assert_eq!(Packing::Zstd.unpack(&[&note[..], &data, &data].concat(), 6000), Ok(twice));
        assert!(Packing::Zstd.unpack(&note[..9], 0).is_err());
    }
}

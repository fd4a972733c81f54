//! Packed parts of logs, unpacked by decompressors in Rust. What a part says of its own size is believed up to the reader's limit, and
//! nothing is kept beyond it.

use lz4_flex::block;
use lz4_flex::frame::FrameDecoder;
use ruzstd::decoding::StreamingDecoder;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use std::io::Read;

/// Largest part, unpacked [bytes]: our choice, writers make parts of about a megabyte. Also the window of zstd, which is kept beside it.
pub const LARGEST: u64 = 64 << 20;

/// How a part is packed.
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
    /// Unpacks a part that says it has `size` bytes.
    pub fn unpack(self, packed: &[u8], size: u64) -> Unpacked<Vec<u8>> {
        if size > LARGEST {
            return Err(format!("a part of {} MiB; at most {} MiB are read", size >> 20, LARGEST >> 20));
        }
        let mut all = Vec::new();
        match self {
            Self::Plain => all.extend_from_slice(packed),
            Self::Gzip => more(flate2::read::MultiGzDecoder::new(packed), size, &mut all)?,
            Self::Lz4 => more(FrameDecoder::new(packed), size, &mut all)?,
            Self::Zstd => zstd(packed, size, &mut all)?,
            Self::Lz4Block => all = block::decompress(packed, size as usize).map_err(|e| format!("lz4: {e}"))?,
            // Its own word counts, so that it is looked at first.
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
    format!("a part that says it has {size} bytes has others")
}

/// Reads until there is one byte more than there should be.
fn more(source: impl Read, size: u64, all: &mut Vec<u8>) -> Unpacked<()> {
    let left = (size + 1).saturating_sub(all.len() as u64);
    source.take(left).read_to_end(all).map(drop).map_err(|e| e.to_string())
}

/// Frames one after the other; those that carry something else are passed over.
fn zstd(mut packed: &[u8], size: u64, all: &mut Vec<u8>) -> Unpacked<()> {
    while !packed.is_empty() && all.len() as u64 <= size {
        match StreamingDecoder::new_with_max_window_size(&mut packed, LARGEST) {
            Ok(frame) => more(frame, size, all)?,
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                packed = packed.get(length as usize..).ok_or("zstd: a frame reaches beyond its part")?;
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

    /// 3,000 bytes that repeat.
    fn plain() -> Vec<u8> {
        (0..3000u32).map(|i| (i % 251) as u8).collect()
    }

    /// The same bytes by each packer; those of zstd and lz4 frames are of the reference implementations (see readers.rs).
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
    fn parts_are_as_large_as_they_say() {
        for (packing, packed) in all() {
            assert_eq!(packing.unpack(&packed, 3000).as_ref(), Ok(&plain()), "{packing:?}");
            for size in [0, 1, 2999, 3001, LARGEST] {
                assert!(packing.unpack(&packed, size).is_err(), "{packing:?} {size}");
            }
            assert!(packing.unpack(&packed, LARGEST + 1).unwrap_err().contains("at most 64 MiB"));
            assert!(packing.unpack(&packed[..packed.len() - 5], 3000).is_err(), "{packing:?}");
        }
    }

    /// A frame that is passed over, then two of data.
    #[test]
    fn zstd_has_frames() {
        let data = all().pop().unwrap().1;
        let note = [0x50, 0x2a, 0x4d, 0x18, 3, 0, 0, 0, 1, 2, 3];
        let twice = [plain(), plain()].concat();
        assert_eq!(Packing::Zstd.unpack(&[&note[..], &data, &data].concat(), 6000), Ok(twice));
        assert!(Packing::Zstd.unpack(&note[..9], 0).is_err());
    }
}

//! Heights of a file as one text, which a client sends to a server: `heights:` and a zlib stream in base64. The stream
//! holds the numbers of rows and columns (u16). Then for each node it holds a height as a variable-length integer, in
//! steps of [`STEP`]: the node's height above the plane through the three neighbours before it. Smooth ground takes
//! about a byte a node.

use crate::error::{Error, Result};
use base64::prelude::{BASE64_STANDARD, Engine as _};
use std::io::{Read, Write};

/// Heights are rounded to this [m]: our choice, a tenth of what a foot sinks into hard ground.
const STEP: f64 = 1e-4;
/// Longest text [bytes]: our choice, half of a session's options (256 KiB); a robot's file takes some of the other half.
const MOST_TEXT: usize = 128 << 10;
/// Largest number of heights: 512 × 512, as many as [`super::relief::Relief::new`] accepts.
const MOST: usize = 1 << 18;
/// Largest number of bytes of a packed height: our choice, because heights within 100 m need four of seven bits each.
const LONGEST: usize = 5;
/// The prefix of packed texts.
pub const MARK: &str = "heights:";

/// Does this text claim to be packed heights? It may still be broken.
pub fn is_packed(text: &str) -> bool {
    text.starts_with(MARK)
}

/// The height of node `k` on the plane through the neighbours before it; outside of the field heights are 0.
fn expected(steps: &[i64], columns: usize, k: usize) -> i64 {
    let (row, column) = (k / columns, k % columns);
    let before = if column > 0 { steps[k - 1] } else { 0 };
    let above = if row > 0 { steps[k - columns] } else { 0 };
    let corner = if row > 0 && column > 0 { steps[k - columns - 1] } else { 0 };
    match (row, column) {
        (0, _) => before,
        (_, 0) => above,
        _ => before + above - corner,
    }
}

/// Packs rows of heights [m], which [`super::relief::Relief::new`] has accepted.
pub fn pack(rows: &[Vec<f64>]) -> Result<String> {
    let columns = rows.first().map_or(0, Vec::len);
    let steps: Vec<i64> = rows.iter().flatten().map(|h| (h / STEP).round() as i64).collect();
    let mut bytes = Vec::with_capacity(4 + 2 * steps.len());
    for count in [rows.len(), columns] {
        bytes.extend(u16::try_from(count).unwrap_or(u16::MAX).to_le_bytes());
    }
    for (k, step) in steps.iter().enumerate() {
        let off = step - expected(&steps, columns, k);
        // The sign is the lowest bit, so that small differences of either sign are short.
        let mut left = ((off << 1) ^ (off >> 63)) as u64;
        while left >= 128 {
            bytes.push((left & 127) as u8 | 128);
            left >>= 7;
        }
        bytes.push(left as u8);
    }
    let mut stream = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    let packed = stream.write_all(&bytes).and_then(|()| stream.finish());
    let packed = packed.map_err(|e| Error::invalid("heights", e.to_string()))?;
    let text = format!("{MARK}{}", BASE64_STANDARD.encode(packed));
    if text.len() > MOST_TEXT {
        let reason = format!(
            "{} × {columns} heights take {} KiB packed, more than {}: give fewer, or smoother ones",
            rows.len(),
            text.len() >> 10,
            MOST_TEXT >> 10
        );
        return Err(Error::invalid("heights", reason));
    }
    Ok(text)
}

/// Reads a text of [`pack`]; heights are checked by whoever takes them.
pub fn unpack(text: &str) -> Result<Vec<Vec<f64>>> {
    let broken = |e: &dyn std::fmt::Display| Error::invalid("relief.file", format!("not packed heights: {e}"));
    let packed = BASE64_STANDARD.decode(text.trim_start_matches(MARK).trim()).map_err(|e| broken(&e))?;
    let mut bytes = Vec::new();
    // Limits the size of the unpacked data.
    let most = (4 + MOST * LONGEST) as u64;
    flate2::read::ZlibDecoder::new(&packed[..]).take(most).read_to_end(&mut bytes).map_err(|e| broken(&e))?;
    let (head, mut rest) = bytes.split_first_chunk::<4>().ok_or_else(|| broken(&"cut off"))?;
    let [rows, columns] = [[head[0], head[1]], [head[2], head[3]]].map(|b| usize::from(u16::from_le_bytes(b)));
    if rows * columns > MOST || columns == 0 {
        return Err(broken(&format!("{rows} × {columns} heights")));
    }
    let mut steps: Vec<i64> = Vec::with_capacity(rows * columns);
    for k in 0..rows * columns {
        let length = rest.iter().position(|b| *b < 128).filter(|n| *n < LONGEST).ok_or_else(|| broken(&"cut off"))?;
        let (own, after) = rest.split_at(length + 1);
        let off = own.iter().rev().fold(0_i64, |sum, b| (sum << 7) | i64::from(b & 127));
        rest = after;
        // Without the clamp broken differences could add up beyond an integer's range.
        let step = expected(&steps, columns, k) + ((off >> 1) ^ -(off & 1));
        steps.push(step.clamp(-(1 << 40), 1 << 40));
    }
    if !rest.is_empty() {
        return Err(broken(&"too long"));
    }
    Ok(steps.chunks(columns).map(|row| row.iter().map(|s| *s as f64 / STEP.recip()).collect()).collect())
}

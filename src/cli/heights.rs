//! Reads files with heights of the ground: `.csv` and `.npy`.

use sandgait::sim::tree::{heights, relief::Relief};
use sandgait::{Error, Result, files};
use serde_json::Value;
use std::path::Path;

/// Largest file [bytes]: our choice, because `numpy.savetxt` writes the largest number of heights, 512 × 512, in 6.5
/// MB.
const MOST_BYTES: u64 = 8 << 20;

/// Replaces the path in a task's option `relief` by the packed heights of the file.
pub fn read_option(options: &mut Value) -> Result<()> {
    let Some(file) = options.get_mut("relief").and_then(|relief| relief.get_mut("file")) else { return Ok(()) };
    let Some(path) = file.as_str().filter(|text| !text.is_empty() && !heights::is_packed(text)) else { return Ok(()) };
    *file = pack(Path::new(path))?.into();
    Ok(())
}

/// The heights of a file as one text.
pub fn pack(path: &Path) -> Result<String> {
    let bytes = files::read(path, MOST_BYTES)?;
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let rows = match ending.as_deref() {
        Some("csv") => from_text(&bytes),
        Some("npy") => from_npy(&bytes),
        _ => Err("heights are read from .csv and .npy files".into()),
    };
    let named = |e: Error| match e {
        Error::Invalid { reason, field } => {
            Error::file(path, format!("{}: {reason}", field.trim_start_matches("relief.")))
        }
        other => other,
    };
    let rows = rows.map_err(|reason| Error::file(path, reason))?;
    // Any spacing is good here, because the actual spacing is checked later.
    Relief::new(1.0, &rows).map_err(named)?;
    heights::pack(&rows).map_err(named)
}

type Rows = std::result::Result<Vec<Vec<f64>>, String>;

/// Lines of numbers, split at commas, semicolons or blanks. Empty lines and those that begin with # do not count.
fn from_text(bytes: &[u8]) -> Rows {
    let text = std::str::from_utf8(bytes).map_err(|_| "it is not a text in UTF-8")?;
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for (n, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let separator = [',', ';'].into_iter().find(|c| line.contains(*c));
        let cells: Vec<&str> = match separator {
            Some(separator) => line.split(separator).map(str::trim).collect(),
            None => line.split_whitespace().collect(),
        };
        let mut row = Vec::with_capacity(cells.len());
        for (k, cell) in cells.iter().enumerate() {
            let at = format!("line {}, number {}", n + 1, k + 1);
            let shown: String = cell.chars().take(20).collect();
            let height: f64 = cell.parse().map_err(|_| format!("{at}: {shown:?} is not a number"))?;
            if !height.is_finite() {
                return Err(format!("{at}: {shown} is not finite"));
            }
            row.push(height);
        }
        if let Some(first) = rows.first().filter(|first| first.len() != row.len()) {
            return Err(format!("line {} has {} numbers, but the first row has {}", n + 1, row.len(), first.len()));
        }
        rows.push(row);
    }
    Ok(rows)
}

/// An array of `numpy.save`: two dimensions, f4 or f8, little-endian.
fn from_npy(bytes: &[u8]) -> Rows {
    let cut_off = "it is not a file of numpy.save, or it is cut off";
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or(cut_off)?;
    let (length, rest) = match rest.split_first_chunk::<2>().ok_or(cut_off)? {
        ([1, _], rest) => {
            let (length, rest) = rest.split_first_chunk::<2>().ok_or(cut_off)?;
            (usize::from(u16::from_le_bytes(*length)), rest)
        }
        (_, rest) => {
            let (length, rest) = rest.split_first_chunk::<4>().ok_or(cut_off)?;
            (u32::from_le_bytes(*length) as usize, rest)
        }
    };
    let (head, data) = rest.split_at_checked(length).ok_or(cut_off)?;
    let head = std::str::from_utf8(head).map_err(|_| cut_off)?;
    let after = |key: &str| head.split_once(key).map(|(_, value)| value.trim_start_matches([':', ' ']));
    let kind = after("'descr'").and_then(|v| v.split('\'').nth(1)).ok_or("its header has no descr")?;
    if after("'fortran_order'").is_some_and(|v| v.starts_with("True")) {
        return Err("its array is in Fortran order; save numpy.ascontiguousarray(heights)".into());
    }
    let shape = after("'shape'").and_then(|v| v.strip_prefix('(')?.split_once(')')).ok_or("its header has no shape")?.0;
    let sides: Vec<usize> = shape.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    let [rows, columns] = sides[..] else {
        return Err(format!("its shape is ({shape}), but it must be (rows, columns)"));
    };
    let numbers: Vec<f64> = match kind {
        "<f8" => data.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        "<f4" => data.as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
        _ => return Err(format!("its numbers have type {kind:?}; save heights.astype(float)")),
    };
    let size = if kind == "<f8" { 8 } else { 4 };
    if columns == 0 || rows.checked_mul(columns).and_then(|n| n.checked_mul(size)) != Some(data.len()) {
        return Err(format!(
            "its numbers have {} bytes, which is not the size of {rows} × {columns} numbers",
            data.len()
        ));
    }
    if let Some(k) = numbers.iter().position(|h| !h.is_finite()) {
        return Err(format!("row {}, number {}: {} is not finite", k / columns + 1, k % columns + 1, numbers[k]));
    }
    Ok(numbers.chunks(columns).map(<[f64]>::to_vec).collect())
}

//! Pixels as a PNG image.

use crate::error::{Error, Result};
use tiny_skia::{IntSize, Pixmap};

/// Encodes RGB rows, from the top, as a PNG image.
pub fn png(rgb: &[u8], [width, height]: [u32; 2]) -> Result<Vec<u8>> {
    let rgba = rgb.as_chunks::<3>().0.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]).collect();
    let size = IntSize::from_wh(width, height);
    let map = size.and_then(|size| Pixmap::from_vec(rgba, size));
    let map = map.ok_or_else(|| Error::Internal(format!("an image is not {width} × {height}")))?;
    map.encode_png().map_err(|e| Error::Exhausted(format!("the picture cannot be written: {e}")))
}

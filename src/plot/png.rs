//! Converts SVG to PNG. The font is compiled in, so a figure looks the same on every machine.

use crate::error::{Error, Result};
use resvg::{tiny_skia, usvg};
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Pixels per SVG unit: our choice, sharp on dense screens and in print.
const SCALE: f32 = 2.0;

fn fonts() -> Arc<usvg::fontdb::Database> {
    static FONTS: OnceLock<Arc<usvg::fontdb::Database>> = OnceLock::new();
    let load = || {
        let mut fonts = usvg::fontdb::Database::new();
        fonts.load_font_data(dejavu::sans::regular().to_vec());
        fonts.load_font_data(dejavu::sans::bold().to_vec());
        fonts.set_sans_serif_family("DejaVu Sans");
        Arc::new(fonts)
    };
    FONTS.get_or_init(load).clone()
}

/// `svg` as an encoded PNG image.
pub fn encode(svg: &str) -> Result<Vec<u8>> {
    let failed = |e: &dyn std::fmt::Display| Error::Exhausted(format!("the figure cannot be drawn: {e}"));
    let options = usvg::Options { fontdb: fonts(), ..Default::default() };
    let tree = usvg::Tree::from_str(svg, &options).map_err(|e| failed(&e))?;
    let size = tree.size();
    let pixels = |length: f32| (length * SCALE).ceil() as u32;
    let mut map = tiny_skia::Pixmap::new(pixels(size.width()), pixels(size.height()))
        .ok_or_else(|| Error::Exhausted("the figure is too large for the memory".into()))?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut map.as_mut());
    map.encode_png().map_err(|e| failed(&e))
}

/// Writes `svg` to `path`, and as PNG to the same path with the ending `.png`.
pub fn write_both(svg: &str, path: &Path) -> Result<()> {
    let image = path.with_extension("png");
    std::fs::write(path, svg).map_err(|e| Error::unwritten(path, &e))?;
    std::fs::write(&image, encode(svg)?).map_err(|e| Error::unwritten(&image, &e))
}

/// Encodes RGB rows, from the top, as a PNG image.
pub fn pixels(rgb: &[u8], [width, height]: [u32; 2]) -> Result<Vec<u8>> {
    let rgba = rgb.as_chunks::<3>().0.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]).collect();
    let size = tiny_skia::IntSize::from_wh(width, height);
    let map = size.and_then(|size| tiny_skia::Pixmap::from_vec(rgba, size));
    let map = map.ok_or_else(|| Error::Internal(format!("an image is not {width} × {height}")))?;
    map.encode_png().map_err(|e| Error::Exhausted(format!("figure cannot be drawn: {e}")))
}

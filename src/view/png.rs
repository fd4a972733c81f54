//! Pixels as a PNG image, at rest or animated.

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

/// Encodes `frames` of RGB rows, from the top, as an animated PNG image that repeats without end; `rate`: frames a second.
/// Programs that do not know animations show the first frame.
pub fn animation(frames: &[Vec<u8>], size: [u32; 2], rate: u16) -> Result<Vec<u8>> {
    let broken = |e| Error::Internal(format!("an animation of {} frames: {e}", frames.len()));
    encoded(frames, size, rate).map_err(broken)
}

fn encoded(
    frames: &[Vec<u8>],
    [width, height]: [u32; 2],
    rate: u16,
) -> std::result::Result<Vec<u8>, png::EncodingError> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_animated(frames.len() as u32, 0)?;
    encoder.set_frame_delay(1, rate)?;
    let mut writer = encoder.write_header()?;
    frames.iter().try_for_each(|frame| writer.write_image_data(frame))?;
    writer.finish()?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_animation_has_its_frames() {
        let frames: Vec<Vec<u8>> = (0..3).map(|k| [k, 0, 255].repeat(4 * 2)).collect();
        let bytes = animation(&frames, [4, 2], 20).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().map(|a| (a.num_frames, a.num_plays)), Some((3, 0)));
        for frame in &frames {
            let mut pixels = vec![0; 24];
            reader.next_frame(&mut pixels).unwrap();
            assert_eq!(&pixels, frame);
        }
        assert!(animation(&[], [4, 2], 20).is_err() && animation(&[vec![0; 3]], [4, 2], 20).is_err());
    }
}

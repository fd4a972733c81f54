//! Writes text on a picture. The font is compiled in; its letters are rendered once and then copied.

use crate::error::{Error, Result};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg;
use std::fmt::Write as _;
use std::sync::{Arc, OnceLock};

/// A letter's cell, and the size of the font [px]: our choice. The width of a letter of DejaVu Sans Mono is 0.602 times
/// its size, so that it fits into the cell.
pub const CELL: [usize; 2] = [8, 16];
const SIZE: f64 = 13.0;

/// Texts, and where they begin [px].
pub type Labels = Vec<([i64; 2], String)>;

/// The labels that are wholly inside a picture of `size`, without those that overlap an earlier one.
pub fn apart(labels: Labels, size: [u32; 2]) -> Labels {
    let mut kept: Labels = Vec::new();
    let width = |text: &str| (text.chars().count() * CELL[0]) as i64;
    let cell = CELL[1] as i64;
    for (at, text) in labels {
        let [right, bottom] = [at[0] + width(&text), at[1] + cell];
        let inside = at[0] >= 0 && at[1] >= 0 && right <= size[0].into() && bottom <= size[1].into();
        let overlaps = kept
            .iter()
            .any(|([x, y], other)| at[0] < x + width(other) && *x < right && at[1] < y + cell && *y < bottom);
        if inside && !overlaps {
            kept.push((at, text));
        }
    }
    kept
}

const OTHERS: [char; 4] = ['°', '·', '−', '²'];

/// The coverage of each pixel of each letter, 0 to 255.
struct GlyphCells {
    cells: Vec<[u8; CELL[0] * CELL[1]]>,
}

/// Index of a character's cell; a character without a cell is drawn as a blank.
fn index(c: char) -> usize {
    match c {
        ' '..='~' => c as usize - ' ' as usize,
        other => OTHERS.iter().position(|o| *o == other).map_or(0, |i| i + 95),
    }
}

fn letters() -> Result<&'static GlyphCells> {
    static LETTERS: OnceLock<Option<GlyphCells>> = OnceLock::new();
    let letters = LETTERS.get_or_init(drawn).as_ref();
    letters.ok_or_else(|| Error::Exhausted("the font of pictures cannot be drawn".into()))
}

fn drawn() -> Option<GlyphCells> {
    let all: Vec<char> = (' '..='~').chain(OTHERS).collect();
    let (width, height) = (CELL[0] * all.len(), CELL[1]);
    let mut svg = format!("<svg xmlns='http://www.w3.org/2000/svg' width='{width}' height='{height}'>");
    for (i, c) in all.iter().enumerate() {
        let escaped = match c {
            '<' => "&lt;".into(),
            '&' => "&amp;".into(),
            c => c.to_string(),
        };
        let x = i * CELL[0];
        let _ =
            write!(svg, "<text x='{x}' y='12.5' font-family='DejaVu Sans Mono' font-size='{SIZE}'>{escaped}</text>");
    }
    svg.push_str("</svg>");
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(dejavu::sans_mono::regular().to_vec());
    let options = usvg::Options { fontdb: Arc::new(fonts), ..Default::default() };
    let tree = usvg::Tree::from_str(&svg, &options).ok()?;
    let mut map = Pixmap::new(width as u32, height as u32)?;
    resvg::render(&tree, Transform::identity(), &mut map.as_mut());
    let cell =
        |i: usize| std::array::from_fn(|k| map.pixels()[k / CELL[0] * width + i * CELL[0] + k % CELL[0]].alpha());
    Some(GlyphCells { cells: (0..all.len()).map(cell).collect() })
}

/// Writes `text` with its upper left corner at (x, y) on `pixels`, which are RGB rows of `width`. Parts outside of the picture are
/// cut off.
pub fn write(pixels: &mut [u8], width: usize, [x, y]: [i64; 2], text: &str, color: [u8; 3]) -> Result<()> {
    let letters = letters()?;
    let height = pixels.len() / 3 / width;
    for (n, c) in text.chars().enumerate() {
        for (k, cover) in letters.cells[index(c)].iter().enumerate().filter(|(_, c)| **c > 0) {
            let column = x + (n * CELL[0] + k % CELL[0]) as i64;
            let line = y + (k / CELL[0]) as i64;
            let inside = (0..width as i64).contains(&column) && (0..height as i64).contains(&line);
            if inside {
                let at = 3 * (line as usize * width + column as usize);
                for (out, ink) in pixels[at..at + 3].iter_mut().zip(color) {
                    *out = mix(*out, ink, *cover);
                }
            }
        }
    }
    Ok(())
}

fn mix(below: u8, above: u8, cover: u8) -> u8 {
    let [b, a, c] = [below, above, cover].map(u32::from);
    ((b * (255 - c) + a * c + 127) / 255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_whole_and_apart() {
        let at = |x: i64, y: i64| ([x, y], "0.25 m".to_owned());
        let labels =
            vec![at(-1, 20), at(0, 20), at(40, 30), at(48, 20), at(110, 20), at(60, -1), at(112, 44), at(112, 45)];
        assert_eq!(apart(labels, [160, 60]), [at(0, 20), at(48, 20), at(110, 20), at(112, 44)]);
    }

    #[test]
    fn letters_differ_and_stay_inside() {
        let ink = |text: &str, at: [i64; 2]| {
            let mut pixels = vec![255; 3 * 64 * 20];
            write(&mut pixels, 64, at, text, [0; 3]).unwrap();
            pixels
        };
        let sum = |p: &[u8]| p.iter().map(|v| 255 - u64::from(*v)).sum::<u64>();
        assert_eq!(sum(&ink(" ", [0, 0])), 0);
        assert!(sum(&ink("W", [0, 0])) > 2 * sum(&ink(".", [0, 0])) && sum(&ink(".", [0, 0])) > 0);
        assert_ne!(ink("1", [0, 0]), ink("7", [0, 0]));
        assert!(sum(&ink("°", [0, 0])) > 0);
        for at in [[-4, -9], [60, 15], [-100, 0], [0, 100]] {
            ink("Wide text that leaves the picture", at);
        }
    }
}

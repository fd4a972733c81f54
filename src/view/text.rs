//! Writes text on a picture. The letters are compiled in as pixels, so a picture looks the same on every machine.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// The font: our choice, readable at the size of a picture's labels.
const WEIGHT: FontWeight = FontWeight::Regular;
const HEIGHT: RasterHeight = RasterHeight::Size16;
/// A letter's cell [px].
pub const CELL: [usize; 2] = [get_raster_width(WEIGHT, HEIGHT), HEIGHT.val()];

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

/// The coverage of each pixel of a letter, 0 to 255, in rows of [`CELL`]. A character that the font lacks is a blank.
fn pixels_of(c: char) -> &'static [u8] {
    // The font has no minus sign, and its hyphen looks the same.
    let c = if c == '−' { '-' } else { c };
    get_raster(c, WEIGHT, HEIGHT).map_or(&[], |letter| letter.pixels())
}

/// Writes `text` with its upper left corner at (x, y) on `pixels`, which are RGB rows of `width`. Parts outside of the picture are
/// cut off.
pub fn write(pixels: &mut [u8], width: usize, [x, y]: [i64; 2], text: &str, color: [u8; 3]) {
    let height = pixels.len() / 3 / width;
    for (n, c) in text.chars().enumerate() {
        for (k, cover) in pixels_of(c).iter().enumerate().filter(|(_, c)| **c > 0) {
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
        let wide = 6 * CELL[0] as i64;
        let last = 160 - wide;
        let beside = [at(wide - 8, 30), at(wide, 20), at(last - 2, 20), at(60, -1), at(last, 44), at(last, 45)];
        let labels = [vec![at(-1, 20), at(0, 20)], beside.to_vec()].concat();
        assert_eq!(apart(labels, [160, 60]), [at(0, 20), at(wide, 20), at(last - 2, 20), at(last, 44)]);
    }

    #[test]
    fn letters_differ_and_stay_inside() {
        let ink = |text: &str, at: [i64; 2]| {
            let mut pixels = vec![255; 3 * 64 * 20];
            write(&mut pixels, 64, at, text, [0; 3]);
            pixels
        };
        let sum = |p: &[u8]| p.iter().map(|v| 255 - u64::from(*v)).sum::<u64>();
        assert_eq!(sum(&ink(" ", [0, 0])), 0);
        assert!(sum(&ink("W", [0, 0])) > 2 * sum(&ink(".", [0, 0])) && sum(&ink(".", [0, 0])) > 0);
        assert_ne!(ink("1", [0, 0]), ink("7", [0, 0]));
        for letter in ["°", "·", "−", "²"] {
            assert!(sum(&ink(letter, [0, 0])) > 0, "{letter} is blank");
        }
        for at in [[-4, -9], [60, 15], [-100, 0], [0, 100]] {
            ink("Wide text that leaves the picture", at);
        }
    }
}

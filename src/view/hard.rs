//! Hard ground in pictures: grey where it is the surface, and fainter where sand covers it.

use crate::sim::Model;
use crate::sim::tree::HardGround;

/// Share of grey where sand covers a piece: our choice.
const COVERED: f32 = 0.4;
/// Brightness of grey relative to sand: our choice.
const DARK: f32 = 0.8;
/// Weights of red, green and blue in the brightness of a colour (ITU-R BT.601).
const BRIGHTNESS: [f32; 3] = [0.299, 0.587, 0.114];

/// Height of the ground's surface [m]: of the sand, or of hard ground above it.
pub fn surface(model: &Model, x: f64, y: f64) -> f64 {
    let above = model.scene.hard.iter().map(|piece| -piece.top([x, y])).fold(0.0, f64::max);
    model.surface_height(x, y) + above
}

/// Does hard ground rise above the sand somewhere?
pub fn rises(hard: &[HardGround]) -> bool {
    hard.iter().any(|piece| piece.depth < 0.0)
}

/// The colour of a pixel that shows `place` and covers the length `blur` [m] of the ground, where sand would have the
/// colour `sand`. Far away, where a pixel covers more than one copy of a piece, this is a mean.
pub fn shaded(hard: &[HardGround], place: [f64; 2], blur: f64, sand: [f32; 3]) -> [f32; 3] {
    let share = |piece: &HardGround| {
        let outside = piece.outside(place);
        let flank = piece.depth <= 0.0 && piece.top(place) <= 0.0;
        let along = |k: usize| {
            let (size, every) = (piece.size[k], piece.every[k]);
            let sharp = f64::from(u8::from(flank || outside[k] == 0.0));
            if every > 0.0 { sharp + (size / every - sharp) * (blur / every).min(1.0) } else { sharp }
        };
        let most = if piece.depth <= 0.0 { 1.0 } else { COVERED };
        most * (along(0) * along(1)) as f32
    };
    let share = hard.iter().map(share).fold(0.0, f32::max);
    let [grey, _, _] = grey(sand);
    sand.map(|c| c + (grey - c) * share)
}

/// The colour of hard ground where sand would have the colour `sand`.
pub fn grey(sand: [f32; 3]) -> [f32; 3] {
    [DARK * (0..3).map(|k| BRIGHTNESS[k] * sand[k]).sum::<f32>(); 3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slabs_are_grey_and_buried_ones_fainter() {
        let sand = [230.0, 210.0, 170.0];
        let slab = |depth| HardGround { size: [0.8, 0.6], every: [1.6, 1.6], depth, ..HardGround::everywhere() };
        let at = |depth, x, y| shaded(&[slab(depth)], [x, y], 0.0, sand);
        let tint = |c: [f32; 3]| c[0] - c[2];
        for (x, y) in [(0.39, 0.29), (1.6 - 0.39, -0.29), (-16.0, 16.0)] {
            assert_eq!(tint(at(0.0, x, y)), 0.0, "{x} {y}");
            assert!((10.0..50.0).contains(&tint(at(0.05, x, y))), "{x} {y}");
        }
        for (x, y) in [(0.41, 0.0), (0.0, 0.31), (0.8, 0.8)] {
            assert_eq!(at(0.0, x, y), sand);
            assert_eq!(at(0.05, x, y), sand);
        }
        // From far away one sees the mean of slabs and sand.
        let far = |x| tint(shaded(&[slab(0.0)], [x, 0.0], 10.0, sand));
        assert!((far(0.0) - 60.0 * (1.0 - 0.5 * 0.375)).abs() < 0.1 && far(0.8) == far(0.0));
        // The flanks of a slab above the sand fall by 2 m in a metre.
        assert_eq!([tint(at(-0.1, 0.44, 0.0)), tint(at(-0.1, 0.46, 0.0))], [0.0, 60.0]);
        assert_eq!(shaded(&[], [0.0; 2], 0.0, sand), sand);
    }
}

//! Palettes with colours that colour-blind readers can tell apart.

// Okabe & Ito 2008, without yellow, which is hard to see on white.
pub const BLUE: &str = "#0072b2";
pub const VERMILION: &str = "#d55e00";
pub const GREEN: &str = "#009e73";
pub const PURPLE: &str = "#cc79a7";
pub const SKY: &str = "#56b4e9";
pub const ORANGE: &str = "#e69f00";
pub const GREY: &str = "#777777";
pub const BLACK: &str = "#222222";

/// For series without a meaning of their own.
pub const CYCLE: [&str; 6] = [BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY];

/// From red through the spectrum to blue, as Li et al. 2012 colour their families of curves; `share` in [0, 1].
pub fn rainbow(share: f64) -> String {
    // All these colours are dark enough to be read on white.
    hsl(240.0 * share.clamp(0.0, 1.0), 0.75, 0.42)
}

/// The viridis colour map (van der Walt & Smith 2015), interpolated linearly between nine colours.
pub fn viridis(share: f64) -> String {
    const STOPS: [[f64; 3]; 9] = [
        [68.0, 1.0, 84.0],
        [71.0, 44.0, 122.0],
        [59.0, 81.0, 139.0],
        [44.0, 113.0, 142.0],
        [33.0, 144.0, 141.0],
        [39.0, 173.0, 129.0],
        [92.0, 200.0, 99.0],
        [170.0, 220.0, 50.0],
        [253.0, 231.0, 37.0],
    ];
    let place = share.clamp(0.0, 1.0) * 8.0;
    let k = (place as usize).min(7);
    let mix = |c: usize| (STOPS[k][c] + (STOPS[k + 1][c] - STOPS[k][c]) * (place - k as f64)).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

/// Hue [°], saturation and lightness to a hexadecimal colour.
fn hsl(hue: f64, saturation: f64, lightness: f64) -> String {
    let a = saturation * lightness.min(1.0 - lightness);
    let channel = |n: f64| {
        let k = (n + hue / 30.0) % 12.0;
        let value = lightness - a * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0);
        (value * 255.0).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", channel(0.0), channel(8.0), channel(4.0))
}

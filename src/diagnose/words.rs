//! Formats numbers and texts.

/// A number with three significant digits, or with all digits before its decimal point if there are more.
pub fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let rounded: f64 = format!("{value:.2e}").parse().unwrap_or(value);
    let magnitude = rounded.abs().log10().floor();
    match magnitude {
        -5.0..6.0 => format!("{value:.*}", (2.0 - magnitude).max(0.0) as usize),
        _ => format!("{value:.2e}"),
    }
}

/// A unit to put after a number, with a space; empty if dimensionless.
pub fn after(unit: &str) -> String {
    if matches!(unit, "" | "1") { String::new() } else { format!(" {unit}") }
}

/// The channel or shape to put after an id; empty if it is that of all.
pub fn of(part: Option<&str>) -> String {
    part.map_or(String::new(), |part| format!(" of {part}"))
}

/// A range with its unit; a single number if both ends are equal.
pub fn span(range: [f64; 2], unit: &str) -> String {
    // Positions within the log's rounding count as equal.
    let [low, high] = range.map(|v| digits(if v.abs() < 1e-9 { 0.0 } else { v }));
    let numbers = if low == high { high } else { format!("{low} to {high}") };
    numbers + &after(unit)
}

/// The text with a capital at its beginning.
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

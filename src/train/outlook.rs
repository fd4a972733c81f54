//! How long a training with a curriculum usually takes.

/// The update after which a training with a curriculum says how long it usually takes: our choice, because the first update
/// also starts the environments, so that its rate is too low, and the user waits for this line.
pub const OUTLOOK: u32 = 2;
/// Steps [millions] after which the mean level of the curriculum was 0.9 in the kept trainings of four robots with four
/// legs on packed seeds (`examples/policies/LeggedVelocity-*/curve.csv`): after 3.8 to 4.5.
const USUAL: [f64; 2] = [4.0, 5.0];

/// What a training with a curriculum says of its duration at this `level` and `rate` [steps/s].
pub fn outlook(level: f64, steps: u64, rate: f64) -> String {
    let minutes = USUAL.map(|millions| ((1e6 * millions - steps as f64) / rate / 60.0).max(0.0).ceil());
    format!(
        "the curriculum is at level {level:.2} of 1: it rises when the robot follows its commands. Robots with four legs usually \
         walk at level 1 after {} to {} M steps, here in {} to {} min, with six legs earlier; two legs can need several times as long",
        USUAL[0], USUAL[1], minutes[0], minutes[1]
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outlook_follows_from_the_rate() {
        let said = outlook(0.25, 1_000_000, 50_000.0);
        assert!(said.contains("level 0.25 of 1") && said.contains("4 to 5 M steps, here in 1 to 2 min"), "{said}");
        assert!(outlook(0.95, 8_000_000, 50_000.0).contains("here in 0 to 0 min"));
    }
}

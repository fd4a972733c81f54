//! Files of hardware.

use sandgait_sim::hardware::*;

const TEXT: &str = "source = \"a test\"\naction_delay = { value = 0.02, interval = [0.01, 0.03] }\n\n[actuator]\n\
    torque_limit = { value = 0.5, interval = [0.4, 0.6] }\n\n[sensors.gyroscope]\ndelay = { value = 0.004, interval = [0.0, 0.01] }\n";

#[test]
fn a_file_is_read_as_it_was_written() {
    let hardware = HardwareDescription::from_toml(TEXT).unwrap();
    assert_eq!(hardware.value("sensors.gyroscope.delay"), Some(0.004));
    assert_eq!(hardware.quantities["actuator.torque_limit"], HardwareQuantity { value: 0.5, interval: [0.4, 0.6] });
    assert_eq!(hardware.to_toml(), TEXT);
}

#[test]
fn wrong_files_are_refused() {
    for (text, said) in [
        ("delay = 3", "delay: expected a table with value and interval"),
        ("a = { value = 1.0 }", "a: missing field `interval`"),
        ("a = { value = 1.0, interval = [2.0, 3.0] }", "a: the value 1 is not within its interval [2, 3]"),
        ("a = { value = nan, interval = [2.0, 3.0] }", "is not within"),
        ("[a.b.c]\nd = { value = 1.0, interval = [0.0, 2.0] }", "a.b.c: value is missing"),
        ("= 3", "hardware"),
    ] {
        let error = HardwareDescription::from_toml(text).unwrap_err().to_string();
        assert!(error.contains(said) && !error.contains('\n'), "{error}");
    }
}

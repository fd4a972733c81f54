//! Terms that `sand.toml` may have, and terms that are refused.

use super::*;

fn term(text: &str) -> Term {
    toml::from_str(text).unwrap()
}

fn refused(text: &str) -> String {
    let error = term(text).check(&Coefficients::POPPY_LOOSE, 638.0).err();
    error.map_or(String::new(), |e| e.to_string())
}

#[test]
fn terms_that_sand_cannot_be_are_refused() {
    let good = "on = \"normal\"\ncoefficient = 1.2\ngroups = { froude = 0.75, depth_over_width = -0.5 }\n\
                range = { froude = [0.0, 4.0], depth_over_width = [0.2, 3.0] }";
    assert_eq!(refused(good), "");
    for (from, to, says) in [
        ("1.2", "-1.2", "pulls and so adds energy"),
        ("\"normal\"\ncoefficient = 1.2", "\"tangential\"\ncoefficient = -1.2", "adds energy"),
        ("[0.2, 3.0]", "[-0.2, 3.0]", "above the surface"),
        ("[0.2, 3.0]", "[0.0, 3.0]", "grows without bound"),
        ("[0.0, 4.0]", "[-1.0, 4.0]", "cannot be negative"),
        ("froude = 0.75", "sin_beta = 1.0", "has none"),
        ("coefficient = 1.2", "coefficient = nan", "outside"),
    ] {
        let text = good.replace(from, to);
        let message =
            if says == "has none" { refused(&text.replace("froude = [", "depth = [")) } else { refused(&text) };
        let said = if says == "has none" { !message.is_empty() } else { message.contains(says) };
        assert!(said && message.lines().count() == 1, "{from} → {to}: {message:?}");
    }
    let sideways =
        "on = \"normal\"\ncoefficient = 1.0\ngroups = { sin_beta = 1.0 }\nrange = { sin_beta = [-1.0, 1.0] }";
    assert!(refused(sideways).contains("mirror"), "{}", refused(sideways));
    // This term is accepted. It reduces the stress most on level pieces that move straight down. There the law's
    // own stress is large, so the sum still resists the motion.
    let lowered = "on = \"normal\"\ncoefficient = -0.02\ngroups = { sin_gamma = 2.0, cos_beta = 2.0 }\n\
                   range = { sin_gamma = [0.0, 1.0], cos_beta = [0.0, 1.0] }";
    assert_eq!(refused(lowered), "");
    // A term may reduce the law's own stress to 0, but not reverse it.
    let less = "on = \"law\"\ncoefficient = -0.9\ngroups = { saturation = 1.0, sin_attack = 2.0 }\n\
                range = { saturation = [0.0, 1.0], sin_attack = [0.0, 1.0] }";
    assert_eq!(refused(less), "");
    assert!(refused(&less.replace("-0.9", "-1.1")).contains("turns the law's own stress round"));
}

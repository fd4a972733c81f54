//! Reads files of hyperparameters: YAML with anchors and merge keys (`<<`), as JSON values.

use crate::error::{Error, Result};
use serde_json::Value;

/// Largest text [bytes]: our choice, as for the limits below, far more than a file of hyperparameters needs.
const MOST_BYTES: usize = 1 << 20;
/// Deepest nesting.
const MOST_DEPTH: usize = 32;
/// Largest number of values. A value counts again wherever an alias repeats it.
const MOST_VALUES: usize = 1 << 16;

/// The value of `text`; null if it is empty.
pub fn read(text: &str) -> Result<Value> {
    if text.len() > MOST_BYTES {
        return Err(Error::invalid("YAML", format!("{} bytes are more than {MOST_BYTES}", text.len())));
    }
    let options = serde_saphyr::options! {
        budget: serde_saphyr::budget! {
            max_depth: MOST_DEPTH,
            max_nodes: MOST_VALUES,
            max_documents: 1,
            // Text that an alias repeats counts again.
            max_total_scalar_bytes: 2 * MOST_BYTES,
            // A file may have one anchor that all its tasks use.
            enforce_alias_anchor_ratio: false,
        },
        alias_limits: serde_saphyr::alias_limits! { max_total_replayed_events: 2 * MOST_VALUES },
        // As Python's yaml: the last of equal names counts.
        duplicate_keys: serde_saphyr::options::DuplicateKeyPolicy::LastWins,
        // Names of tasks and options, such as "on", stay texts.
        strict_booleans: true,
        non_finite_float_policy: serde_saphyr::options::NonFiniteFloatPolicy::AsString,
        with_snippet: false,
    };
    serde_saphyr::from_str_with_options(text, options)
        .map_err(|e| Error::invalid("YAML", e.render_with_formatter(&serde_saphyr::UserMessageFormatter)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_file_of_examples_is_read_as_python_reads_it() {
        let all = read(include_str!("../../examples/hyperparameters/ppo.yml")).unwrap();
        let gait = &all["sandgait/HexapodGait-v1"];
        assert_eq!(gait["n_timesteps"], 10_000_000);
        assert_eq!(gait["learning_rate"], "lin_1e-3");
        assert_eq!(gait["policy_kwargs"], json!({"log_std_init": 0.0, "net_arch": [64, 64]}));
        let legs = &all["sandgait/HexapodLegs-v1"];
        assert_eq!((&legs["n_envs"], &legs["seconds"], &legs["gamma"]), (&json!(128), &json!(600), &json!(0.95)));
    }

    #[test]
    fn what_is_no_such_file_is_refused_in_a_line() {
        let long = format!("a: &a {}\nb: [{}]", "x".repeat(60_000), "*a, ".repeat(20_000));
        let names: String = (0..30).map(|k| format!("b{}: &b{} {{<<: *b{k}, k{k}: 1}}\n", k + 1, k + 1)).collect();
        let names = format!("b0: &b0 {{k: {}}}\n{names}", "x".repeat(300_000));
        let bomb: String = (0..30).map(|k| format!("a{}: &a{} [*a{k}, *a{k}, *a{k}]\n", k + 1, k + 1)).collect();
        for (text, says) in [
            ("a: [1, 2", "YAML: unclosed bracket"),
            (&format!("a0: &a0 1\n{bomb}") as &str, "too large or too complex"),
            (&long, "ScalarBytes"),
            (&names, "ScalarBytes"),
            (&("[".repeat(40) + &"]".repeat(40)), "Depth"),
            (&"[".repeat(10_000), "YAML: "),
            (&"x".repeat(MOST_BYTES + 1), "bytes are more than"),
            ("a: &a [*a]", "YAML: "),
            ("<<: 3", "YAML merge value must be mapping"),
            ("---\na: 1\n---\nb: 2", "Documents"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(says) && !error.contains('\n') && error.len() < 400, "{error}");
        }
        assert_eq!(read("").unwrap(), Value::Null);
        assert_eq!(
            read("[1e-3, .5, inf, -3, '7', 1_000, yes, .inf, 1e999]").unwrap(),
            json!([1e-3, 0.5, "inf", -3, "7", 1000, "yes", ".inf", ".inf"])
        );
        assert_eq!(read("{a: 1, b: &x {c: 2, d: 3}, e: {d: 4, <<: *x}, a: 5}").unwrap()["e"], json!({"c": 2, "d": 4}));
    }
}

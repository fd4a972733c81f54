//! Data flow one way: what each layer must not know, read from the sources. See ARCHITECTURE.md.

use std::path::{Path, PathBuf};

/// A folder of `src/` and the words that may not stand in its code.
const ABSENT: [(&str, &[&str]); 9] = [
    ("number", &["sand", "sim", "env", "pool", "service", "rand", "tokio", "tonic", "rapier3d"]),
    ("sand", &["sim", "env", "pool", "service", "rand", "tokio", "tonic", "rapier", "rapier3d"]),
    ("sim", &["env", "pool", "service", "rand", "tokio", "tonic"]),
    ("env", &["policy", "pool", "service", "tokio", "tonic", "rapier3d"]),
    ("policy", &["pool", "service", "rand", "tokio", "tonic", "rapier3d"]),
    ("evaluate", &["pool", "service", "tokio", "tonic", "rapier3d"]),
    ("pool", &["service", "tokio", "tonic", "rapier3d"]),
    ("view", &["env", "pool", "service", "rand", "tokio", "tonic", "rapier", "rapier3d"]),
    ("diagnose", &["env", "pool", "service", "tokio", "tonic"]),
];

/// Only these may name protobuf: messages are the service's, and ONNX files are protobuf too.
const KNOW_PROTO: [&str; 3] = ["service", "bench", "policy"];

fn sources(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let paths = entries.map(|e| e.unwrap().path());
    let of = |p: PathBuf| if p.is_dir() { sources(&p) } else { vec![p] };
    paths.flat_map(of).filter(|p| p.extension().is_some_and(|e| e == "rs")).collect()
}

/// Code without comments and strings: prose may speak of anything.
fn code(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().map(|line| {
        let without_strings: String = line.split('"').step_by(2).collect();
        without_strings.split("//").next().unwrap_or_default().to_owned()
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Is `word` used as a crate or module: alone, and not a field, variable or method of that name?
fn names(code: &str, word: &str) -> bool {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    code.match_indices(word).any(|(at, _)| {
        let (before, after) = (&code[..at], &code[at + word.len()..]);
        let alone = !before.ends_with(part) && !after.starts_with(part) && !before.ends_with("std::");
        let listed = before.ends_with("use ") || before.ends_with("crate::") || before.ends_with("super::");
        alone && (after.starts_with("::") || listed)
    })
}

#[test]
fn layers_do_not_know_those_above() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut broken = Vec::new();
    for (layer, absent) in ABSENT {
        for path in sources(&src.join(layer)) {
            let code = code(&path);
            let found = absent.iter().filter(|word| names(&code, word));
            broken.extend(found.map(|word| format!("{} names {word}", path.display())));
        }
    }
    for path in sources(&src) {
        let inside = path.strip_prefix(&src).unwrap();
        let knows = KNOW_PROTO.iter().any(|layer| inside.starts_with(layer));
        let code = code(&path);
        let found = ["proto", "prost", "prost_types"].into_iter().filter(|word| !knows && names(&code, word));
        broken.extend(found.map(|word| format!("{} names {word}", path.display())));
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_reader_of_sources_sees_what_matters() {
    assert!(names("use crate::pool::Batch;", "pool"));
    assert!(names("use crate::{env, pool};\nlet p = pool::Pool::new(1);", "pool"));
    assert!(names("use tokio;", "tokio"));
    assert!(!names("std::env::var(name)", "env"));
    assert!(!names("let pool = 1; spool::x(); self.pool.run()", "pool"));
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    assert!(sources(&manifest.join("src")).len() > 20);
    assert!(!names(&code(&manifest.join("src/pool/mod.rs")), "tokio"));
}

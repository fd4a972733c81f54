//! Data flow one way: what each layer must not know, read from the sources. See ARCHITECTURE.md.

use std::path::{Path, PathBuf};

/// Every module of `src/`, and those that it may know. Each names only modules further up in this list, so nothing goes in
/// circles; whatever is not named it must not know.
const KNOWS: [(&str, &[&str]); 27] = [
    ("error", &[]),
    ("parallel", &[]),
    ("student", &[]),
    ("progress", &["error"]),
    ("number", &["error"]),
    ("table", &["error"]),
    ("plot", &["error"]),
    ("sand", &["error", "parallel", "number"]),
    ("sim", &["error", "number", "sand"]),
    ("robots", &["error", "number", "sand", "sim"]),
    ("env", &["error", "number", "sand", "sim"]),
    ("policy", &["error", "number", "env"]),
    ("pool", &["error", "parallel", "progress", "env", "policy"]),
    ("view", &["error", "number", "plot", "sand", "sim"]),
    ("session", &["error", "env", "sim", "pool", "view"]),
    ("calibrate", &["error", "student", "table", "plot", "sand"]),
    ("sweep", &["error", "parallel", "progress", "table", "plot", "sand", "sim"]),
    (
        "diagnose",
        &["error", "parallel", "student", "progress", "number", "table", "plot", "sand", "sim", "robots", "sweep"],
    ),
    ("reproduce", &["error", "parallel", "progress", "number", "table", "plot", "sand", "sim", "sweep"]),
    ("validate", &["error", "parallel", "table", "plot", "sand", "sim", "calibrate", "reproduce"]),
    ("evaluate", &["error", "parallel", "progress", "table", "sand", "sim", "env", "policy"]),
    (
        "train",
        // Its `table` is that of `sweep`.
        &[
            "error", "parallel", "progress", "number", "table", "plot", "sim", "env", "policy", "view", "sweep",
            "evaluate",
        ],
    ),
    (
        "service",
        &[
            "error", "parallel", "progress", "table", "sand", "sim", "env", "policy", "pool", "view", "session",
            "sweep", "diagnose", "evaluate",
        ],
    ),
    ("client", &["service"]),
    ("bench", &["error", "env", "policy", "pool", "service"]),
    (
        "cli",
        &[
            "error",
            "parallel",
            "progress",
            "number",
            "table",
            "plot",
            "sand",
            "sim",
            "robots",
            "env",
            "policy",
            "pool",
            "view",
            "calibrate",
            "validate",
            "sweep",
            "diagnose",
            "reproduce",
            "evaluate",
            "train",
            "service",
            "bench",
        ],
    ),
    ("main", &["cli"]),
];

/// Only these may name what stands first: threads that wait, networks and messages, chance, the other engine's library.
const OUTSIDE: [(&str, &[&str]); 8] = [
    ("tokio", &["service", "client", "bench", "cli"]),
    ("tonic", &["service", "client", "bench"]),
    ("axum", &["service"]),
    ("proto", &["service", "client", "bench"]),
    // ONNX files are protobuf too, and TensorBoard's.
    ("prost", &["service", "policy", "train"]),
    ("prost_types", &["service", "client", "bench"]),
    ("rand", &["env", "validate", "sweep", "diagnose", "evaluate", "train", "service"]),
    ("rapier3d", &["sim"]),
];

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

/// Top-level modules that are named by their path: `crate::word`, `sandgait::word`, or in a list behind one of the two.
fn modules(code: &str) -> Vec<String> {
    let mut found = Vec::new();
    for root in ["crate::", "sandgait::"] {
        for (at, _) in code.match_indices(root) {
            let rest = &code[at + root.len()..];
            match rest.strip_prefix('{') {
                None => found.push(word(rest)),
                Some(list) => {
                    let mut depth = 1;
                    let mut begins = true;
                    for (i, c) in list.char_indices() {
                        if begins && depth == 1 && !c.is_whitespace() {
                            found.push(word(&list[i..]));
                        }
                        begins = c == ',' || (begins && c.is_whitespace());
                        depth += i32::from(c == '{') - i32::from(c == '}');
                        if depth == 0 {
                            break;
                        }
                    }
                }
            }
        }
    }
    found
}

fn word(text: &str) -> String {
    text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// The files of a module, in its folder or beside.
fn files(src: &Path, module: &str) -> Vec<PathBuf> {
    let alone = src.join(format!("{module}.rs"));
    if alone.is_file() { vec![alone] } else { sources(&src.join(module)) }
}

#[test]
fn modules_know_only_those_below() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let listed: Vec<&str> = KNOWS.iter().map(|k| k.0).collect();
    let mut broken = Vec::new();
    for entry in std::fs::read_dir(&src).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap();
        if name != "lib" && !listed.contains(&name) {
            broken.push(format!("src/{name} is in no line of this test: say what it may know"));
        }
    }
    for (place, (module, known)) in KNOWS.iter().enumerate() {
        for below in *known {
            assert!(listed[..place].contains(below), "{module} may know {below}, which does not stand above it");
        }
        let mut files = files(&src, module);
        assert!(!files.is_empty(), "src/{module} is gone");
        // Made from proto/: tonic has modules of its own called client.
        files.retain(|path| !path.starts_with(src.join("service/generated")));
        for path in files {
            let code = code(&path);
            // A child of the module may have the name of another module; what has no such child is meant itself.
            let child = |word: &str| {
                src.join(module).join(word).exists() || src.join(module).join(format!("{word}.rs")).exists()
            };
            let by_parent = |word: &&str| !child(word) && names(&code, word);
            let by_path = modules(&code);
            let named = listed.iter().filter(|word| by_path.iter().any(|m| m == *word) || by_parent(word));
            let wrong = named.filter(|word| *word != module && !known.contains(word));
            broken.extend(wrong.map(|word| format!("{} names {word}", path.display())));
            let outside = OUTSIDE.iter().filter(|(word, may)| !may.contains(module) && names(&code, word));
            broken.extend(outside.map(|(word, _)| format!("{} names {word}", path.display())));
            if *module != "sim" && names(&code, "rapier") {
                broken.push(format!("{} names rapier", path.display()));
            }
        }
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
    assert_eq!(
        modules("use crate::{env::{a, b}, pool};\nsandgait::view::x(); crate::table::y()"),
        ["env", "pool", "table", "view"]
    );
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    assert!(sources(&manifest.join("src")).len() > 20);
    assert!(!names(&code(&manifest.join("src/pool/mod.rs")), "tokio"));
}

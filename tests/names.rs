//! One name, one meaning: no two structs, enums or traits of `src/` have the same name. So a search for a name finds one
//! thing. Generated code, tests, aliases and types within a function or a trait are left out. And each name in
//! ARCHITECTURE.md exists.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The files of a folder that end so, with hand-written code that is no test.
fn sources(folder: &str, end: &str) -> Vec<PathBuf> {
    let (mut all, mut folders) = (Vec::new(), vec![root().join(folder)]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if path.is_dir() && !["generated", "tests"].contains(&name) {
                folders.push(path);
            } else if name.ends_with(end) && name != "tests.rs" {
                all.push(path);
            }
        }
    }
    all
}

/// The text of a file without its tests.
fn text(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    text.split("#[cfg(test)]\nmod").next().unwrap_or_default().to_owned()
}

/// The path of each struct, enum and trait, by its name.
fn types() -> BTreeMap<String, Vec<String>> {
    let mut all: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for path in sources("src", ".rs") {
        for name in text(&path).lines().filter_map(declared) {
            let file = path.strip_prefix(root()).unwrap().display().to_string();
            all.entry(name.to_owned()).or_default().push(file);
        }
    }
    all
}

/// The name of the type that begins in this line, which is not indented.
fn declared(line: &str) -> Option<&str> {
    let line = match line.strip_prefix("pub") {
        Some(rest) if rest.starts_with('(') => rest.split_once(") ")?.1,
        Some(rest) => rest.strip_prefix(' ')?,
        None => line,
    };
    let (kind, rest) = line.strip_prefix("unsafe ").unwrap_or(line).split_once(' ')?;
    let name = rest.split(|c: char| !c.is_alphanumeric()).next()?;
    ["struct", "enum", "trait"].contains(&kind).then_some(name)
}

#[test]
fn no_two_types_have_the_same_name() {
    assert_eq!(declared("pub(crate) struct Model<'a> {"), Some("Model"));
    assert_eq!(declared("unsafe trait Kernel: Sized {"), Some("Kernel"));
    let types = types();
    assert!(types.len() > 600, "{}", types.len());
    let twice = types.iter().filter(|(_, files)| files.len() > 1);
    let twice: Vec<_> = twice.map(|(name, files)| format!("{name}: {}", files.join(", "))).collect();
    assert!(twice.is_empty(), "names of more than one type:\n{}", twice.join("\n"));
}

/// All names that `src/` and the Python client declare: items, modules, fields, variants and rows of macros, in code and
/// not in comments.
fn declarations() -> BTreeSet<String> {
    let mut all = BTreeSet::new();
    let python = [".rs", ".py"].map(|end| sources("python_client", end)).concat();
    for path in [sources("src", ".rs"), python].concat() {
        // A file or a folder is a module.
        all.extend(path.iter().map(|part| part.to_str().unwrap().trim_end_matches(".rs").to_owned()));
        for line in text(&path).lines().map(str::trim_start).filter(|line| !line.starts_with("//")) {
            let words = line.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty());
            let words: Vec<_> = words.collect();
            let keywords = ["fn", "mod", "struct", "enum", "trait", "type", "const", "static", "macro_rules", "class"];
            all.extend(words.windows(2).filter(|pair| keywords.contains(&pair[0])).map(|pair| pair[1].to_owned()));
            // A variant or a field begins its line.
            let first = words.iter().find(|word| !["pub", "crate", "super", "in"].contains(word));
            all.extend(first.map(|name| (*name).to_owned()));
        }
    }
    all
}

#[test]
fn each_name_in_architecture_exists() {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let known = declarations();
    let (mut missing, mut checked) = (Vec::new(), 0);
    // Odd pieces are between backticks.
    for name in page.split('`').skip(1).step_by(2) {
        let is_path = name.contains('/') && !name.contains(['*', '{', ' ', '=']);
        let is_item = name.contains("::") || name.starts_with(char::is_uppercase);
        let word = |part: &str| !part.is_empty() && part.chars().all(|c| c.is_alphanumeric() || c == '_');
        if is_path {
            checked += 1;
            if !root().join(name).exists() {
                missing.push(name);
            }
        } else if is_item && name.split("::").all(word) {
            checked += 1;
            let crates = ["crate", "axum", "sandgait", "base", "client"];
            if !name.split("::").all(|part| known.contains(part) || crates.contains(&part)) {
                missing.push(name);
            }
        }
    }
    // The routes are drawn in blocks, whose words are no pieces of their own.
    let outside = |c: char| c.is_whitespace() || "`()[],;:…".contains(c);
    let folders = ["src/", "python_client/", "proto/", "tests/", "docs/", "examples/", "robots/", "benches/"];
    for word in page.split(outside).map(|word| word.trim_end_matches('.')) {
        if folders.iter().any(|folder| word.starts_with(folder)) && !word.contains(['*', '{']) {
            checked += 1;
            if !root().join(word).exists() {
                missing.push(word);
            }
        }
    }
    assert!(checked > 200, "{checked}");
    assert!(missing.is_empty(), "ARCHITECTURE.md names what does not exist: {missing:?}");
}

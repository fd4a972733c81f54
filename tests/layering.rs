//! Dependencies go one way. Each folder of `src/` is a crate. Cargo refuses circular dependencies, and the compiler
//! refuses a crate that Cargo.toml does not list. These tests check which dependencies each Cargo.toml may list. See
//! ARCHITECTURE.md.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// External crates for networking, messages, the engine `rapier` and the command line, each with the crates that may
/// depend on it.
const OUTSIDE: [(&str, &[&str]); 7] = [
    ("tokio", &["service", "dm_env_rpc", "client", "bench", "root"]),
    ("tonic", &["service", "dm_env_rpc", "client"]),
    ("axum", &["service"]),
    // ONNX files and TensorBoard's event files are protobuf, too.
    ("prost", &["service", "dm_env_rpc", "policy", "train"]),
    ("prost-types", &["service", "dm_env_rpc", "client"]),
    ("rapier3d", &["sim"]),
    ("clap", &["diagnose", "study", "root"]),
];

/// Every crate of the workspace in the order of the root's `[workspace.dependencies]`, each with its dependencies.
fn crates() -> Vec<(String, Vec<String>)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &Path| -> toml::Table { std::fs::read_to_string(path).unwrap().parse().unwrap() };
    let dependencies = |table: &toml::Table| table["dependencies"].as_table().unwrap().keys().cloned().collect();
    let manifest = read(&root.join("Cargo.toml"));
    let listed = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
    let own = listed.lines().filter_map(|line| line.strip_prefix("sandgait-")?.split_once(" = { version"));
    let mut all: Vec<(String, Vec<String>)> = own
        .map(|(name, _)| {
            let table = read(&root.join("src").join(name).join("Cargo.toml"));
            (name.to_owned(), dependencies(&table))
        })
        .collect();
    all.push(("root".into(), dependencies(&manifest)));
    all
}

#[test]
fn crates_depend_only_on_those_above_them_in_the_list() {
    let all = crates();
    assert!(all.len() > 20, "{}", all.len());
    for (place, (name, dependencies)) in all.iter().enumerate() {
        for known in dependencies.iter().filter_map(|d| d.strip_prefix("sandgait-")) {
            assert!(
                all[..place].iter().any(|(above, _)| above == known),
                "{name} depends on {known}, which stands below"
            );
        }
    }
}

#[test]
fn external_crates_are_used_only_where_listed() {
    for (name, dependencies) in crates() {
        for (outside, may) in OUTSIDE {
            let has = dependencies.iter().any(|d| d == outside);
            assert!(!has || may.contains(&name.as_str()), "{name} depends on {outside}");
        }
    }
}

#[test]
fn every_folder_of_sources_is_a_crate() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let known = crates();
    for entry in std::fs::read_dir(src).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let crate_or_root = known.iter().any(|(listed, _)| *listed == name) || name == "cli";
        assert!(!path.is_dir() || crate_or_root, "src/{name} is in no list");
    }
}

type File = Vec<String>;

/// Every file of `src/NAME`, by its path in the crate, with the files that it names by `crate::` or `super::`. Tests
/// and generated files are left out. A file and the `mod.rs` of its folder may name each other.
fn files(name: &str) -> BTreeMap<File, BTreeSet<File>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(name);
    let mut texts: BTreeMap<File, String> = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let (stem, relative) = (path.file_stem().unwrap(), path.strip_prefix(&root).unwrap());
            if path.is_dir() && !["generated", "tests"].iter().any(|skipped| path.ends_with(skipped)) {
                folders.push(path.clone());
            } else if path.extension().is_some_and(|e| e == "rs") && stem != "tests" {
                let place = relative.with_extension("");
                let parts = place.iter().map(|part| part.to_str().unwrap().to_owned()).filter(|part| part != "mod");
                texts.insert(parts.collect(), std::fs::read_to_string(&path).unwrap());
            }
        }
    }
    let known: BTreeSet<File> = texts.keys().cloned().collect();
    texts.into_iter().map(|(file, text)| (file.clone(), named(&file, &text, &known))).collect()
}

/// The files among `known` that `file`, whose content is `text`, names.
fn named(file: &File, text: &str, known: &BTreeSet<File>) -> BTreeSet<File> {
    let tests = ["#[cfg(test)]\nmod", "#[cfg(test)]\npub(super) mod"];
    let code = tests.iter().fold(text, |code, tests| code.split(tests).next().unwrap_or_default());
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default());
    let mut all = BTreeSet::new();
    for line in lines {
        for (at, start) in line.match_indices("crate::").chain(line.match_indices("super::")) {
            // The second `super::` of `super::super::`, and `crate::` in `my_crate::`, do not begin a path.
            if line[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':') {
                continue;
            }
            let mut rest = &line[at + start.len()..];
            let mut place = if start == "crate::" { Vec::new() } else { file[..file.len().saturating_sub(1)].to_vec() };
            while let Some(shorter) = rest.strip_prefix("super::") {
                rest = shorter;
                place.pop();
            }
            let branches = rest.strip_prefix('{').map_or(vec![rest], |list| list.split(", ").collect());
            for branch in branches {
                let mut found = place.clone();
                for part in branch.split("::").map(|p| p.trim_end_matches(|c: char| !c.is_alphanumeric() && c != '_')) {
                    found.push(part.to_owned());
                    if !known.contains(&found) {
                        found.pop();
                        break;
                    }
                }
                let related = found.starts_with(file) || file.starts_with(&found);
                if !related {
                    all.insert(found);
                }
            }
        }
    }
    all
}

/// All files that `from` uses, directly or through other files.
fn reached<'a>(from: &'a File, files: &'a BTreeMap<File, BTreeSet<File>>) -> BTreeSet<&'a File> {
    let (mut all, mut next) = (BTreeSet::new(), vec![from]);
    while let Some(file) = next.pop() {
        for other in files.get(file).into_iter().flatten() {
            if all.insert(other) {
                next.push(other);
            }
        }
    }
    all
}

#[test]
fn no_files_use_each_other_in_a_circle() {
    let mut found: BTreeSet<Vec<String>> = BTreeSet::new();
    for (name, _) in crates() {
        if name == "root" {
            continue;
        }
        let files = files(&name);
        for file in files.keys() {
            let circle = reached(file, &files).into_iter().filter(|other| reached(other, &files).contains(file));
            let circle: BTreeSet<_> = circle.map(|other| format!("{name}/{}", other.join("/"))).collect();
            if !circle.is_empty() {
                found.insert(circle.into_iter().collect());
            }
        }
    }
    assert!(found.is_empty(), "circles of files: {found:#?}");
}

//! Data flow one way. The folders of `src/` are crates, so Cargo refuses every circle and the compiler every name of a crate
//! that a Cargo.toml does not list; these tests hold what the lists may say. See ARCHITECTURE.md.

use std::path::Path;

/// Only these may depend on what stands first: threads that wait, networks and messages, the other engine's library.
const OUTSIDE: [(&str, &[&str]); 7] = [
    ("tokio", &["service", "client", "bench", "root"]),
    ("tonic", &["service", "client", "bench"]),
    ("axum", &["service"]),
    // ONNX files are protobuf too, and TensorBoard's.
    ("prost", &["service", "policy", "train"]),
    ("prost-types", &["service", "client", "bench"]),
    ("rapier3d", &["sim"]),
    ("clap", &["diagnose", "root"]),
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
fn crates_know_only_those_above_them_in_the_list() {
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
fn networks_and_engines_stay_where_they_belong() {
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
        let crate_or_root =
            known.iter().any(|(listed, _)| *listed == name) || ["cli", "validate"].contains(&name.as_str());
        assert!(!path.is_dir() || crate_or_root, "src/{name} is in no list");
    }
}

//! One name, one meaning: no two structs, enums or traits of `src/` have the same name. So a search for a name finds one
//! thing. Generated code, tests, aliases and types within a function or a trait are left out.

use std::collections::BTreeMap;
use std::path::Path;

/// Names that have not been made unique yet, with the number of types that have them. Only remove from this list, and only
/// lower its numbers.
const NOT_YET: [(&str, usize); 55] = [
    ("Advance", 2),
    ("Asked", 2),
    ("Block", 3),
    ("Blocks", 3),
    ("Body", 4),
    ("Clock", 2),
    ("Column", 2),
    ("Cut", 3),
    ("Draw", 2),
    ("Drive", 2),
    ("Entry", 2),
    ("Errors", 2),
    ("Feature", 2),
    ("Frame", 4),
    ("Given", 4),
    ("Group", 2),
    ("Hinge", 2),
    ("Joints", 2),
    ("Kind", 3),
    ("LaneBody", 2),
    ("LaneState", 2),
    ("Lanes", 2),
    ("Law", 3),
    ("Leg", 2),
    ("Load", 4),
    ("Look", 2),
    ("Model", 2),
    ("Moment", 2),
    ("Motion", 3),
    ("Names", 2),
    ("Observed", 2),
    ("Panel", 2),
    ("Part", 4),
    ("Piece", 5),
    ("Place", 2),
    ("Plate", 2),
    ("Pose", 4),
    ("Push", 3),
    ("Quantity", 2),
    ("Robot", 2),
    ("Row", 2),
    ("Run", 2),
    ("Scratch", 2),
    ("Seen", 2),
    ("Segment", 2),
    ("Setup", 2),
    ("Standing", 2),
    ("State", 2),
    ("Sum", 2),
    ("Surface", 2),
    ("Task", 2),
    ("Term", 2),
    ("Track", 2),
    ("Trial", 2),
    ("Wrench", 2),
];

/// The path of each struct, enum and trait, by its name.
fn types() -> BTreeMap<String, Vec<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut all: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if path.is_dir() && !["generated", "tests"].contains(&name) {
                folders.push(path);
            } else if name.ends_with(".rs") && name != "tests.rs" {
                let text = std::fs::read_to_string(&path).unwrap();
                for name in text.split("#[cfg(test)]\nmod").next().unwrap_or_default().lines().filter_map(declared) {
                    let file = path.strip_prefix(&root).unwrap().display().to_string();
                    all.entry(name.to_owned()).or_default().push(file);
                }
            }
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
    let allowed: BTreeMap<&str, usize> = NOT_YET.into();
    let twice = types.iter().filter(|(name, files)| files.len() > *allowed.get(name.as_str()).unwrap_or(&1));
    let twice: Vec<_> = twice.map(|(name, files)| format!("{name}: {}", files.join(", "))).collect();
    assert!(twice.is_empty(), "names of more than one type:\n{}", twice.join("\n"));
}

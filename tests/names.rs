//! One name, one meaning: no two structs, enums or traits of `src/` have the same name. So a search for a name finds one
//! thing. Generated code, tests, aliases and types within a function or a trait are left out.

use std::collections::BTreeMap;
use std::path::Path;

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
    let twice = types.iter().filter(|(_, files)| files.len() > 1);
    let twice: Vec<_> = twice.map(|(name, files)| format!("{name}: {}", files.join(", "))).collect();
    assert!(twice.is_empty(), "names of more than one type:\n{}", twice.join("\n"));
}

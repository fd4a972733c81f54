//! The error type, files that survive a power cut, and Student's t.

use sandgait::error::{check_range, short};
use sandgait::files::{Lock, write};
use sandgait::student::{one_sided_95, two_sided_95};
use std::path::PathBuf;

#[test]
fn numbers_in_messages_are_short() {
    let numbers = [0.0, 0.25, -3.0, 1e6, 1e308, -1e-9, f64::NAN, f64::INFINITY];
    let said = ["0", "0.25", "-3", "1000000", "1e308", "-1e-9", "NaN", "inf"];
    assert_eq!(numbers.map(short), said);
    let error = check_range("x", 1e308, -1e300..=0.0).unwrap_err();
    assert_eq!(error.to_string(), "x: 1e308 is outside [-1e300, 0]");
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("sandgait-files-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn a_file_is_replaced_as_a_whole() {
    let folder = folder("replaced");
    let path = folder.join("state.bin");
    // What a killed process has left.
    std::fs::write(folder.join("state.bin.partial"), "half").unwrap();
    write(&path, b"first").unwrap();
    write(&path, b"second").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"second");
    let names: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["state.bin"]);
    // A name that cannot be replaced: the error names the file, and nothing is left beside it.
    std::fs::create_dir_all(folder.join("taken/inside")).unwrap();
    assert!(write(&folder.join("taken"), b"x").unwrap_err().to_string().contains("taken: "));
    assert!(!folder.join("taken.partial").exists());
    assert!(write(&folder.join("missing/x"), b"x").unwrap_err().to_string().contains("missing/x: "));
    std::fs::remove_dir_all(folder).unwrap();
}

/// Two descriptors of one file exclude each other like two processes.
#[test]
fn a_folder_has_one_writer() {
    let folder = folder("locked");
    let lock = Lock::new(&folder, "choose another --out").unwrap();
    let error = Lock::new(&folder, "choose another --out").unwrap_err().to_string();
    assert!(error.ends_with(": another process writes into this folder; choose another --out"), "{error}");
    drop(lock);
    drop(Lock::new(&folder, "").unwrap());
    std::fs::remove_dir_all(folder).unwrap();
}

/// Compared with printed tables.
#[test]
fn quantiles_are_those_of_tables() {
    // With fewer degrees of freedom the expansion is worse.
    for (degrees, two) in [(3.0, 3.182), (5.0, 2.571)] {
        assert!((two_sided_95(degrees) / two - 1.0).abs() < 1e-2, "{degrees}");
    }
    for (degrees, two, one) in [(4.0, 2.776, 2.132), (10.0, 2.228, 1.812), (30.0, 2.042, 1.697)] {
        assert!((two_sided_95(degrees) / two - 1.0).abs() < 5e-3, "{degrees}");
        assert!((one_sided_95(degrees) / one - 1.0).abs() < 5e-3, "{degrees}");
    }
}

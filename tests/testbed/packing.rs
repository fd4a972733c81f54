//! Robots that were read, as options of an environment take them.

use sandgait::robots::Import;
use sandgait::sim::tree::{packed, plates::of_touching};

/// The robot on plates of 2 cm, without its looks.
pub fn pack(import: &Import) -> String {
    let plates = of_touching(&import.tree, &import.touching(None).unwrap(), Some(0.02)).unwrap();
    let count = plates.iter().map(Vec::len).sum();
    packed::compressed(&packed::pack(&import.tree, &plates, None).unwrap(), count).unwrap()
}

//! The most expensive files of each kind stay within the price that is stated for their length.

#[path = "../../tests/testbed/onnx.rs"]
mod onnx;

use super::{MOST_BYTES, price, read};
use onnx::{field, file, node};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts the bytes in use, and their largest number.
struct Counted;

static NOW: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        MOST.fetch_max(now, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counted = Counted;

const SIZES: [usize; 2] = [40, 40];

/// The files, and the words of their refusals; None: the file is accepted.
fn files() -> Vec<(&'static str, Vec<u8>, Option<&'static str>)> {
    let file = |nodes: &[Vec<u8>], tensors: &[Vec<u8>]| file(nodes, tensors, SIZES.map(|n| n as u64));
    let [relu, nothing] = [node("Relu", &["x"], "y"), Vec::new()];
    let attributes = [relu.clone(), field(5, b"").repeat(2_000_000)].concat();
    let twice = |k: usize| node("MatMul", &[&format!("v{k}"), "w"], &format!("v{}", k + 1));
    let mut wide = vec![node("MatMul", &["x", "first"], "v0")];
    wide.extend((0..7).map(twice));
    wide.push(node("MatMul", &["v7", "last"], "y"));
    let weights = [("first", [40, 512]), ("w", [512, 512]), ("last", [512, 40])];
    let mut constants = vec!["c"; 9_001];
    constants[0] = "x";
    vec![
        ("attributes", file(&[attributes], &[]), Some("more than 16384 fields")),
        ("empty nodes", file(&vec![nothing.clone(); 300], &[]), Some("300 nodes are more than 256")),
        ("many empty nodes", file(&vec![nothing; 2_000_000], &[]), Some("more than 16384 fields")),
        (
            "tensors",
            file(std::slice::from_ref(&relu), &vec![onnx::tensor("c", 1, &[]); 200_000]),
            Some("more than 16384 fields"),
        ),
        ("a long name", file(&[node("Relu", &[&"x".repeat(4_000_000)], "y")], &[]), Some("no earlier node")),
        ("integers", file(&[relu], &[onnx::ones("c", MOST_BYTES - 1000)]), None),
        ("Max of 10,000", file(&[node("Max", &["x"; 10_000], "y")], &[]), Some("65536 numbers")),
        ("Max of 1,000", file(&[node("Max", &["x"; 1_000], "y")], &[]), None),
        (
            "Min of constants",
            file(&[node("Min", &constants, "y")], &[onnx::zeros("c", [1, 40])]),
            Some("65536 numbers"),
        ),
        ("weights used often", file(&wide, &weights.map(|(name, dims)| onnx::zeros(name, dims))), None),
    ]
}

#[test]
fn no_file_costs_more_than_its_price() {
    for (name, file, words) in files() {
        let before = NOW.load(Ordering::Relaxed);
        MOST.store(before, Ordering::Relaxed);
        let read = read::program(&file, SIZES);
        let took = MOST.load(Ordering::Relaxed) - before;
        let most = price::reading_bytes(file.len());
        println!("{name}: a file of {} KiB took {} KiB, at most {} KiB", file.len() >> 10, took >> 10, most >> 10);
        assert!(took <= most, "{name}: {took} bytes are more than {most}");
        match (read, words) {
            (Ok(program), None) => {
                let kept = NOW.load(Ordering::Relaxed) - before;
                let price = price::Price::of(&program, SIZES[0]);
                // Vectors may have room to spare.
                assert!(price.bytes <= kept && kept <= 2 * price.bytes + 4096, "{name}: {kept} {price:?}");
                assert!(price.scratch_bytes <= 64 * (price::MOST_VALUES + SIZES[0]), "{name}");
            }
            (Err(error), Some(words)) => assert!(error.to_string().contains(words), "{name}: {error}"),
            (read, _) => panic!("{name}: {:?}", read.map(drop)),
        }
    }
}

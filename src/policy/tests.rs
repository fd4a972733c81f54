//! The most expensive files of each kind stay within the price that is stated for their length.

use super::format::{
    Attribute, Dimension, FLOAT, Graph, INT64, Node, OnnxModel, OperatorSet, Tensor, TensorShape, TensorType, Type,
    ValueInfo,
};
use super::{MOST_BYTES, price, read};
use prost::Message as _;
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

fn rows(name: &str) -> ValueInfo {
    let dim = |value| Dimension { value, name: String::new() };
    let shape = TensorShape { dim: vec![dim(None), dim(Some(SIZES[0] as i64))] };
    let tensor = TensorType { elem_type: FLOAT, shape: Some(shape) };
    ValueInfo { name: name.into(), kind: Some(Type { tensor: Some(tensor) }) }
}

/// The observation is `x`, the action `y`.
fn file(node: Vec<Node>, initializer: Vec<Tensor>) -> Vec<u8> {
    let graph = Graph { node, initializer, input: vec![rows("x")], output: vec![rows("y")], ..Graph::default() };
    let opset_import = vec![OperatorSet { domain: String::new(), version: 18 }];
    OnnxModel { graph: Some(graph), opset_import, ..OnnxModel::default() }.encode_to_vec()
}

fn node(kind: &str, input: Vec<String>, output: &str) -> Node {
    Node { input, output: vec![output.into()], op_type: kind.into(), ..Node::default() }
}

fn weights(name: &str, dims: [i64; 2]) -> Tensor {
    let raw_data = vec![0; 4 * (dims[0] * dims[1]) as usize];
    Tensor { dims: dims.to_vec(), data_type: FLOAT, name: name.into(), raw_data, ..Tensor::default() }
}

/// The files, and the words of their refusals; None: it is taken.
fn files() -> Vec<(&'static str, Vec<u8>, Option<&'static str>)> {
    let x = |n: usize| vec!["x".to_owned(); n];
    let attributes = Node { attribute: vec![Attribute::default(); 2_000_000], ..node("Relu", x(1), "y") };
    let whole = (MOST_BYTES - 1000) as i64;
    let integers = Tensor {
        dims: vec![1, whole],
        data_type: INT64,
        name: "c".into(),
        int64_data: vec![1; whole as usize],
        ..Tensor::default()
    };
    let twice = |k: usize| node("MatMul", vec![format!("v{k}"), "w".into()], &format!("v{}", k + 1));
    let mut wide = vec![node("MatMul", vec!["x".into(), "first".into()], "v0")];
    wide.extend((0..7).map(twice));
    wide.push(node("MatMul", vec!["v7".into(), "last".into()], "y"));
    let unpacked = Tensor { data_type: FLOAT, name: "c".into(), ..Tensor::default() };
    vec![
        ("attributes", file(vec![attributes], vec![]), Some("more than 16384 fields")),
        ("empty nodes", file(vec![Node::default(); 300], vec![]), Some("300 nodes are more than 256")),
        ("many empty nodes", file(vec![Node::default(); 2_000_000], vec![]), Some("more than 16384 fields")),
        ("tensors", file(vec![node("Relu", x(1), "y")], vec![unpacked; 200_000]), Some("more than 16384 fields")),
        ("a long name", file(vec![node("Relu", vec!["x".repeat(4_000_000)], "y")], vec![]), Some("no earlier node")),
        ("integers", file(vec![node("Relu", x(1), "y")], vec![integers]), None),
        ("Max of 10,000", file(vec![node("Max", x(10_000), "y")], vec![]), Some("65536 numbers")),
        ("Max of 1,000", file(vec![node("Max", x(1_000), "y")], vec![]), None),
        (
            "Min of constants",
            file(vec![node("Min", [x(1), vec!["c".into(); 9_000]].concat(), "y")], vec![weights("c", [1, 40])]),
            Some("65536 numbers"),
        ),
        (
            "weights used often",
            file(wide, vec![weights("first", [40, 512]), weights("w", [512, 512]), weights("last", [512, 40])]),
            None,
        ),
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

//! Writes ONNX files byte by byte, so that they may contain what no tool writes. They have one input `x` and one output
//! `y`, both rows of numbers.

/// A field of a protocol buffer that has a length.
pub fn field(tag: u64, content: &[u8]) -> Vec<u8> {
    [&varint(tag << 3 | 2)[..], &varint(content.len() as u64), content].concat()
}

/// A field that is a whole number.
fn number(tag: u64, value: u64) -> Vec<u8> {
    [varint(tag << 3), varint(value)].concat()
}

fn varint(value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    prost::encoding::encode_varint(value, &mut bytes);
    bytes
}

/// A node of this kind.
pub fn node(kind: &str, inputs: &[&str], output: &str) -> Vec<u8> {
    let inputs: Vec<u8> = inputs.iter().flat_map(|name| field(1, name.as_bytes())).collect();
    [inputs, field(2, output.as_bytes()), field(4, kind.as_bytes())].concat()
}

/// A matrix of f32, all 0.
pub fn zeros(name: &str, dims: [u64; 2]) -> Vec<u8> {
    let data = vec![0; 4 * (dims[0] * dims[1]) as usize];
    [tensor(name, 1, &dims), field(9, &data)].concat()
}

/// A row of i64, all 1.
pub fn ones(name: &str, count: usize) -> Vec<u8> {
    [tensor(name, 7, &[1, count as u64]), field(7, &vec![1; count])].concat()
}

/// A tensor without numbers; type 1: f32, 7: i64.
pub fn tensor(name: &str, kind: u64, dims: &[u64]) -> Vec<u8> {
    let dims: Vec<u8> = dims.iter().flat_map(|dim| number(1, *dim)).collect();
    [dims, number(2, kind), field(8, name.as_bytes())].concat()
}

/// A file with these nodes and tensors; `sizes`: the numbers in a row of `x` and of `y`.
pub fn file(nodes: &[Vec<u8>], tensors: &[Vec<u8>], sizes: [u64; 2]) -> Vec<u8> {
    let all = |tag: u64, parts: &[Vec<u8>]| parts.iter().flat_map(|part| field(tag, part)).collect::<Vec<u8>>();
    let rows = |name: &str, width: u64| {
        let dims = [field(1, &field(2, b"n")), field(1, &number(1, width))].concat();
        let tensor = [number(1, 1), field(2, &dims)].concat();
        [field(1, name.as_bytes()), field(2, &field(1, &tensor))].concat()
    };
    let ends = [field(11, &rows("x", sizes[0])), field(12, &rows("y", sizes[1]))].concat();
    let graph = [all(1, nodes), all(5, tensors), ends].concat();
    [field(7, &graph), field(8, &number(2, 18))].concat()
}

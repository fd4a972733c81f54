//! Writes learnt policies as ONNX files, which any ONNX runtime and [`super::Network`] can read.

use super::format::{
    Dimension, FLOAT, Graph, Node, OnnxModel, OperatorSet, Tensor, TensorShape, TensorType, Type, ValueInfo,
};
use prost::Message as _;

/// Operator set and format version of the files: the versions of 2022, which present runtimes support.
const OPSET: i64 = 18;
const IR: i64 = 8;

/// Names of the network's input and output.
const INPUT: &str = "observation";
const OUTPUT: &str = "action";

/// A file under construction. Values are referred to by name.
pub struct OnnxWriter {
    observation: usize,
    graph: Graph,
}

impl OnnxWriter {
    /// A network whose input rows have this many numbers.
    pub fn new(observation: usize) -> Self {
        let input = vec![rows(INPUT, observation)];
        Self { observation, graph: Graph { name: "policy".into(), input, ..Graph::default() } }
    }

    /// The input rows.
    pub fn input(&self) -> String {
        INPUT.into()
    }

    /// Numbers in each input row.
    pub fn observation(&self) -> usize {
        self.observation
    }

    /// (x − center) / scale for each number, clipped to ± `clip`.
    pub fn normalize(&mut self, x: &str, center: &[f32], scale: &[f32], clip: f32) -> String {
        let center = self.row(center);
        let difference = self.node("Sub", &[x, &center]);
        let scale = self.row(scale);
        let scaled = self.node("Div", &[&difference, &scale]);
        self.clip(&scaled, [-clip, clip])
    }

    /// x − row
    pub fn subtract(&mut self, x: &str, row: &[f32]) -> String {
        let row = self.row(row);
        self.node("Sub", &[x, &row])
    }

    /// Clips every number to the same bounds.
    pub fn clip(&mut self, x: &str, bounds: [f32; 2]) -> String {
        let [low, high] = bounds.map(|bound| self.numbers(&[], &[bound]));
        self.node("Clip", &[x, &low, &high])
    }

    /// Clips each number to its own bounds.
    pub fn clip_row(&mut self, x: &str, bounds: &[[f32; 2]]) -> String {
        let side = |k: usize| bounds.iter().map(|b| b[k]).collect::<Vec<_>>();
        let (low, high) = (self.row(&side(0)), self.row(&side(1)));
        let above = self.node("Max", &[x, &low]);
        self.node("Min", &[&above, &high])
    }

    /// x·W + b; `weights`: f32 [inputs, outputs].
    pub fn dense(&mut self, x: &str, weights: &[f32], bias: &[f32]) -> String {
        let weights = self.numbers(&[weights.len() / bias.len(), bias.len()], weights);
        let bias = self.row(bias);
        self.node("Gemm", &[x, &weights, &bias])
    }

    pub fn tanh(&mut self, x: &str) -> String {
        self.node("Tanh", &[x])
    }

    pub fn add(&mut self, a: &str, b: &str) -> String {
        self.node("Add", &[a, b])
    }

    /// Returns the file's bytes. `x` names the value that becomes the output; each of its rows has `action` numbers.
    pub fn finish(mut self, x: &str, action: usize) -> Vec<u8> {
        let output = OUTPUT.to_owned();
        self.graph.node.push(Node {
            input: vec![x.into()],
            output: vec![output],
            op_type: "Identity".into(),
            ..Node::default()
        });
        self.graph.output = vec![rows(OUTPUT, action)];
        let model = OnnxModel {
            ir_version: IR,
            producer_name: format!("sandgait {}", env!("CARGO_PKG_VERSION")),
            graph: Some(self.graph),
            opset_import: vec![OperatorSet { domain: String::new(), version: OPSET }],
        };
        model.encode_to_vec()
    }

    fn row(&mut self, numbers: &[f32]) -> String {
        self.numbers(&[numbers.len()], numbers)
    }

    fn numbers(&mut self, dims: &[usize], numbers: &[f32]) -> String {
        let name = format!("c{}", self.graph.initializer.len());
        self.graph.initializer.push(Tensor {
            dims: dims.iter().map(|d| *d as i64).collect(),
            data_type: FLOAT,
            name: name.clone(),
            raw_data: numbers.iter().flat_map(|x| x.to_le_bytes()).collect(),
            ..Tensor::default()
        });
        name
    }

    fn node(&mut self, kind: &str, inputs: &[&str]) -> String {
        let name = format!("v{}", self.graph.node.len());
        self.graph.node.push(Node {
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![name.clone()],
            op_type: kind.into(),
            ..Node::default()
        });
        name
    }
}

/// f32 [n, width]
fn rows(name: &str, width: usize) -> ValueInfo {
    let dim =
        vec![Dimension { value: None, name: "n".into() }, Dimension { value: Some(width as i64), name: String::new() }];
    let tensor = TensorType { elem_type: FLOAT, shape: Some(TensorShape { dim }) };
    ValueInfo { name: name.into(), kind: Some(Type { tensor: Some(tensor) }) }
}

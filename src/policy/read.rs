//! Reads an ONNX file into a program of checked steps. No file makes this code panic or exceed its [`super::price`].

use super::MOST_BYTES;
use super::constant::{Constant, shown};
use super::format::{Attribute, FLOAT, Graph, Node, OnnxModel, ValueInfo};
use super::operator::{Arithmetic, Function, Operand, Operator, Program, Step};
use super::price::{MOST_NODES, MOST_PRODUCTS, MOST_VALUES, MOST_WIDTH, check_fields};
use crate::error::{Error, Result};
use prost::Message as _;
use std::collections::HashMap;

/// Versions of ONNX's operator set in which [`OPERATORS`] have the meaning that they have here.
const OPSETS: std::ops::RangeInclusive<i64> = 7..=23;

const OPERATORS: [&str; 26] = [
    "Abs",
    "Add",
    "Cast",
    "Clip",
    "Concat",
    "Constant",
    "Div",
    "Dropout",
    "Elu",
    "Exp",
    "Flatten",
    "Gemm",
    "Identity",
    "LeakyRelu",
    "MatMul",
    "Max",
    "Min",
    "Mul",
    "Neg",
    "Relu",
    "Reshape",
    "Sigmoid",
    "Softplus",
    "Sqrt",
    "Sub",
    "Tanh",
];

fn invalid(why: impl Into<String>) -> Error {
    Error::invalid("policy", why)
}

/// Reads the program from `onnx`; `sizes` are the lengths of an observation and an action.
pub fn program(onnx: &[u8], sizes: [usize; 2]) -> Result<Program> {
    if onnx.len() > MOST_BYTES {
        return Err(invalid(format!("{} bytes are more than {} MiB", onnx.len(), MOST_BYTES >> 20)));
    }
    check_fields(onnx)?;
    let model = OnnxModel::decode(onnx).map_err(|e| invalid(format!("this is no ONNX file: {e}")))?;
    let opset = model.opset_import.iter().find(|o| o.domain.is_empty() || o.domain == "ai.onnx").map(|o| o.version);
    match (opset, model.graph) {
        (Some(version), _) if !OPSETS.contains(&version) => {
            let (first, last) = (OPSETS.start(), OPSETS.end());
            Err(invalid(format!("operator set {version} is outside [{first}, {last}]")))
        }
        (Some(_), Some(graph)) => OnnxReader::read(&graph, sizes),
        _ => Err(invalid("this is no ONNX file: it has no graph or no operator set")),
    }
}

/// The meaning of a name.
#[derive(Clone)]
enum NameMeaning {
    Value(usize),
    Constant(Constant),
}

struct OnnxReader<'a> {
    names: HashMap<&'a str, NameMeaning>,
    /// How many numbers each value has.
    widths: Vec<usize>,
    /// How many numbers all steps have together.
    values: usize,
    steps: Vec<Step>,
    products: usize,
}

impl<'a> OnnxReader<'a> {
    fn read(graph: &'a Graph, [observation, action]: [usize; 2]) -> Result<Program> {
        if graph.node.len() > MOST_NODES {
            return Err(invalid(format!("{} nodes are more than {MOST_NODES}", graph.node.len())));
        }
        let mut names = HashMap::new();
        for tensor in &graph.initializer {
            names.insert(tensor.name.as_str(), NameMeaning::Constant(Constant::read(&tensor.name, tensor)?));
        }
        // Old files list their weights among the inputs.
        let inputs: Vec<_> = graph.input.iter().filter(|i| !names.contains_key(i.name.as_str())).collect();
        let ([input], [output]) = (&inputs[..], &graph.output[..]) else {
            let (i, o) = (inputs.len(), graph.output.len());
            return Err(invalid(format!("{i} inputs and {o} outputs; a policy has one observation and one action")));
        };
        rows("input", input, observation)?;
        rows("output", output, action)?;
        names.insert(&input.name, NameMeaning::Value(0));
        let mut reader = Self { names, widths: vec![observation], values: 0, steps: Vec::new(), products: 0 };
        for node in &graph.node {
            reader.node(node)?;
        }
        match reader.names.get(output.name.as_str()) {
            Some(NameMeaning::Value(value)) if reader.widths[*value] == action => {
                Ok(Program { steps: reader.steps, action: *value })
            }
            Some(NameMeaning::Value(value)) => {
                Err(invalid(format!("its output has {} numbers, an action has {action}", reader.widths[*value])))
            }
            _ => Err(invalid(format!("its output {:?} does not come from the observation", shown(&output.name)))),
        }
    }

    fn node(&mut self, node: &'a Node) -> Result<()> {
        let kind = node.op_type.as_str();
        if !OPERATORS.contains(&kind) || !["", "ai.onnx"].contains(&node.domain.as_str()) {
            let name = if node.domain.is_empty() { kind.into() } else { format!("{}.{kind}", node.domain) };
            let (name, known) = (shown(&name), OPERATORS.join(", "));
            return Err(invalid(format!("operator {name:?} is not supported; supported: {known}")));
        }
        let output = node.output.first().ok_or_else(|| wrong(node, "has no output"))?;
        let result = match kind {
            "Constant" => NameMeaning::Constant(constant(node)?),
            "Cast" | "Dropout" | "Flatten" | "Identity" | "Reshape" => self.same(node)?,
            "Clip" => self.clip(node)?,
            "Concat" => self.concat(node)?,
            "Gemm" | "MatMul" => self.dense(node)?,
            "Add" => self.fold(node, Arithmetic::Add)?,
            "Sub" => self.fold(node, Arithmetic::Sub)?,
            "Mul" => self.fold(node, Arithmetic::Mul)?,
            "Div" => self.fold(node, Arithmetic::Div)?,
            "Min" => self.fold(node, Arithmetic::Min)?,
            "Max" => self.fold(node, Arithmetic::Max)?,
            _ => {
                let input = self.value(node, 0)?;
                self.step(Operator::Each { input, function: function(node) }, self.widths[input])?
            }
        };
        self.names.insert(output, result);
        Ok(())
    }

    /// The meaning of input `k` of a node; None if the node has no such input.
    fn input(&self, node: &Node, k: usize) -> Result<Option<&NameMeaning>> {
        let Some(name) = node.input.get(k).filter(|name| !name.is_empty()) else { return Ok(None) };
        self.names
            .get(name.as_str())
            .map(Some)
            .ok_or_else(|| wrong(node, format!("reads {:?}, which no earlier node computes", shown(name))))
    }

    /// Input `k` as a value that depends on the observation.
    fn value(&self, node: &Node, k: usize) -> Result<usize> {
        match self.input(node, k)? {
            Some(NameMeaning::Value(value)) => Ok(*value),
            _ => Err(wrong(node, format!("needs a value that depends on the observation as input {k}"))),
        }
    }

    /// Input `k` as constants of the file, if it has one.
    fn constant(&self, node: &Node, k: usize) -> Result<Option<&Constant>> {
        match self.input(node, k)? {
            None => Ok(None),
            Some(NameMeaning::Constant(constant)) => Ok(Some(constant)),
            Some(NameMeaning::Value(_)) => {
                Err(wrong(node, format!("needs constants as input {k}, not a value that depends on the observation")))
            }
        }
    }

    fn step(&mut self, operator: Operator, width: usize) -> Result<NameMeaning> {
        if !(1..=MOST_WIDTH).contains(&width) {
            return Err(invalid(format!("a layer has {width} numbers, which is outside [1, {MOST_WIDTH}]")));
        }
        self.values += width;
        if self.values > MOST_VALUES {
            return Err(invalid(format!("it computes more than {MOST_VALUES} numbers for an action")));
        }
        self.steps.push(Step { operator, width });
        self.widths.push(width);
        Ok(NameMeaning::Value(self.widths.len() - 1))
    }

    /// Nodes that have no effect on rows of numbers.
    fn same(&self, node: &Node) -> Result<NameMeaning> {
        let value = self.value(node, 0)?;
        let whole = |name, default| attribute(node, name).map_or(default, |a| a.i);
        let fits = match node.op_type.as_str() {
            "Cast" => whole("to", 0) == i64::from(FLOAT),
            "Flatten" => [1, -1].contains(&whole("axis", 1)),
            "Reshape" => match self.constant(node, 1)?.map(Constant::whole).as_deref() {
                Some([-1 | 0, width]) => {
                    *width == self.widths[value] as i64 || (*width == 0 && whole("allowzero", 0) == 0)
                }
                _ => false,
            },
            _ => true,
        };
        if fits { Ok(NameMeaning::Value(value)) } else { Err(wrong(node, "does not give rows of f32")) }
    }

    /// Bounds are inputs since operator set 11, attributes before.
    fn clip(&mut self, node: &Node) -> Result<NameMeaning> {
        let mut value = self.value(node, 0)?;
        for (k, name, arithmetic) in [(1, "min", Arithmetic::Max), (2, "max", Arithmetic::Min)] {
            let given = self.constant(node, k)?;
            let bound = match given {
                Some(constant) => {
                    Some(constant.scalar().ok_or_else(|| wrong(node, "has a bound that is not one number"))?)
                }
                None => attribute(node, name).map(|a| a.f),
            };
            let Some(bound) = bound else { continue };
            let (left, right) = (Operand::Value(value), Operand::Row(vec![bound]));
            self.step(Operator::Both { left, right, arithmetic }, self.widths[value])?;
            value = self.widths.len() - 1;
        }
        Ok(NameMeaning::Value(value))
    }

    fn concat(&mut self, node: &Node) -> Result<NameMeaning> {
        if !attribute(node, "axis").is_some_and(|a| [1, -1].contains(&a.i)) {
            return Err(wrong(node, "joins values that are not rows"));
        }
        let inputs = (0..node.input.len()).map(|k| self.value(node, k)).collect::<Result<Vec<_>>>()?;
        let width = inputs.iter().map(|i| self.widths[*i]).sum();
        self.step(Operator::Concat { inputs }, width)
    }

    /// Combines operands one after the other; `Min` and `Max` may have more than two, or one.
    fn fold(&mut self, node: &Node, arithmetic: Arithmetic) -> Result<NameMeaning> {
        let many = matches!(arithmetic, Arithmetic::Min | Arithmetic::Max);
        if node.input.is_empty() || (!many && node.input.len() != 2) {
            return Err(wrong(node, format!("has {} inputs", node.input.len())));
        }
        let (mut left, mut wide) = self.operand(node, 0)?;
        for k in 1..node.input.len() {
            let (right, width) = self.operand(node, k)?;
            if matches!((&left, &right), (Operand::Row(_), Operand::Row(_))) {
                return Err(wrong(node, "has only constants as inputs; export with constant folding"));
            }
            if wide != width && wide != 1 && width != 1 {
                return Err(wrong(node, format!("joins {wide} numbers and {width}")));
            }
            wide = wide.max(width);
            self.step(Operator::Both { left, right, arithmetic }, wide)?;
            left = Operand::Value(self.widths.len() - 1);
        }
        match left {
            Operand::Value(value) => Ok(NameMeaning::Value(value)),
            Operand::Row(_) => Err(wrong(node, "has only constants as inputs; export with constant folding")),
        }
    }

    /// Input `k` with its width.
    fn operand(&self, node: &Node, k: usize) -> Result<(Operand, usize)> {
        match self.input(node, k)? {
            Some(NameMeaning::Value(value)) => Ok((Operand::Value(*value), self.widths[*value])),
            Some(NameMeaning::Constant(constant)) => match constant.row() {
                Some(row) if !row.is_empty() => Ok((Operand::Row(row.to_vec()), row.len())),
                _ => Err(wrong(node, format!("has numbers of shape {:?} where a row is needed", constant.dims))),
            },
            None => Err(wrong(node, format!("has no input {k}"))),
        }
    }

    /// x·W + b: a `MatMul`, or a `Gemm` with its factors.
    fn dense(&mut self, node: &Node) -> Result<NameMeaning> {
        let input = self.value(node, 0)?;
        let matrix = self.constant(node, 1)?.ok_or_else(|| wrong(node, "has no weights"))?;
        let gemm = node.op_type == "Gemm";
        let flag = |name| gemm && attribute(node, name).is_some_and(|a| a.i != 0);
        let factor = |name| if gemm { attribute(node, name).map_or(1.0, |a| a.f) } else { 1.0 };
        let [rows, columns] = matrix.dims[..] else { return Err(wrong(node, "has weights that are no matrix")) };
        let [inputs, outputs] = if flag("transB") { [columns, rows] } else { [rows, columns] };
        if flag("transA") || inputs != self.widths[input] {
            return Err(wrong(
                node,
                format!("needs rows of {inputs} numbers, but its input has {}", self.widths[input]),
            ));
        }
        let products = self.products + inputs * outputs;
        if products > MOST_PRODUCTS {
            return Err(wrong(node, format!("makes the network too large: {MOST_PRODUCTS} products are the most")));
        }
        let place = |k: usize, j: usize| if flag("transB") { j * columns + k } else { k * columns + j };
        let alpha = factor("alpha");
        let weights = (0..inputs).flat_map(|k| (0..outputs).map(move |j| (k, j)));
        let weights = weights.map(|(k, j)| alpha * matrix.data[place(k, j)]).collect();
        let added = if gemm { self.constant(node, 2)? } else { None };
        let row = match added.map(Constant::row) {
            None => &[0.0],
            Some(Some(row)) if row.len() == 1 || row.len() == outputs => row,
            _ => return Err(wrong(node, format!("adds a bias that is not a row of {outputs} numbers"))),
        };
        let beta = factor("beta");
        let bias = (0..outputs).map(|j| beta * row[if row.len() == 1 { 0 } else { j }]).collect();
        self.products = products;
        self.step(Operator::Dense { input, weights, bias }, outputs)
    }
}

/// An error about a node.
fn wrong(node: &Node, why: impl std::fmt::Display) -> Error {
    let name = node.output.first().map_or("", String::as_str);
    invalid(format!("node {:?} ({}) {why}", shown(name), node.op_type))
}

fn attribute<'a>(node: &'a Node, name: &str) -> Option<&'a Attribute> {
    node.attribute.iter().find(|a| a.name == name)
}

/// The function of a node with one input. If the node has no alpha, the default of ONNX applies.
fn function(node: &Node) -> Function {
    let alpha = |default| attribute(node, "alpha").map_or(default, |a| a.f);
    match node.op_type.as_str() {
        "Abs" => Function::Abs,
        "Elu" => Function::Elu { alpha: alpha(1.0) },
        "Exp" => Function::Exp,
        "LeakyRelu" => Function::LeakyRelu { alpha: alpha(0.01) },
        "Neg" => Function::Neg,
        "Relu" => Function::Relu,
        "Sigmoid" => Function::Sigmoid,
        "Softplus" => Function::Softplus,
        "Sqrt" => Function::Sqrt,
        _ => Function::Tanh,
    }
}

fn constant(node: &Node) -> Result<Constant> {
    if let Some(tensor) = attribute(node, "value").and_then(|a| a.t.as_ref()) {
        return Constant::read(&node.output[0], tensor);
    }
    let number = attribute(node, "value_float").map(|a| a.f).or(attribute(node, "value_int").map(|a| a.i as f32));
    let number = number.ok_or_else(|| wrong(node, "has neither value, value_float nor value_int"))?;
    Ok(Constant { dims: Vec::new(), data: vec![number] })
}

/// Checks that the graph's input or output has rows of `numbers` f32.
fn rows(what: &str, info: &ValueInfo, numbers: usize) -> Result<()> {
    let tensor = info.kind.as_ref().and_then(|t| t.tensor.as_ref());
    let dims = tensor.and_then(|t| t.shape.as_ref()).map(|s| &s.dim);
    let is_rows = tensor.is_some_and(|t| t.elem_type == FLOAT) && dims.is_none_or(|d| d.len() == 2);
    if !is_rows {
        return Err(invalid(format!("its {what} {:?} is not f32 [n, {numbers}]", shown(&info.name))));
    }
    match dims.and_then(|d| d[1].value) {
        Some(other) if other != numbers as i64 => Err(invalid(format!(
            "its {what} {:?} has {other} numbers a row, this task has {numbers}",
            shown(&info.name)
        ))),
        _ => Ok(()),
    }
}

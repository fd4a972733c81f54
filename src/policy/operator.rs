//! The operators of a network's steps; each is defined as the ONNX operator with the same name.

use super::{LANES, Lanes};

/// Functions of one number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Function {
    Abs,
    Elu { alpha: f32 },
    Exp,
    LeakyRelu { alpha: f32 },
    Neg,
    Relu,
    Sigmoid,
    Softplus,
    Sqrt,
    Tanh,
}

impl Function {
    fn of(self, x: f32) -> f32 {
        match self {
            Self::Abs => x.abs(),
            Self::Elu { alpha } => {
                if x < 0.0 {
                    alpha * x.exp_m1()
                } else {
                    x
                }
            }
            Self::Exp => x.exp(),
            Self::LeakyRelu { alpha } => {
                if x < 0.0 {
                    alpha * x
                } else {
                    x
                }
            }
            Self::Neg => -x,
            // max would turn NaN into 0.
            Self::Relu => {
                if x < 0.0 {
                    0.0
                } else {
                    x
                }
            }
            Self::Sigmoid => 1.0 / (1.0 + (-x).exp()),
            // ln(1 + eˣ) without overflow.
            Self::Softplus => x.max(0.0) + (-x.abs()).exp().ln_1p(),
            Self::Sqrt => x.sqrt(),
            Self::Tanh => x.tanh(),
        }
    }
}

/// Functions of two numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Arithmetic {
    Add,
    Sub,
    Mul,
    Div,
    Min,
    Max,
}

impl Arithmetic {
    fn of(self, a: f32, b: f32) -> f32 {
        match self {
            Self::Add => a + b,
            Self::Sub => a - b,
            Self::Mul => a * b,
            Self::Div => a / b,
            // NaN stays NaN, as ONNX defines.
            Self::Min => {
                if b < a || b.is_nan() {
                    b
                } else {
                    a
                }
            }
            Self::Max => {
                if b > a || b.is_nan() {
                    b
                } else {
                    a
                }
            }
        }
    }
}

/// An input of a step: a value of the network, or constants that are the same for every environment.
#[derive(Clone, Debug, PartialEq)]
pub enum Operand {
    Value(usize),
    Row(Vec<f32>),
}

impl Operand {
    /// Number of constants.
    pub fn constants(&self) -> usize {
        if let Self::Row(row) = self { row.len() } else { 0 }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub enum Operator {
    /// x·W + b. `weights`: f32 [inputs, outputs]; `bias`: f32 [outputs].
    Dense {
        input: usize,
        weights: Vec<f32>,
        bias: Vec<f32>,
    },
    Each {
        input: usize,
        function: Function,
    },
    /// An operand that is one number applies to all numbers of the other operand.
    Both {
        left: Operand,
        right: Operand,
        arithmetic: Arithmetic,
    },
    Concat {
        inputs: Vec<usize>,
    },
}

impl Operator {
    /// Fills `out`, one entry for each number of the result, from the earlier values.
    pub fn compute(&self, values: &[Vec<Lanes>], out: &mut [Lanes]) {
        match self {
            Self::Dense { input, weights, bias } => dense(&values[*input], weights, bias, out),
            Self::Each { input, function } => {
                out.iter_mut().zip(&values[*input]).for_each(|(out, x)| *out = x.map(|x| function.of(x)));
            }
            Self::Both { left, right, arithmetic } => {
                for (k, out) in out.iter_mut().enumerate() {
                    let (a, b) = (operand(values, left, k), operand(values, right, k));
                    *out = std::array::from_fn(|lane| arithmetic.of(a[lane], b[lane]));
                }
            }
            Self::Concat { inputs } => {
                let all = inputs.iter().flat_map(|i| &values[*i]);
                out.iter_mut().zip(all).for_each(|(out, x)| *out = *x);
            }
        }
    }
}

/// Number `k` of an operand, or its only number.
fn operand(values: &[Vec<Lanes>], operand: &Operand, k: usize) -> Lanes {
    match operand {
        Operand::Value(i) => values[*i][if values[*i].len() == 1 { 0 } else { k }],
        Operand::Row(row) => [row[if row.len() == 1 { 0 } else { k }]; LANES],
    }
}

/// Number of outputs that are summed at the same time, so that each input is read once for all of them. Our choice: the
/// sums take half of the registers of AVX2; with eight outputs no register would be left.
const TILE: usize = 4;

/// Each sum starts at its bias and adds the inputs in order, so it does not depend on the tile, to the last bit.
fn dense(input: &[Lanes], weights: &[f32], bias: &[f32], out: &mut [Lanes]) {
    let width = bias.len();
    for first in (0..width).step_by(TILE) {
        let count = TILE.min(width - first);
        let mut sums: [Lanes; TILE] = std::array::from_fn(|j| [bias[(first + j).min(width - 1)]; LANES]);
        for (x, row) in input.iter().zip(weights.chunks_exact(width)) {
            for (j, sum) in sums.iter_mut().enumerate() {
                let w = row[(first + j).min(width - 1)];
                sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += w * x);
            }
        }
        out[first..first + count].copy_from_slice(&sums[..count]);
    }
}

/// One step of the program; the result is the next value.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub operator: Operator,
    /// Number of components of the result.
    pub width: usize,
}

/// The program: value 0 is the observation, value k the result of step k − 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Program {
    pub steps: Vec<Step>,
    /// Index of the value that is the action.
    pub action: usize,
}

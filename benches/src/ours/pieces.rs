//! Batch norm, alone and with what follows it, and the element-wise and pooling pieces of the networks.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode_autodiff::{Activation, Conv2d, PadMode, Pool, Shape, Tape, Tensor, Var};
use serde_json::{Value, json};

use crate::case::{Case, Ours, Results, seeded, timed};
use crate::inputs::Inputs;

/// An operation with the shapes of its inputs.
#[derive(Clone, Debug)]
pub struct PieceCase {
    /// Name, unique within a run.
    pub name: &'static str,
    op: &'static str,
    shapes: &'static [[usize; 4]],
}

const fn piece(name: &'static str, op: &'static str, shapes: &'static [[usize; 4]]) -> PieceCase {
    PieceCase { name, op, shapes }
}

/// What the networks have beside convolutions.
pub const PIECES: [PieceCase; 17] = [
    piece("batch norm 64 48x160", "batch_norm", &[[1, 64, 48, 160]]),
    piece("batch norm 64 48x160 b4", "batch_norm", &[[4, 64, 48, 160]]),
    piece("batch norm 32 32x96 b4", "batch_norm", &[[4, 32, 32, 96]]),
    piece("batch norm + ReLU 64 48x160", "batch_norm_relu", &[[1, 64, 48, 160]]),
    piece("batch norm + ELU 64 48x160", "batch_norm_elu", &[[1, 64, 48, 160]]),
    piece("convolution + bias + ELU 32 96x320", "conv_elu", &[[1, 32, 96, 320]]),
    piece("convolution + bias + ELU 16 32x96 b4", "conv_elu", &[[4, 16, 32, 96]]),
    piece("batch norm + skip + ReLU 64 48x160", "batch_norm_skip_relu", &[[1, 64, 48, 160], [1, 64, 48, 160]]),
    piece("batch norm + skip + ReLU 32 32x96 b4", "batch_norm_skip_relu", &[[4, 32, 32, 96], [4, 32, 32, 96]]),
    piece("ELU 16 192x640", "elu", &[[1, 16, 192, 640]]),
    piece("ReLU 16 192x640", "relu", &[[1, 16, 192, 640]]),
    piece("sigmoid 16 192x640", "sigmoid", &[[1, 16, 192, 640]]),
    piece("exp 16 192x640", "exp", &[[1, 16, 192, 640]]),
    piece("reflection pad 16 192x640", "reflect_pad", &[[1, 16, 192, 640]]),
    piece("upsample + concat 64+64 48x160", "up2_concat", &[[1, 64, 24, 80], [1, 64, 48, 160]]),
    piece("bilinear resize 1 96x320 to 192x640 b4", "resize", &[[4, 1, 96, 320]]),
    piece("max pool 3x3 stride 2 64 48x160", "max_pool", &[[1, 64, 48, 160]]),
];

impl PieceCase {
    /// Whether it is a batch norm.
    pub fn is_norm(&self) -> bool {
        self.op.starts_with("batch_norm")
    }

    fn output_shape(&self) -> Shape {
        let [n, c, h, w] = self.shapes[0];
        match self.op {
            "reflect_pad" => Shape::new(n, c, h + 2, w + 2),
            "up2_concat" => Shape::new(n, c + self.shapes[1][1], 2 * h, 2 * w),
            "resize" => Shape::new(n, c, 2 * h, 2 * w),
            "max_pool" => Shape::new(n, c, h / 2, w / 2),
            _ => Shape::new(n, c, h, w),
        }
    }
}

impl Case for PieceCase {
    fn topic(&self) -> &'static str {
        "pieces"
    }

    fn name(&self) -> &str {
        self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        &["forward", "forward_backward"]
    }

    fn spec(&self) -> Value {
        json!({"name": self.name, "op": self.op, "shapes": self.shapes})
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let tensor = |(i, shape): (usize, &[usize; 4])| inputs.tensor(&format!("x{i}"), Shape(*shape));
        let mut operands = self.shapes.iter().enumerate().map(tensor).collect::<Result<Vec<_>>>()?;
        let inputs_only = operands.len();
        if self.is_norm() {
            let channels = Shape::new(1, self.shapes[0][1], 1, 1);
            operands.extend([inputs.tensor("scale", channels)?, inputs.tensor("offset", channels)?]);
        }
        if self.op == "conv_elu" {
            let c = self.shapes[0][1];
            operands.extend([inputs.tensor("weight", Shape::new(c, c, 3, 3))?, inputs.tensor("bias", Shape::new(1, c, 1, 1))?]);
        }
        Ok(Box::new(Piece {
            op: self.op,
            operands,
            inputs_only,
            gy: inputs.tensor("gy", self.output_shape())?,
            pool: Pool::new(),
        }))
    }
}

struct Piece {
    op: &'static str,
    /// Inputs, then parameters.
    operands: Vec<Tensor<f32>>,
    inputs_only: usize,
    gy: Tensor<f32>,
    pool: Arc<Pool<f32>>,
}

fn apply<'t>(op: &str, x: &[Var<'t, f32>]) -> Var<'t, f32> {
    match op {
        "batch_norm_relu" => x[0].batch_norm_train_activated(x[1], x[2], 1e-5, None, Activation::Relu).y,
        "batch_norm_elu" => x[0].batch_norm_train_activated(x[1], x[2], 1e-5, None, Activation::Elu).y,
        // Over a reflected border, as the depth decoder has it.
        "conv_elu" => {
            let options = Conv2d { pad_mode: PadMode::Reflect, ..Conv2d::new(1, 1) };
            x[0].conv2d_activated(x[1], Some(x[2]), options, Activation::Elu)
        }
        "batch_norm_skip_relu" => x[0].batch_norm_train_activated(x[2], x[3], 1e-5, Some(x[1]), Activation::Relu).y,
        "resize" => x[0].resize_bilinear(2 * x[0].shape().h(), 2 * x[0].shape().w(), false),
        "batch_norm" => x[0].batch_norm_train(x[1], x[2], 1e-5).y,
        "elu" => x[0].elu(),
        "relu" => x[0].relu(),
        "sigmoid" => x[0].sigmoid(),
        "exp" => x[0].exp(),
        "reflect_pad" => x[0].pad_reflect(1),
        "up2_concat" => Var::concat(&[x[0].upsample_nearest(2), x[1]], 1),
        "max_pool" => x[0].max_pool2d(3, 2, 1),
        _ => panic!("pieces: nothing called '{op}'"),
    }
}

impl Ours for Piece {
    fn repetition(&mut self, what: &str) -> Duration {
        let tape = Tape::with_pool(self.pool.clone());
        if what == "forward" {
            let x: Vec<_> = self.operands.iter().map(|x| tape.constant(x.clone())).collect();
            return timed(|| apply(self.op, &x));
        }
        let x: Vec<_> = self.operands.iter().map(|x| tape.leaf(x.clone())).collect();
        timed(|| tape.backward_and_free(seeded(apply(self.op, &x), &self.gy)))
    }

    fn results(&mut self) -> Results {
        let tape = Tape::new();
        let x: Vec<_> = self.operands.iter().map(|x| tape.leaf(x.clone())).collect();
        let y = apply(self.op, &x);
        let mut results = Results::default();
        results.tensors.push(("y".into(), y.value(), 1e-5));
        let gradients = tape.backward(seeded(y, &self.gy));
        for (i, x) in x[..self.inputs_only].iter().enumerate() {
            results.tensors.push((format!("grad_x{i}"), gradients.wrt(*x), 1e-4));
        }
        results
    }
}

//! Convolutions of the networks: forward, backward to the input, backward to weight and bias.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use dimode_autodiff::{Conv2d, Pool, Shape, Tape, Tensor};
use serde::Serialize;
use serde_json::{Value, json};

use crate::case::{Case, Ours, Results, input, seeded, timed};
use crate::inputs::Inputs;

/// Sizes of one convolution with square kernel, zero padding and bias.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)] // the names say it all
pub struct ConvCase {
    pub name: &'static str,
    pub batch: usize,
    pub inputs: usize,
    pub outputs: usize,
    pub height: usize,
    pub width: usize,
    pub kernel: usize,
    pub stride: usize,
    pub padding: usize,
    pub dilation: usize,
    pub groups: usize,
}

/// The shapes of ResNet-18, its decoder at 640 x 192, small networks, and two depth-wise ones.
#[rustfmt::skip]
pub const SHAPES: [ConvCase; 16] = [
    shape("3x3 64-64 48x160", [1, 64, 64, 48, 160, 3, 1, 1, 1, 1]),
    shape("7x7 stride 2 3-64 192x640", [1, 3, 64, 192, 640, 7, 2, 3, 1, 1]),
    shape("1x1 64-256 24x80", [1, 64, 256, 24, 80, 1, 1, 0, 1, 1]),
    shape("3x3 stride 2 64-128 48x160", [1, 64, 128, 48, 160, 3, 2, 1, 1, 1]),
    shape("3x3 128-128 24x80", [1, 128, 128, 24, 80, 3, 1, 1, 1, 1]),
    shape("3x3 256-256 12x40", [1, 256, 256, 12, 40, 3, 1, 1, 1, 1]),
    shape("3x3 512-512 6x20", [1, 512, 512, 6, 20, 3, 1, 1, 1, 1]),
    shape("3x3 16-16 192x640", [1, 16, 16, 192, 640, 3, 1, 1, 1, 1]),
    shape("3x3 16-1 192x640", [1, 16, 1, 192, 640, 3, 1, 1, 1, 1]),
    shape("3x3 32-16 96x320", [1, 32, 16, 96, 320, 3, 1, 1, 1, 1]),
    shape("3x3 64-64 48x160 b4", [4, 64, 64, 48, 160, 3, 1, 1, 1, 1]),
    shape("3x3 16-32 32x96 b4", [4, 16, 32, 32, 96, 3, 1, 1, 1, 1]),
    shape("3x3 stride 2 3-16 64x192 b4", [4, 3, 16, 64, 192, 3, 2, 1, 1, 1]),
    shape("3x3 8-8 64x192 b4", [4, 8, 8, 64, 192, 3, 1, 1, 1, 1]),
    shape("depthwise 3x3 64 48x160", [1, 64, 64, 48, 160, 3, 1, 1, 1, 64]),
    shape("depthwise 3x3 dilation 2 64 48x160", [1, 64, 64, 48, 160, 3, 1, 2, 2, 64]),
];

/// As many multiplications as the 128-128 of the list, but the taps lie apart: the direct kernel's own speed, since Winograd's
/// scheme needs neighbours.
pub const DIRECT: ConvCase = shape("3x3 dilation 2 128-128 24x80", [1, 128, 128, 24, 80, 3, 1, 2, 2, 1]);

/// Share of the definition's multiplications that Winograd's scheme F(2x2, 3x3) executes in its products, its transforms left
/// out: 16 for four outputs where the definition has 36.
pub const WINOGRAD_SHARE: f64 = 16.0 / 36.0;
/// That of the scheme for stride 2.
const STRIDED_SHARE: f64 = 25.0 / 36.0;

const fn shape(name: &'static str, sizes: [usize; 10]) -> ConvCase {
    let [batch, inputs, outputs, height, width, kernel, stride, padding, dilation, groups] = sizes;
    ConvCase { name, batch, inputs, outputs, height, width, kernel, stride, padding, dilation, groups }
}

impl ConvCase {
    /// Whether every channel has a kernel of its own.
    pub fn is_depthwise(&self) -> bool {
        self.groups > 1
    }

    /// Whether the input is an image, whose gradient nobody needs.
    pub fn reads_images(&self) -> bool {
        self.inputs == 3
    }

    /// Floating-point operations forward, as the definition counts them.
    pub fn flops(&self) -> f64 {
        let out = self.options().output_shape(self.input_shape(), self.weight_shape());
        2.0 * out.len() as f64 * (self.inputs / self.groups * self.kernel * self.kernel) as f64
    }

    /// Floating-point operations that the products execute forward: fewer where the shape goes by Winograd's scheme.
    pub fn executed_flops(&self) -> f64 {
        let share = match (self.goes_by_winograd(), self.stride) {
            (false, _) => 1.0,
            (true, 1) => WINOGRAD_SHARE,
            (true, _) => STRIDED_SHARE,
        };
        self.flops() * share
    }

    /// Whether the convolution goes by Winograd's scheme here.
    ///
    /// Nothing public tells, but the numbers do. A weight of one at a single tap returns inputs, and so does every sum of products,
    /// whatever its order. The scheme adds neighbours first, with stride 2 those of the same phase: beside large ones, small ones
    /// are lost.
    pub fn goes_by_winograd(&self) -> bool {
        if (self.kernel, self.padding, self.dilation, self.groups) != (3, 1, 1, 1) || self.stride > 2 {
            return false;
        }
        let one = Self { batch: 1, ..self.clone() };
        let (xs, ws) = (one.input_shape(), one.weight_shape());
        let column = |i: usize| if (i % self.width / self.stride).is_multiple_of(2) { 1e9 } else { 1.0_f32 };
        // The middle; with stride 2, where it has a phase of its own, the last one, whose inputs are those of odd rows and columns.
        let tap = 4 * self.stride;
        let x: Vec<f32> = (0..xs.len()).map(column).collect();
        let mut weight = vec![0.0; ws.len()];
        for o in 0..self.outputs {
            weight[(o * self.inputs + o % self.inputs) * 9 + tap] = 1.0;
        }
        let tape = Tape::new();
        let [x, weight] = [(xs, x), (ws, weight)].map(|(shape, data)| tape.constant(Tensor::from_vec(shape, data)));
        let (x, y) = (x.value(), x.conv2d(weight, None, one.options()).value());
        let (first, step) = (self.stride - 1, self.stride);
        let rows = x.data()[..self.height * self.width].chunks(self.width).skip(first).step_by(step);
        let wanted: Vec<f32> = rows.flat_map(|row| row.iter().skip(first).step_by(step).copied()).collect();
        y.data().chunks(wanted.len()).any(|y| y != wanted)
    }

    /// Bytes that must be read or written forward: input, weight, output.
    pub fn bytes(&self) -> f64 {
        let out = self.options().output_shape(self.input_shape(), self.weight_shape());
        4.0 * (self.input_shape().len() + self.weight_shape().len() + out.len()) as f64
    }

    fn options(&self) -> Conv2d {
        let dilation = (self.dilation, self.dilation);
        Conv2d { dilation, groups: self.groups, ..Conv2d::new(self.stride, self.padding) }
    }

    fn input_shape(&self) -> Shape {
        Shape::new(self.batch, self.inputs, self.height, self.width)
    }

    fn weight_shape(&self) -> Shape {
        Shape::new(self.outputs, self.inputs / self.groups, self.kernel, self.kernel)
    }
}

impl Case for ConvCase {
    fn topic(&self) -> &'static str {
        "conv"
    }

    fn name(&self) -> &str {
        self.name
    }

    fn whats(&self) -> &'static [&'static str] {
        if self.reads_images() { &["forward", "backward_weight"] } else { &["forward", "backward_data", "backward_weight"] }
    }

    fn spec(&self) -> Value {
        json!(self)
    }

    fn build(&self, inputs: &Inputs) -> Result<Box<dyn Ours + Send>> {
        let (xs, ws) = (self.input_shape(), self.weight_shape());
        let out = self.options().output_shape(xs, ws);
        Ok(Box::new(Conv {
            x: inputs.tensor("x", xs)?,
            weight: inputs.tensor("weight", ws)?,
            bias: inputs.tensor("bias", Shape::new(1, self.outputs, 1, 1))?,
            gy: inputs.tensor("gy", out)?,
            options: self.options(),
            pool: Pool::new(),
        }))
    }
}

struct Conv {
    x: Tensor<f32>,
    weight: Tensor<f32>,
    bias: Tensor<f32>,
    gy: Tensor<f32>,
    options: Conv2d,
    pool: Arc<Pool<f32>>,
}

impl Conv {
    /// The time of the backward pass alone, and the gradients of input, weight and bias that were wanted.
    fn backward(&self, data: bool, weight: bool) -> (Duration, [Option<Tensor<f32>>; 3]) {
        let tape = Tape::with_pool(self.pool.clone());
        let (x, w, b) = (input(&tape, &self.x, data), input(&tape, &self.weight, weight), input(&tape, &self.bias, weight));
        let loss = seeded(x.conv2d(w, Some(b), self.options), &self.gy);
        let mut gradients = None;
        let time = timed(|| gradients = Some(tape.backward_and_free(loss)));
        let gradients = gradients.expect("just computed");
        (time, [x, w, b].map(|v| gradients.get(v).cloned()))
    }
}

impl Ours for Conv {
    fn repetition(&mut self, what: &str) -> Duration {
        match what {
            "forward" => {
                let tape = Tape::with_pool(self.pool.clone());
                let [x, w, b] = [&self.x, &self.weight, &self.bias].map(|v| tape.constant(v.clone()));
                timed(|| x.conv2d(w, Some(b), self.options))
            }
            "backward_data" => self.backward(true, false).0,
            "backward_weight" => self.backward(false, true).0,
            "backward_both" => self.backward(true, true).0,
            "forward_backward" => {
                let tape = Tape::with_pool(self.pool.clone());
                let [x, w, b] = [&self.x, &self.weight, &self.bias].map(|v| tape.leaf(v.clone()));
                timed(|| tape.backward_and_free(seeded(x.conv2d(w, Some(b), self.options), &self.gy)))
            }
            _ => panic!("conv: nothing called '{what}'"),
        }
    }

    fn results(&mut self) -> Results {
        let tape = Tape::new();
        let [x, w, b] = [&self.x, &self.weight, &self.bias].map(|v| tape.constant(v.clone()));
        let y = x.conv2d(w, Some(b), self.options).value();
        let (_, gradients) = self.backward(true, true);
        let mut results = Results::default();
        results.tensors.push(("y".into(), y, 1e-5));
        for (name, gradient) in ["grad_x", "grad_weight", "grad_bias"].into_iter().zip(gradients) {
            results.tensors.push((name.into(), gradient.expect("it was wanted"), 1e-4));
        }
        results
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_neighbouring_taps_of_many_channels_go_by_winograd() {
        let of = |name: &str| SHAPES.into_iter().find(|case| case.name == name).expect("a shape of the list");
        assert!(of("3x3 128-128 24x80").goes_by_winograd());
        let strided = of("3x3 stride 2 64-128 48x160");
        assert!(strided.goes_by_winograd() && strided.executed_flops() == strided.flops() * (25.0 / 36.0));
        let direct = [of("3x3 8-8 64x192 b4"), of("3x3 16-1 192x640"), of("3x3 stride 2 3-16 64x192 b4"), DIRECT];
        assert!(direct.iter().all(|case| !case.goes_by_winograd() && case.executed_flops() == case.flops()));
        assert_eq!(DIRECT.flops(), of("3x3 128-128 24x80").flops());
    }
}

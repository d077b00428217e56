//! Convolution, bias and activation in one operation: `a(conv2d(x, w) + b)`.
//!
//! The same numbers as [`Var::conv2d`] followed by [`Var::relu`] or [`Var::elu`], without holding the map in between.
//! vjp: that of the activation from the output, then those of the convolution. Keeps what the convolution keeps, and the output.

use super::conv2d::record;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Activation, Conv2d, PadMode, Scalar, Shape, Tape, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// Convolution as [`Var::conv2d`], then the activation of every entry.
    ///
    /// # Panics
    /// As [`Var::conv2d`].
    #[track_caller]
    pub fn conv2d_activated(
        self,
        weight: Var<'t, T>,
        bias: Option<Var<'t, T>>,
        conv: Conv2d,
        activation: Activation,
    ) -> Var<'t, T> {
        record("conv2d_activated", self, weight, bias, conv, activation)
    }
}

/// A 2x3 kernel with one row of zeros above and below.
#[derive(Clone, Copy, Debug)]
struct Activated(Activation);

const CONV: Conv2d = Conv2d { stride: (1, 2), padding: (1, 0), dilation: (1, 1), groups: 1, pad_mode: PadMode::Zero };

impl Twin for Activated {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].conv2d_activated(v[1], v.get(2).copied(), CONV, self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let [samples, channels, height, width] = x[0].shape.0;
        let [outputs, _, rows, columns] = x[1].shape.0;
        Plain::from_fn(Shape::new(samples, outputs, height + 3 - rows, (width - columns) / 2 + 1), |[n, o, i, j]| {
            let mut y = x.get(2).map_or(N::zero(), |bias| bias.at([0, o, 0, 0]));
            for (c, u, v) in (0..channels).flat_map(|c| (0..rows).flat_map(move |u| (0..columns).map(move |v| (c, u, v)))) {
                if (1..=height).contains(&(i + u)) {
                    y = y + x[1].at([o, c, u, v]) * x[0].at([n, c, i + u - 1, 2 * j + v]);
                }
            }
            match self.0 {
                Activation::Elu if y.value() <= 0.0 => y.exp() - N::one(),
                Activation::Relu if y.value() <= 0.0 => N::zero(),
                _ => y,
            }
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("conv2d_activated");
    let mut cases = Vec::new();
    // Inputs are drawn again until no output is near the kink of a ReLU.
    let mut inputs = |x: Shape, outputs: usize, bias: bool| loop {
        let weight = Shape::new(outputs, x.c(), 2, 3);
        let mut inputs = vec![draw.uniform(x, -1.0, 1.0), draw.uniform(weight, -1.0, 1.0)];
        inputs.extend(bias.then(|| draw.uniform(Shape::new(1, outputs, 1, 1), -1.0, 1.0)));
        let tape = Tape::new();
        let vars: Vec<_> = inputs.iter().map(|x| tape.constant(x.clone())).collect();
        let linear = Activated(Activation::Identity).tape(&vars).value();
        if linear.data().iter().all(|y| y.abs() > 1e-5) {
            break inputs;
        }
    };
    for (k, activation) in [Activation::Identity, Activation::Relu, Activation::Elu].into_iter().enumerate() {
        let twin = Activated(activation);
        cases.push(Case::new(twin, inputs(Shape::new(2, 2, 3, 5), 2, true)));
        cases.push(Case::new(twin, inputs(Shape::new(1, 2, 3, 5), 3, false)));
        cases.push(Case::new(twin, inputs(Shape::new(2, 2, 3, 5), 2, true)).constant(k));
        cases.push(Case::new(twin, inputs(Shape::new(2, 3, 11, 31), 2, true)));
    }
    Proof::new("conv2d_activated", cases)
}

#[cfg(test)]
mod tests {
    use crate::ops::planes::testing::noise;
    use crate::ops::testing::close;
    use crate::{Activation, Conv2d, Tape};

    #[test]
    fn one_operation_equals_one_after_another() {
        for (activation, conv) in [Activation::Relu, Activation::Elu]
            .into_iter()
            .flat_map(|a| [Conv2d::new(1, 1).reflect(), Conv2d::new(2, 1)].map(|conv| (a, conv)))
        {
            let [fused, composed] = [true, false].map(|fused| {
                let tape = Tape::new();
                let leaves = [noise(1, [2, 3, 9, 17]), noise(2, [5, 3, 3, 3]), noise(3, [1, 5, 1, 1])].map(|x| tape.leaf(x));
                let [x, w, b] = leaves;
                let y = match (fused, activation) {
                    (true, _) => x.conv2d_activated(w, Some(b), conv, activation),
                    (false, Activation::Relu) => x.conv2d(w, Some(b), conv).relu(),
                    (false, _) => x.conv2d(w, Some(b), conv).elu(),
                };
                let grads = tape.backward(y.square().sum());
                [y.value(), grads.wrt(x), grads.wrt(w), grads.wrt(b)]
            });
            for (fused, composed) in fused.iter().zip(&composed) {
                close(fused.data(), composed.data());
            }
        }
    }
}

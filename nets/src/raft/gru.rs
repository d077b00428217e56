//! Convolutional gated recurrent unit, arranged so that no work is repeated over the iterations.
//!
//! The unit is defined by three convolutions over concatenations of the hidden state `h` and the
//! input `x = (c, m)`, context and motion:
//!
//! `z = sigmoid(Wz [h, x])`, `r = sigmoid(Wr [h, x])`, `q = tanh(Wq [r h, x])`,
//! `h <- (1 - z) h + z q`.
//!
//! A convolution is a sum over input channels. The weights are therefore cut into the parts that
//! meet `h`, `c` and `m`: the part of the context is the same in every iteration and is computed
//! once, and the gates that share an input are computed by one convolution.

use dimode_autodiff::{Conv2d, Scalar, Var};

use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// The recurrent unit: names and sizes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Gru {
    gates: [ConvLayer; 3],
    hidden: usize,
    context: usize,
    motion: usize,
}

/// The unit at work on one image pair.
pub(super) struct GruState<'t, T: Scalar> {
    /// What the context adds to the three gates before their activations, (N, 3 hidden, h, w).
    from_context: Var<'t, T>,
    /// Weights from the motion features to all three gates.
    from_motion: Var<'t, T>,
    /// Weights from the hidden state to `z` and `r`.
    from_hidden: Var<'t, T>,
    /// Weights from the reset hidden state to `q`.
    from_reset: Var<'t, T>,
    hidden: usize,
    options: Conv2d,
}

impl Gru {
    pub(super) fn new(path: &str, hidden: usize, context: usize, motion: usize) -> Self {
        let inputs = hidden + context + motion;
        let gate = |name| ConvLayer::new(format!("{path}.{name}"), inputs, hidden, 3);
        Self { gates: [gate("convz"), gate("convr"), gate("convq")], hidden, context, motion }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.gates.iter().for_each(|gate| gate.declare(blueprint));
    }

    /// Cuts the weights and does the part that no iteration changes.
    /// `context` is (N, context, h, w).
    pub(super) fn prepare<'t, T: Scalar>(&self, binder: &Binder<'t, T>, context: Var<'t, T>) -> GruState<'t, T> {
        let weights = self.gates.each_ref();
        let weights = weights.map(|gate| binder.param(&gate.weight_path()));
        let biases = self.gates.each_ref();
        let biases = biases.map(|gate| binder.param(&gate.bias_path()));
        let (h, c, m) = (self.hidden, self.context, self.motion);
        let part = |start, len| weights.map(|w| w.slice(1, start, len));
        let [z, r, q] = part(0, h);
        let options = self.gates[0].options();
        let to_context = Var::concat(&part(h, c), 0);
        let bias = Var::concat(&biases, 1);
        GruState {
            from_context: context.conv2d(to_context, Some(bias), options),
            from_motion: Var::concat(&part(h + c, m), 0),
            from_hidden: Var::concat(&[z, r], 0),
            from_reset: q,
            hidden: h,
            options,
        }
    }
}

impl<'t, T: Scalar> GruState<'t, T> {
    /// Hidden state (N, hidden, h, w) and motion features (N, motion, h, w) -> new hidden state.
    pub(super) fn step(&self, hidden: Var<'t, T>, motion: Var<'t, T>) -> Var<'t, T> {
        let n = self.hidden;
        let input = motion.conv2d(self.from_motion, None, self.options);
        let input = input.last_use(|input| input.add(self.from_context));
        let gates = hidden.conv2d(self.from_hidden, None, self.options);
        let gates = gates.last_use(|gates| input.slice(1, 0, 2 * n).last_use(|input| input.add(gates)));
        let gates = gates.last_use(Var::sigmoid);
        let (update, reset) = (gates.slice(1, 0, n), gates.slice(1, n, n));
        gates.release();
        let reset = reset.last_use(|reset| reset.mul(hidden));
        let candidate = reset.last_use(|reset| reset.conv2d(self.from_reset, None, self.options));
        let input = input.last_use(|input| input.slice(1, 2 * n, n));
        let candidate = candidate.last_use(|candidate| input.last_use(|input| input.add(candidate))).last_use(Var::tanh);
        let change = candidate.last_use(|candidate| candidate.sub(hidden));
        let change = change.last_use(|change| update.last_use(|update| update.mul(change)));
        change.last_use(|change| hidden.add(change))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape, Tensor};

    /// The definition at the top of the file, gate by gate.
    fn literal<'t>(gru: &Gru, binder: &Binder<'t, f64>, hidden: Var<'t, f64>, x: Var<'t, f64>) -> Var<'t, f64> {
        let hx = Var::concat(&[hidden, x], 1);
        let z = gru.gates[0].forward(binder, hx).sigmoid();
        let r = gru.gates[1].forward(binder, hx).sigmoid();
        let rhx = Var::concat(&[r.mul(hidden), x], 1);
        let q = gru.gates[2].forward(binder, rhx).tanh();
        z.neg().add_scalar(1.0).mul(hidden).add(z.mul(q))
    }

    #[test]
    fn cut_weights_give_the_literal_unit() {
        let gru = Gru::new("raft:gru", 4, 3, 5);
        let mut blueprint = Blueprint::new();
        gru.declare(&mut blueprint);
        let params = blueprint.init::<f64>(5);
        let tape = Tape::new();
        let binder = Binder::frozen(&tape, &params);
        let input = |name: &str, channels| {
            let shape = Shape::new(2, channels, 4, 5);
            let value = |i| crate::fill::unit(name, i);
            let values = (0..shape.len()).map(value).collect();
            tape.constant(Tensor::from_vec(shape, values))
        };
        let (hidden, context, motion) = (input("h", 4), input("c", 3), input("m", 5));
        let fast = gru.prepare(&binder, context).step(hidden, motion).value();
        let x = Var::concat(&[context, motion], 1);
        let slow = literal(&gru, &binder, hidden, x).value();
        for (a, b) in fast.data().iter().zip(slow.data()) {
            assert!((a - b).abs() < 1e-13, "{a} against {b}");
        }
    }
}

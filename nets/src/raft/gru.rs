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
//!
//! The small network has one such unit of 3x3 kernels. The full one has two in a row, along rows (1x5) and along columns (5x1);
//! the second takes the hidden state that the first has left.

use dimode_autodiff::{Conv2d, Scalar, Var};

use super::{FlowNetConfig, RaftVariant};
use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// Channels of the hidden state, the context and the motion features.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Widths {
    hidden: usize,
    context: usize,
    motion: usize,
}

/// The recurrent unit: its passes in order.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Gru {
    passes: Vec<Pass>,
}

/// The recurrent unit at work on one image pair.
pub(super) struct GruState<'t, T: Scalar> {
    passes: Vec<PassState<'t, T>>,
}

/// One pass: names and sizes.
#[derive(Clone, Debug, PartialEq)]
struct Pass {
    gates: [ConvLayer; 3],
    widths: Widths,
}

/// One pass at work on one image pair.
struct PassState<'t, T: Scalar> {
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
    /// Multiply-accumulates of one value of one gate.
    macs: usize,
}

impl Gru {
    pub(super) fn new(path: &str, config: &FlowNetConfig) -> Self {
        let widths = Widths { hidden: config.hidden, context: config.context, motion: config.motion + 2 };
        let pass = |suffix, kernel| Pass::new(path, suffix, widths, kernel);
        let passes = match config.variant {
            RaftVariant::Small => vec![pass("", (3, 3))],
            RaftVariant::Full(_) => vec![pass("1", (1, 5)), pass("2", (5, 1))],
        };
        Self { passes }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.passes.iter().flat_map(|pass| &pass.gates).for_each(|gate| gate.declare(blueprint));
    }

    /// Cuts the weights and does the part that no iteration changes.
    /// `context` is (N, context, h, w).
    pub(super) fn prepare<'t, T: Scalar>(&self, binder: &Binder<'t, T>, context: Var<'t, T>) -> GruState<'t, T> {
        GruState { passes: self.passes.iter().map(|pass| pass.prepare(binder, context)).collect() }
    }
}

impl Pass {
    fn new(path: &str, suffix: &str, widths: Widths, (height, width): (usize, usize)) -> Self {
        let inputs = widths.hidden + widths.context + widths.motion;
        let gate = |name| ConvLayer::new(format!("{path}.{name}{suffix}"), inputs, widths.hidden, 1).kernel(height, width);
        Self { gates: [gate("convz"), gate("convr"), gate("convq")], widths }
    }

    fn prepare<'t, T: Scalar>(&self, binder: &Binder<'t, T>, context: Var<'t, T>) -> PassState<'t, T> {
        let weights = self.gates.each_ref();
        let weights = weights.map(|gate| binder.param(&gate.weight_path()));
        let biases = self.gates.each_ref();
        let biases = biases.map(|gate| binder.param(&gate.bias_path()));
        let Widths { hidden: h, context: c, motion: m } = self.widths;
        let part = |start, len| weights.map(|w| w.slice(1, start, len));
        let [z, r, q] = part(0, h);
        let options = self.gates[0].options();
        let to_context = Var::concat(&part(h, c), 0);
        let bias = Var::concat(&biases, 1);
        PassState {
            from_context: context.conv2d(to_context, Some(bias), options),
            from_motion: Var::concat(&part(h + c, m), 0),
            from_hidden: Var::concat(&[z, r], 0),
            from_reset: q,
            hidden: h,
            options,
            macs: self.gates[0].macs_per_output(),
        }
    }
}

impl<'t, T: Scalar> GruState<'t, T> {
    /// Hidden state (N, hidden, h, w) and motion features (N, motion, h, w) -> new hidden state. Counts the multiply-accumulates
    /// of the definition, the context's part in every iteration.
    pub(super) fn step(&self, binder: &Binder<'t, T>, hidden: Var<'t, T>, motion: Var<'t, T>) -> Var<'t, T> {
        let mut state = hidden;
        for (i, pass) in self.passes.iter().enumerate() {
            let next = pass.step(state, motion);
            binder.count_macs(3 * next.shape().len() * pass.macs);
            if i > 0 {
                state.release();
            }
            state = next;
        }
        state
    }
}

impl<'t, T: Scalar> PassState<'t, T> {
    fn step(&self, hidden: Var<'t, T>, motion: Var<'t, T>) -> Var<'t, T> {
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
    fn literal<'t>(pass: &Pass, binder: &Binder<'t, f64>, hidden: Var<'t, f64>, x: Var<'t, f64>) -> Var<'t, f64> {
        let hx = Var::concat(&[hidden, x], 1);
        let z = pass.gates[0].forward(binder, hx).sigmoid();
        let r = pass.gates[1].forward(binder, hx).sigmoid();
        let rhx = Var::concat(&[r.mul(hidden), x], 1);
        let q = pass.gates[2].forward(binder, rhx).tanh();
        z.neg().add_scalar(1.0).mul(hidden).add(z.mul(q))
    }

    fn input<'t>(tape: &'t Tape<f64>, name: &str, channels: usize) -> Var<'t, f64> {
        let shape = Shape::new(2, channels, 4, 5);
        let values = (0..shape.len()).map(|i| crate::fill::unit(name, i)).collect();
        tape.constant(Tensor::from_vec(shape, values))
    }

    #[test]
    fn cut_weights_give_the_literal_unit() {
        for full in [FlowNetConfig::nano_raft(), FlowNetConfig::raft_full()] {
            let gru = Gru::new("raft:gru", &FlowNetConfig { hidden: 4, context: 3, motion: 3, ..full });
            let mut blueprint = Blueprint::new();
            gru.declare(&mut blueprint);
            let params = blueprint.init::<f64>(5);
            let tape = Tape::new();
            let binder = Binder::frozen(&tape, &params);
            let (hidden, context, motion) = (input(&tape, "h", 4), input(&tape, "c", 3), input(&tape, "m", 5));
            let fast = gru.prepare(&binder, context).step(&binder, hidden, motion).value();
            assert_eq!(binder.macs(), 2 * 4 * 5 * 3 * 4 * 12 * if gru.passes.len() == 1 { 9 } else { 10 });
            let x = Var::concat(&[context, motion], 1);
            let slow = gru.passes.iter().fold(hidden, |hidden, pass| literal(pass, &binder, hidden, x)).value();
            for (a, b) in fast.data().iter().zip(slow.data()) {
                assert!((a - b).abs() < 1e-13, "{a} against {b}");
            }
        }
    }
}

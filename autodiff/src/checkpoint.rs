//! Gradient checkpointing: a segment of a graph that keeps nothing but its inputs and is computed again in the backward pass.

use std::sync::Arc;

use crate::{Pool, Scalar, Tape, Tensor, Var};

impl<T: Scalar> Tape<T> {
    /// Computes `segment(inputs)` without keeping what it computes on the way; the backward pass computes it once more.
    ///
    /// Saves memory for time: the tape holds the segment's inputs and output, whatever its length. Values and gradients have the
    /// same bits as without checkpointing. Segments may hold segments.
    ///
    /// `segment` runs on a tape of its own, once here and once in each backward pass, so it must be a function of its arguments:
    /// everything that is differentiated must come in through `inputs` (weights, too), and what it does beside the tape (draw
    /// numbers, keep running statistics) happens each time.
    ///
    /// ```
    /// use dimode_autodiff::{Shape, Tape, Tensor};
    ///
    /// let tape = Tape::<f64>::new();
    /// let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![0.5, -1.0]));
    /// let y = tape.checkpoint(&[x], |_, v| v[0].exp().square().square());
    /// let grads = tape.backward(y.sum());
    /// assert!((grads.wrt(x).data()[0] - 4.0 * 2.0_f64.exp()).abs() < 1e-12);
    /// ```
    ///
    /// # Panics
    /// When an input belongs to another tape, or the segment returns a variable of another tape than the one that it was given.
    #[track_caller]
    pub fn checkpoint<'t>(
        &'t self,
        inputs: &[Var<'t, T>],
        segment: impl for<'s> Fn(&'s Tape<T>, &[Var<'s, T>]) -> Var<'s, T> + Send + 'static,
    ) -> Var<'t, T> {
        // A variable that comes twice is one leaf, so that its gradient is summed in the order of the uses.
        let (parents, places) = distinct(inputs);
        let values: Vec<Tensor<T>> = parents.iter().map(|v| v.value()).collect();
        let wanted: Vec<bool> = parents.iter().map(|v| v.requires_grad()).collect();
        let strict = self.refuses_non_finite();
        let output = {
            let inner = inner(self.pool().clone(), strict);
            let leaves: Vec<_> = values.iter().map(|value| inner.constant(value.clone())).collect();
            let arguments: Vec<_> = places.iter().map(|&k| leaves[k]).collect();
            run(&segment, &inner, &arguments).value()
        };
        self.push("checkpoint", output, &parents, move |g, grads| {
            let inner = inner(grads.pool().clone(), strict);
            let variable = |(value, &wanted): (&Tensor<T>, &bool)| match wanted {
                true => inner.leaf(value.clone()),
                false => inner.constant(value.clone()),
            };
            let leaves: Vec<_> = values.iter().zip(&wanted).map(variable).collect();
            let arguments: Vec<_> = places.iter().map(|&k| leaves[k]).collect();
            let output = run(&segment, &inner, &arguments);
            // The leaves begin with the gradient so far: every sum is taken in the order that it has without checkpointing.
            let so_far = leaves.iter().enumerate().filter_map(|(k, &leaf)| Some((leaf, grads.take(k)?))).collect();
            let mut found = inner.pull_back(output, g, so_far);
            for (k, &leaf) in leaves.iter().enumerate() {
                grads.put(k, found.take(leaf));
            }
        })
    }
}

/// The tape of a segment.
fn inner<T: Scalar>(pool: Arc<Pool<T>>, strict: bool) -> Tape<T> {
    let tape = Tape::with_pool(pool);
    if strict { tape.refusing_non_finite() } else { tape }
}

/// Runs a segment on its tape.
#[track_caller]
fn run<'s, T: Scalar>(
    segment: &impl Fn(&'s Tape<T>, &[Var<'s, T>]) -> Var<'s, T>,
    tape: &'s Tape<T>,
    arguments: &[Var<'s, T>],
) -> Var<'s, T> {
    let output = segment(tape, arguments);
    assert!(std::ptr::eq(output.tape(), tape), "checkpoint: the segment returned a variable of another tape");
    output
}

/// The different variables, and where among them each one is.
fn distinct<'t, T: Scalar>(all: &[Var<'t, T>]) -> (Vec<Var<'t, T>>, Vec<usize>) {
    let mut found: Vec<Var<'t, T>> = Vec::new();
    let places = all.iter().map(|var| {
        found.iter().position(|other| other.is(*var)).unwrap_or_else(|| {
            found.push(*var);
            found.len() - 1
        })
    });
    let places = places.collect();
    (found, places)
}

#[cfg(test)]
mod tests {
    use crate::gradcheck::{random, weighted_sum};
    use crate::ops::conv2d::Conv2d;
    use crate::{Shape, Tape, Tensor, Var};

    type Inputs<'t> = [Var<'t, f32>; 3];

    /// A residual block whose input and weight are used several times.
    fn block<'s>(_: &'s Tape<f32>, v: &[Var<'s, f32>]) -> Var<'s, f32> {
        let [x, weight, scale] = [v[0], v[1], v[2]];
        let conv = |x: Var<'s, f32>| x.conv2d(weight, None, Conv2d { padding: (1, 1), ..Conv2d::default() });
        let y = conv(conv(x).batch_norm_train(scale, scale, 1e-5).y.elu());
        y.add(x).mul(x.sigmoid())
    }

    /// Bits of the loss and of all gradients; the inputs are used before, in and after the segment.
    fn bits(block: impl for<'t> Fn(&'t Tape<f32>, Inputs<'t>) -> Var<'t, f32>) -> Vec<u32> {
        let tape = Tape::new();
        let shapes = [Shape::new(2, 4, 9, 11), Shape::new(4, 4, 3, 3), Shape::new(1, 4, 1, 1)];
        let mut seed = 0;
        let inputs = shapes.map(|shape| {
            seed += 1;
            tape.leaf(random(seed, shape, 0.1, 1.0))
        });
        let x = inputs[0].add(inputs[0].square());
        let first = block(&tape, [x, inputs[1], inputs[2]]);
        let second = block(&tape, [first.add(x), inputs[1], inputs[2].exp()]);
        let loss = weighted_sum(second.mul(x).add(first), 7).add(inputs[1].square().sum());
        let grads = tape.backward(loss);
        let all = inputs.iter().map(|&v| grads.wrt(v));
        std::iter::once(loss.value()).chain(all).flat_map(|t| t.to_vec()).map(f32::to_bits).collect()
    }

    #[test]
    fn values_and_gradients_have_the_same_bits() {
        let plain = bits(|tape, v| block(tape, &v));
        assert_eq!(bits(|tape, v| tape.checkpoint(&v, block)), plain);
        assert_eq!(bits(|tape, v| tape.checkpoint(&v, |inner, v| inner.checkpoint(v, block))), plain);
    }

    #[test]
    fn a_variable_that_comes_twice_and_a_constant_are_right() {
        let tape = Tape::<f64>::new();
        let (x, c) = (tape.leaf(Tensor::scalar(3.0)), tape.constant(Tensor::scalar(5.0)));
        let y = tape.checkpoint(&[x, c, x], |_, v| v[0].square().mul(v[1]).add(v[2]));
        let grads = tape.backward(y);
        assert_eq!((y.value().item(), grads.wrt(x).item()), (48.0, 31.0));
        assert!(grads.get(c).is_none());
        // The segment may return one of its inputs.
        let same = tape.checkpoint(&[x], |_, v| v[0]);
        assert_eq!(tape.backward(same.mul(x)).wrt(x).item(), 6.0);
    }

    #[test]
    fn what_is_computed_on_the_way_is_not_kept() {
        fn chain(x: Var<'_, f32>) -> Var<'_, f32> {
            (0..10).fold(x, |x, _| x.sin())
        }
        let fresh = |checkpointed: bool| {
            let tape = Tape::new();
            let x = tape.leaf(random::<f32>(1, Shape::new(1, 1, 32, 32), -1.0, 1.0));
            let y = if checkpointed { tape.checkpoint(&[x], |_, v| chain(v[0])) } else { chain(x) };
            assert_eq!(y.shape(), x.shape());
            (tape.len(), tape.pool().elements())
        };
        assert_eq!(fresh(false), (11, 0));
        assert_eq!(fresh(true), (2, 9 * 1024), "nine of ten values are back in the pool");
    }

    #[test]
    #[should_panic(expected = "sqrt [1, 1, 1, 1]: entry [0, 0, 0, 0] of the output is NaN")]
    fn a_segment_of_a_watched_tape_is_watched() {
        let tape = Tape::<f64>::new().refusing_non_finite();
        tape.checkpoint(&[tape.leaf(Tensor::scalar(-1.0))], |_, v| v[0].sqrt());
    }

    #[test]
    #[should_panic(expected = "checkpoint: an operand belongs to another tape")]
    fn an_input_of_another_tape_is_refused() {
        let (tape, other) = (Tape::<f64>::new(), Tape::new());
        let x = other.leaf(Tensor::scalar(1.0));
        // The lifetimes agree, the tapes do not.
        tape.checkpoint(&[x], |_, v| v[0].exp());
    }
}

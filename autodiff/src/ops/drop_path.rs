//! `y[n] = x[n] b[n] / (1 - p)`: whole samples are dropped (`b = 0`) or kept (`b = 1`) and scaled so that the mean stays.
//! Vector-Jacobian product: `g[n] b[n] / (1 - p)`. Linear. Keeps: one factor for each sample.
//!
//! The mask is an argument. [`keep_mask`] draws one from a seed and a step, so that a resumed run drops what it would have dropped.
//! The factor is multiplied: NaN in a dropped sample is not hidden.

use super::kernel;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Shape, Tensor, Var, rng};

/// Samples to keep, shape `[samples, 1, 1, 1]`: each is 0 with probability `rate`, else 1.
///
/// Depends on the arguments alone; `seed` tells the layers of a network apart, `step` the steps of a run.
///
/// **Panics** unless `rate` is from 0 to below 1.
#[track_caller]
pub fn keep_mask<T: Scalar>(samples: usize, rate: f64, seed: u64, step: u64) -> Tensor<T> {
    assert_rate("keep_mask", rate);
    let stream = rng::splitmix64(seed, step);
    let keep = |n| if rng::unit(stream, n as u64) < rate { T::ZERO } else { T::ONE };
    Tensor::from_vec(Shape::new(samples, 1, 1, 1), (0..samples).map(keep).collect())
}

#[track_caller]
fn assert_rate(op: &str, rate: f64) {
    assert!((0.0..1.0).contains(&rate), "{op}: rate {rate}; the rule: from 0 to below 1");
}

/// Writes `x` times the factor of each sample of `size` elements; serves both directions.
fn scale_samples<T: Scalar>(x: &[T], factors: &[T], y: &mut [T], size: usize) {
    for ((y, x), &factor) in y.chunks_exact_mut(size).zip(x.chunks_exact(size)).zip(factors) {
        kernel::map(y, x, |x| x * factor);
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Drops the samples where `keep` is 0 and divides the others by `1 - rate`.
    ///
    /// **Shapes**: any `[n, c, h, w]` to the same; `keep` has shape `[n, 1, 1, 1]` and holds 0 or 1, see [`keep_mask`].
    ///
    /// **Gradient**: `g / (1 - rate)` to the kept samples, 0 to the dropped ones; none to the mask.
    ///
    /// **Panics** when the mask has another shape or another number than 0 and 1, or unless `rate` is from 0 to below 1.
    #[track_caller]
    pub fn drop_path(self, keep: &Tensor<T>, rate: f64) -> Var<'t, T> {
        let shape = self.shape();
        let wanted = Shape::new(shape.n(), 1, 1, 1);
        assert!(keep.shape() == wanted, "drop_path: input {shape} needs a mask of shape {wanted}, got {}", keep.shape());
        assert_rate("drop_path", rate);
        if let Some(n) = keep.data().iter().position(|&b| b != T::ZERO && b != T::ONE) {
            panic!("drop_path: entry {n} of the mask is {}; the rule: 0 or 1", keep.data()[n]);
        }
        let size = (shape.c() * shape.plane()).max(1);
        let factors: Vec<T> = keep.data().iter().map(|b| T::from_f64(b.to_f64() / (1.0 - rate))).collect();
        let mut y = self.tape().scratch(shape.len());
        scale_samples(self.value().data(), &factors, &mut y, size);
        let y = self.tape().tensor(shape, y);
        self.tape().push("drop_path", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| scale_samples(g.data(), &factors, out, size));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct DropPath {
    rate: f64,
}

impl Twin for DropPath {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].drop_path(&v[1].value(), self.rate)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let kept = |n| x[1].at([n, 0, 0, 0]).value() != 0.0;
        let chosen = |i: [usize; 4]| if kept(i[0]) { x[0].at(i) / N::constant(1.0 - self.rate) } else { N::zero() };
        Plain::from_fn(x[0].shape, chosen)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("drop_path");
    let mut cases = Vec::new();
    for shape in shapes(&mut draw) {
        for rate in [0.0, 0.25] {
            let mask = Tensor::from_fn(Shape::new(shape.n(), 1, 1, 1), |n, _, _, _| if n == 1 { 0.0 } else { 1.0 });
            cases.push(Case::new(DropPath { rate }, [draw.uniform(shape, -2.0, 2.0), mask]).constant(1));
        }
    }
    Proof::new("drop_path", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::keep_mask;
    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    fn samples(keep: &[f64]) -> Tensor<f64> {
        Tensor::from_vec(Shape::new(keep.len(), 1, 1, 1), keep.to_vec())
    }

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(3, 1, 1, 2), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let y = x.drop_path(&samples(&[1.0, 0.0, 1.0]), 0.2);
        close(y.value().data(), &[1.25, 2.5, 0.0, 0.0, 6.25, 7.5]);
        close(tape.backward(y.sum()).wrt(x).data(), &[1.25, 1.25, 0.0, 0.0, 1.25, 1.25]);
    }

    #[test]
    fn rate_zero_changes_nothing() {
        let tape = Tape::<f64>::new();
        let x = tape.constant(random(1, Shape::new(4, 2, 1, 3), -1.0, 1.0));
        assert_eq!(x.drop_path(&keep_mask(4, 0.0, 7, 0), 0.0).value(), x.value());
    }

    #[test]
    fn nan_is_not_hidden_in_a_dropped_sample() {
        let tape = Tape::new();
        assert!(tape.constant(samples(&[f64::NAN])).drop_path(&samples(&[0.0]), 0.5).value().item().is_nan());
    }

    #[test]
    fn masks_have_the_rate_and_depend_on_seed_and_step() {
        let mask = |seed, step| keep_mask::<f64>(10_000, 0.2, seed, step);
        assert_eq!(mask(3, 5), mask(3, 5));
        for (seed, step) in [(3, 5), (3, 6), (4, 5)] {
            let kept: f64 = mask(seed, step).data().iter().sum();
            assert!((7800.0..8200.0).contains(&kept), "{kept} of 10000 kept");
        }
        // Independent masks agree in 0.8² + 0.2² = 68 % of the samples.
        for other in [mask(3, 6), mask(4, 5), mask(4, 4)] {
            let equal = mask(3, 5).data().iter().zip(other.data()).filter(|(a, b)| a == b).count();
            assert!((6600..7000).contains(&equal), "{equal} of 10000 equal");
        }
    }

    #[test]
    fn a_shorter_batch_has_the_same_first_samples() {
        assert_eq!(keep_mask::<f32>(5, 0.5, 1, 2).data(), &keep_mask::<f32>(9, 0.5, 1, 2).data()[..5]);
    }

    #[test]
    #[should_panic(expected = "drop_path: input [2, 3, 1, 1] needs a mask of shape [2, 1, 1, 1], got [3, 1, 1, 1]")]
    fn mask_of_another_shape_is_refused() {
        Tape::new().constant(Tensor::zeros(Shape::new(2, 3, 1, 1))).drop_path(&samples(&[1.0; 3]), 0.5);
    }

    #[test]
    #[should_panic(expected = "drop_path: entry 1 of the mask is 0.5; the rule: 0 or 1")]
    fn mask_with_another_number_is_refused() {
        Tape::new().constant(samples(&[1.0, 1.0])).drop_path(&samples(&[1.0, 0.5]), 0.5);
    }

    #[test]
    #[should_panic(expected = "keep_mask: rate 1; the rule: from 0 to below 1")]
    fn rate_one_is_refused() {
        keep_mask::<f64>(1, 1.0, 0, 0);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), rate in 0.0..0.9, seed in any::<u64>()) {
            let mut keep = keep_mask(shape.n(), rate, seed, 1).to_vec();
            keep[0] = 1.0;
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].drop_path(&samples(&keep), rate));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), rate in 0.0..0.9, seed in any::<u64>()) {
            let keep = keep_mask(shape.n(), rate, seed, 1);
            testing::check_adjoint(shape, seed, |x| x.drop_path(&keep, rate));
        }
    }
}

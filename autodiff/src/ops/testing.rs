//! Helpers of the unit tests of the operations: known values, slopes, finite differences, the adjoint law.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

pub(crate) use crate::gradcheck::random;
use crate::gradcheck::weighted_sum;
use crate::{GradCheck, Shape, Tape, Tensor, Var, gradcheck};

/// Few cases with a fixed seed: the same shapes and values in every run.
pub(crate) fn cases() -> ProptestConfig {
    ProptestConfig { cases: 24, rng_seed: RngSeed::Fixed(20), failure_persistence: None, ..ProptestConfig::default() }
}

/// Small shapes: odd, non-square, with axes of size one.
pub(crate) fn shapes() -> impl Strategy<Value = Shape> {
    (1..=3usize, 1..=3usize, 1..=4usize, 1..=5usize).prop_map(|(n, c, h, w)| Shape::new(n, c, h, w))
}

/// A row vector (1, 1, 1, len).
pub(crate) fn row(values: &[f64]) -> Tensor<f64> {
    Tensor::from_vec(Shape::new(1, 1, 1, values.len()), values.to_vec())
}

/// Random values in `lo..hi`, moved out of the band of half width 0.05 around each kink.
pub(crate) fn random_away(seed: u64, shape: Shape, lo: f64, hi: f64, kinks: &[f64]) -> Tensor<f64> {
    let away = |x: f64| kinks.iter().fold(x, |x, &kink| if (x - kink).abs() < 0.05 { kink + 0.1 } else { x });
    let values = random::<f64>(seed, shape, lo, hi).to_vec().into_iter().map(away).collect();
    Tensor::from_vec(shape, values)
}

/// Random values between about -1 and 1, any two of them at least 1 / count apart, in random order.
pub(crate) fn distinct(seed: u64, shape: Shape) -> Tensor<f64> {
    let (keys, count) = (random::<f64>(seed, shape, 0.0, 1.0), shape.len() as f64);
    let rank = |key: &f64| keys.data().iter().filter(|other| *other < key).count() as f64;
    let value = |key: &f64| (2.0 * rank(key) + key) / count - 1.0;
    Tensor::from_vec(shape, keys.data().iter().map(value).collect())
}

/// The values of a one-operand operation on a row vector.
pub(crate) fn values(x: &[f64], op: impl for<'t> Fn(Var<'t, f64>) -> Var<'t, f64>) -> Vec<f64> {
    let tape = Tape::new();
    op(tape.leaf(row(x))).value().to_vec()
}

/// The derivative of an elementwise operation at each entry of a row vector.
pub(crate) fn slopes(x: &[f64], op: impl for<'t> Fn(Var<'t, f64>) -> Var<'t, f64>) -> Vec<f64> {
    let tape = Tape::new();
    let x = tape.leaf(row(x));
    let loss = op(x).sum();
    tape.backward(loss).wrt(x).to_vec()
}

/// The values of a two-operand operation on row vectors.
pub(crate) fn values2(a: &[f64], b: &[f64], op: impl for<'t> Fn(Var<'t, f64>, Var<'t, f64>) -> Var<'t, f64>) -> Vec<f64> {
    let tape = Tape::new();
    op(tape.leaf(row(a)), tape.leaf(row(b))).value().to_vec()
}

/// Both partial derivatives of an elementwise two-operand operation.
pub(crate) fn slopes2(
    a: &[f64],
    b: &[f64],
    op: impl for<'t> Fn(Var<'t, f64>, Var<'t, f64>) -> Var<'t, f64>,
) -> (Vec<f64>, Vec<f64>) {
    let tape = Tape::new();
    let (a, b) = (tape.leaf(row(a)), tape.leaf(row(b)));
    let grads = tape.backward(op(a, b).sum());
    (grads.wrt(a).to_vec(), grads.wrt(b).to_vec())
}

/// Panics unless the slices agree to 1e-12 (relative above one); infinities must be equal.
#[track_caller]
pub(crate) fn close(got: &[f64], want: &[f64]) {
    assert_eq!(got.len(), want.len(), "lengths differ: {got:?} against {want:?}");
    for (i, (&a, &b)) in got.iter().zip(want).enumerate() {
        let fine = a == b || (a - b).abs() <= 1e-12 * b.abs().max(1.0);
        assert!(fine, "entry {i}: {a} against {b}; all: {got:?} against {want:?}");
    }
}

/// Compares the gradient of the weighted sum of `op` with central differences.
#[track_caller]
pub(crate) fn check(inputs: &[Tensor<f64>], op: impl for<'t> Fn(&[Var<'t, f64>]) -> Var<'t, f64>) {
    gradcheck(inputs, |_, vars| weighted_sum(op(vars), 7), GradCheck::default()).assert_ok();
}

/// The adjoint law of a linear operation: `<J v, w> = <v, J' w>` for random `v` and `w`.
#[track_caller]
pub(crate) fn check_adjoint(shape: Shape, seed: u64, op: impl for<'t> Fn(Var<'t, f64>) -> Var<'t, f64>) {
    let tape = Tape::new();
    let v = tape.leaf(random(seed, shape, -1.0, 1.0));
    let y = op(v);
    let w = random(seed ^ 0xad, y.shape(), -1.0, 1.0);
    let forward = dot(&y.value(), &w);
    let grads = tape.backward(y.mul(tape.constant(w)).sum());
    let backward = dot(&v.value(), &grads.wrt(v));
    let tolerance = 1e-12 * shape.len().max(y.shape().len()) as f64;
    assert!((forward - backward).abs() <= tolerance, "<Jv,w> = {forward}, <v,J'w> = {backward}");
}

fn dot(a: &Tensor<f64>, b: &Tensor<f64>) -> f64 {
    a.data().iter().zip(b.data()).map(|(&a, &b)| a * b).sum()
}

//! A loss as a function of leaves in either precision, and the laws that it is held to.

use std::fmt::Debug;

use dimode_autodiff::{GradCheck, Scalar, Tape, Tensor, Var, gradcheck};
use dimode_geometry::Intrinsics;

/// What a loss is evaluated at.
#[derive(Clone, Debug)]
pub struct Scene {
    /// What is differentiated, samples along the first axis.
    pub leaves: Vec<Tensor<f64>>,
    /// Masks, images and whatever else is data, samples along the first axis.
    pub data: Vec<Tensor<f64>>,
    /// One camera a sample.
    pub cameras: Vec<Intrinsics>,
}

impl Scene {
    /// Data `k` in the precision at hand.
    pub fn data<T: Scalar>(&self, k: usize) -> Tensor<T> {
        self.data[k].cast()
    }

    /// The samples in opposite order.
    pub fn reversed(&self) -> Self {
        let all = |x: &[Tensor<f64>]| x.iter().map(reversed).collect();
        Self { leaves: all(&self.leaves), data: all(&self.data), cameras: self.cameras.iter().rev().cloned().collect() }
    }

    /// Some leaves multiplied by a number.
    pub fn scaled(&self, which: &[usize], factor: f64) -> Self {
        let mut scene = self.clone();
        for &k in which {
            scene.leaves[k] = map(&self.leaves[k], |x| factor * x);
        }
        scene
    }

    /// Other data `k`.
    pub fn with_data(mut self, k: usize, data: Tensor<f64>) -> Self {
        self.data[k] = data;
        self
    }

    /// Leaf `k` replaced by what `f(old, n, c, h, w)` says.
    pub fn with_leaf(mut self, k: usize, f: impl Fn(f64, usize, usize, usize, usize) -> f64) -> Self {
        let old = self.leaves[k].clone();
        self.leaves[k] = Tensor::from_fn(old.shape(), |n, c, h, w| f(old.at(n, c, h, w), n, c, h, w));
        self
    }
}

/// A loss, or one form of it.
pub trait Loss: Debug {
    /// One number.
    fn of<'t, T: Scalar>(&self, v: &[Var<'t, T>], scene: &Scene) -> Var<'t, T>;
}

/// A function of every entry.
pub fn map(x: &Tensor<f64>, f: impl Fn(f64) -> f64) -> Tensor<f64> {
    Tensor::from_vec(x.shape(), x.data().iter().map(|&x| f(x)).collect())
}

/// The samples in opposite order.
pub fn reversed<T: Scalar>(x: &Tensor<T>) -> Tensor<T> {
    let last = x.shape().n() - 1;
    Tensor::from_fn(x.shape(), |n, c, h, w| x.at(last - n, c, h, w))
}

/// Value and gradients.
pub fn gradients<T: Scalar>(loss: &impl Loss, scene: &Scene) -> (f64, Vec<Tensor<T>>) {
    let tape = Tape::<T>::new();
    let v: Vec<_> = scene.leaves.iter().map(|x| tape.leaf(x.cast())).collect();
    let value = loss.of(&v, scene);
    let grads = tape.backward(value);
    (value.value().item().to_f64(), v.iter().map(|&v| grads.wrt(v)).collect())
}

/// The value alone.
pub fn value(loss: &impl Loss, scene: &Scene) -> f64 {
    let tape = Tape::<f64>::new();
    let v: Vec<_> = scene.leaves.iter().map(|x| tape.constant(x.clone())).collect();
    loss.of(&v, scene).value().item()
}

/// The gradient is that of differences.
#[track_caller]
pub fn assert_gradient(loss: &impl Loss, scene: &Scene, check: GradCheck) {
    let report = gradcheck(&scene.leaves, |_, v| loss.of(v, scene), check);
    assert!(report.is_ok(), "{loss:?}\n{report}");
}

/// Value and gradients are finite in both precisions.
#[track_caller]
pub fn assert_finite(loss: &impl Loss, scene: &Scene) {
    finite_in::<f64>(loss, scene);
    finite_in::<f32>(loss, scene);
}

#[track_caller]
fn finite_in<T: Scalar>(loss: &impl Loss, scene: &Scene) {
    let (value, grads) = gradients::<T>(loss, scene);
    let name = std::any::type_name::<T>();
    assert!(value.is_finite(), "{loss:?} in {name}: {value}");
    for (k, grad) in grads.iter().enumerate() {
        let bad = grad.data().iter().position(|g| !g.is_finite());
        assert!(bad.is_none(), "{loss:?} in {name}: leaf {k}, entry {:?}", bad.map(|i| grad.shape().unravel(i)));
    }
}

/// Value and gradients are exactly 0 in both precisions.
#[track_caller]
pub fn assert_nothing(loss: &impl Loss, scene: &Scene) {
    let (value, wide) = gradients::<f64>(loss, scene);
    let (single, narrow) = gradients::<f32>(loss, scene);
    assert_eq!((value, single), (0.0, 0.0), "{loss:?}");
    let quiet =
        wide.iter().all(|g| g.data().iter().all(|&g| g == 0.0)) && narrow.iter().all(|g| g.data().iter().all(|&g| g == 0.0));
    assert!(quiet, "{loss:?}: a gradient without a value");
}

/// Where `used[k]` (one channel) is 0, leaf `k` has exactly no gradient in either precision; elsewhere there is some in every
/// leaf, and all of it is finite. The value does not change with what stands in the unused places.
#[track_caller]
pub fn assert_silent(loss: &impl Loss, scene: &Scene, used: &[Option<Tensor<f64>>]) {
    assert_eq!(used.len(), scene.leaves.len(), "one mask a leaf");
    silent_in::<f64>(loss, scene, used);
    silent_in::<f32>(loss, scene, used);
}

#[track_caller]
fn silent_in<T: Scalar>(loss: &impl Loss, scene: &Scene, used: &[Option<Tensor<f64>>]) {
    let name = std::any::type_name::<T>();
    let mut spoilt = scene.clone();
    for (leaf, used) in spoilt.leaves.iter_mut().zip(used) {
        if let Some(used) = used {
            let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, 1e30];
            *leaf = Tensor::from_fn(leaf.shape(), |n, c, h, w| match used.at(n, 0, h, w) {
                0.0 => bad[(n + 2 * c + 3 * h + w) % bad.len()],
                _ => leaf.at(n, c, h, w),
            });
        }
    }
    let (clean, before) = gradients::<T>(loss, scene);
    let (value, grads) = gradients::<T>(loss, &spoilt);
    assert_eq!(value, clean, "{loss:?} in {name}: unused places change the value");
    for (k, (grad, before)) in grads.iter().zip(&before).enumerate() {
        assert!(before.data().iter().any(|g| g.to_f64() != 0.0), "{loss:?} in {name}: leaf {k} has no gradient at all");
        let differing = grad.data().iter().zip(before.data()).position(|(a, b)| a != b);
        assert!(
            differing.is_none(),
            "{loss:?} in {name}: leaf {k}, entry {:?}: unused places change gradients",
            differing.map(|i| grad.shape().unravel(i))
        );
        let Some(used) = &used[k] else { continue };
        let s = grad.shape();
        for i in 0..s.len() {
            let [n, c, h, w] = s.unravel(i);
            let g = grad.at(n, c, h, w).to_f64();
            assert!(
                used.at(n, 0, h, w) != 0.0 || g == 0.0,
                "{loss:?} in {name}: leaf {k} at {:?} is not used but has {g}",
                [n, c, h, w]
            );
        }
    }
}

/// The order of the batch does not matter: values agree to rounding, gradients change places to the bit.
#[track_caller]
pub fn assert_order_free(loss: &impl Loss, scene: &Scene) {
    assert_order_free_to(0.0, loss, scene);
}

/// As [`assert_order_free`] where a mean over the whole batch divides, whose sum is rounded in the order of the samples: gradients
/// may differ by `rounding`, relative.
#[track_caller]
pub fn assert_order_free_to(rounding: f64, loss: &impl Loss, scene: &Scene) {
    let (one, grads) = gradients::<f64>(loss, scene);
    let (other, turned) = gradients::<f64>(loss, &scene.reversed());
    assert!((one - other).abs() <= 1e-12 * (1.0 + one.abs()), "{loss:?}: {one} {other}");
    for (k, (a, b)) in grads.iter().zip(&turned).enumerate() {
        let turned = reversed(b);
        let same = |(a, b): (&f64, &f64)| (a - b).abs() <= rounding * a.abs();
        assert!(a.data().iter().zip(turned.data()).all(same), "{loss:?}: gradients of leaf {k} depend on the order");
    }
}

/// Both scenes cost the same, and something.
#[track_caller]
pub fn assert_same_value(loss: &impl Loss, one: &Scene, other: &Scene, tolerance: f64) {
    let (one, other) = (value(loss, one), value(loss, other));
    assert!((one - other).abs() <= tolerance * (1.0 + one.abs()), "{loss:?}: {one} {other}");
    assert!(one.abs() > 1e3 * tolerance, "{loss:?}: {one} shows nothing");
}

//! Edge-aware smoothness of the mean-normalised disparity.
//!
//! `d* = d / (mean_hw d + 1e-7)`, `L = mean(|d*_x| exp(-mean_c |I_x|)) + mean(|d*_y| exp(-mean_c |I_y|))`, forward differences.
//! The mean is not detached. Subgradient of the absolute value at 0 is 0.
//!
//! The SC-Depth programs apply the same to depth instead of disparity: [`smoothness`] of a depth map.

use dimode_autodiff::{Scalar, Tensor, Var};

/// Smoothness of disparities `[n, 1, h, w]` under images `[n, c, h, w]`; one number.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn smoothness<'t, T: Scalar>(disparity: Var<'t, T>, images: &Tensor<T>) -> Var<'t, T> {
    edge_aware(mean_normalised(disparity), images, 1.0)
}

/// First-order smoothness of a map `[n, k, h, w]`, each difference weighted by `exp(-edge mean_c |image difference|)`.
#[track_caller]
pub fn edge_aware<'t, T: Scalar>(map: Var<'t, T>, images: &Tensor<T>, edge: f64) -> Var<'t, T> {
    let (s, i) = (map.shape(), images.shape());
    assert!(
        s.n() == i.n() && s.h() == i.h() && s.w() == i.w() && s.h() > 1 && s.w() > 1,
        "smoothness: map {s} and images {i} must have equal sizes of at least 2 x 2"
    );
    let terms = [2, 3].map(|axis| {
        let weight = map.tape().constant(edge_weights(images, axis, [0, 1], edge));
        weighted(steps(map, axis).abs(), weight)
    });
    terms[0].add(terms[1])
}

/// As [`edge_aware`] with gradients to the images too, for images that are themselves computed, as rectified ones are.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn edge_aware_of_both<'t, T: Scalar>(map: Var<'t, T>, images: Var<'t, T>, edge: f64) -> Var<'t, T> {
    let terms = [2, 3].map(|axis| {
        let weight = steps(images, axis).abs().mean_channels().scale(-edge).exp();
        weighted(steps(map, axis).abs(), weight)
    });
    terms[0].add(terms[1])
}

/// `d / (mean_hw d + 1e-7)` of maps `[n, 1, h, w]`; the mean is not detached.
pub fn mean_normalised<'t, T: Scalar>(map: Var<'t, T>) -> Var<'t, T> {
    let mean = map.mean_hw().add_scalar(1e-7);
    map.div(mean.broadcast_to(map.shape()))
}

/// `x(i + 1) - x(i)` along rows (2) or columns (3).
pub fn steps<T: Scalar>(x: Var<'_, T>, axis: usize) -> Var<'_, T> {
    let len = x.shape().0[axis] - 1;
    x.slice(axis, 1, len).sub(x.slice(axis, 0, len))
}

/// Mean of penalties times one weight for all channels.
pub fn weighted<'t, T: Scalar>(penalty: Var<'t, T>, weight: Var<'t, T>) -> Var<'t, T> {
    penalty.mul(weight.broadcast_to(penalty.shape())).mean()
}

/// `exp(-edge mean_c |I(i + to) - I(i + from)|)` along rows (2) or columns (3), one channel, `to` entries fewer.
pub fn edge_weights<T: Scalar>(images: &Tensor<T>, axis: usize, [from, to]: [usize; 2], edge: f64) -> Tensor<T> {
    let mut shape = images.shape().with_c(1);
    shape.0[axis] -= to;
    let channels = images.shape().c();
    let scale = T::from_f64(-edge / channels as f64);
    Tensor::from_fn(shape, |n, _, h, w| {
        let at = |c: usize, by: usize| if axis == 2 { images.at(n, c, h + by, w) } else { images.at(n, c, h, w + by) };
        let sum = (0..channels).map(|c| (at(c, to) - at(c, from)).abs()).fold(T::ZERO, |a, b| a + b);
        (scale * sum).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    #[test]
    fn a_ramp_on_a_flat_image_has_its_slope() {
        let tape = Tape::<f64>::new();
        let d = tape.constant(Tensor::from_fn(Shape::new(1, 1, 3, 4), |_, _, _, w| 1.0 + w as f64));
        let l = smoothness(d, &Tensor::full(Shape::new(1, 3, 3, 4), 0.3)).value().item();
        assert!((l - 1.0 / 2.5).abs() < 1e-7, "{l}");
    }

    #[test]
    fn an_edge_of_the_image_excuses_a_step() {
        let tape = Tape::<f64>::new();
        let step = Tensor::from_fn(Shape::new(1, 1, 2, 4), |_, _, _, w| if w < 2 { 1.0 } else { 2.0 });
        let d = tape.constant(step.clone());
        let flat = smoothness(d, &Tensor::full(Shape::new(1, 1, 2, 4), 0.0)).value().item();
        assert!(smoothness(d, &step).value().item() < 0.5 * flat);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let d = random(1, Shape::new(2, 1, 4, 5), 0.1, 0.9);
        let image = random::<f64>(2, Shape::new(2, 3, 4, 5), 0.0, 1.0);
        gradcheck(&[d], |_, v| smoothness(v[0], &image), GradCheck { step: 1e-6, ..GradCheck::default() }).assert_ok();
    }

    #[test]
    fn scale_does_not_matter_and_images_may_carry_gradients() {
        let d = random::<f64>(1, Shape::new(2, 1, 4, 5), 0.1, 0.9);
        let image = random::<f64>(2, Shape::new(2, 3, 4, 5), 0.0, 1.0);
        let tape = Tape::new();
        let leaf = tape.leaf(d.clone());
        let fixed = smoothness(leaf, &image).value().item();
        let scaled = smoothness(leaf.scale(7.0), &image).value().item();
        let both = edge_aware_of_both(mean_normalised(leaf), tape.leaf(image.clone()), 1.0).value().item();
        assert!((fixed - scaled).abs() < 1e-6 && (fixed - both).abs() < 1e-14, "{fixed} {scaled} {both}");
        let check = GradCheck { step: 1e-6, ..GradCheck::default() };
        gradcheck(&[d, image], |_, v| edge_aware_of_both(v[0], v[1], 1.5), check).assert_ok();
    }
}

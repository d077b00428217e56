//! Census losses: each pixel must differ from its neighbours alike in both images, whatever the brightness.
//!
//! **Formula**: with grey values `g` from 0 to 255, for every cell of the window around `p` (grey 0 outside the image)
//! `d = g(cell) - g(p)`, `c = d / sqrt(0.81 + d^2)`; the distance of two images is
//! `h(p) = sum over cells of e^2 / (0.1 + e^2)` with `e = c_1 - c_2`. The forms differ in what they do with `h`:
//!
//! | form | window | loss | source |
//! |---|---|---|---|
//! | [`CensusForm::ArFlow`] | 3x3 | `mean(M h / 9)` | lliuz/ARFlow, `losses/loss_blocks.py` |
//! | [`CensusForm::Smurf`] | 7x7 | `sum(M (h + 0.01)^0.4) / sum(M + 1e-6)` | google-research/google-research, `smurf/` |
//! | [`CensusForm::UnFlow`] | any | `sum(M (h^2 + 0.001^2)^0.45) / (B H W)` | vt-vl-lab/DF-Net, `core/UnFlow/.../losses.py` |
//!
//! `M` is the caller's mask with a frame of the window's radius set to 0: windows there reach over the border.
//!
//! **Gradient**: to both images, none to the mask; 0 where the codes are equal and where `M` is 0. No kinks.

mod distance;
mod grey;
mod penalty;

use dimode_autodiff::{Scalar, Tensor, Var};

pub use distance::census_distance;
pub use grey::grey;

/// What becomes of the census distance; see the head of this file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CensusForm {
    /// Mean over the cells of a 3x3 window, plain mean over pixels.
    ArFlow,
    /// 7x7 window, power 0.4, mean over the mask.
    Smurf,
    /// Charbonnier's penalty of the sum over the window, divided by the number of all pixels.
    UnFlow {
        /// Cells on either side of the middle: 3 on the finest of UnFlow's levels, 1 on the coarsest.
        radius: usize,
    },
}

impl CensusForm {
    /// Cells on either side of the window's middle.
    #[must_use]
    pub fn radius(self) -> usize {
        match self {
            Self::ArFlow => 1,
            Self::Smurf => 3,
            Self::UnFlow { radius } => radius,
        }
    }
}

/// Census loss of two images `[n, 3, h, w]` with colours in [0, 1]; `mask` is `[n, 1, h, w]`, 0 or 1 or a weight.
///
/// Without any pixel left the value is 0, with zero gradient.
///
/// # Panics
/// When shapes differ or the images do not have three channels.
#[track_caller]
pub fn census<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>, mask: &Tensor<T>, form: CensusForm) -> Var<'t, T> {
    let distance = census_distance(grey(a), grey(b), form.radius());
    let shape = distance.shape();
    assert!(mask.shape() == shape, "census: mask {} does not go with maps {shape}", mask.shape());
    penalty::census_penalty(distance, mask, form)
}

/// The mask with 0 in a frame of `width` pixels.
#[must_use]
pub fn framed<T: Scalar>(mask: &Tensor<T>, width: usize) -> Tensor<T> {
    let s = mask.shape();
    let inside = |i: usize, size: usize| i >= width && i + width < size;
    Tensor::from_fn(s, |n, c, h, w| if inside(h, s.h()) && inside(w, s.w()) { mask.at(n, c, h, w) } else { T::ZERO })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::losses::charbonnier::charbonnier;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    const FORMS: [CensusForm; 3] = [CensusForm::ArFlow, CensusForm::Smurf, CensusForm::UnFlow { radius: 2 }];

    fn image(seed: u64, shape: Shape) -> Tensor<f64> {
        random(seed, shape, 0.4, 0.41)
    }

    /// What follows the distance, in small operations.
    fn composed<'t>(distance: Var<'t, f64>, mask: &Tensor<f64>, form: CensusForm) -> Var<'t, f64> {
        let (tape, shape, mask) = (distance.tape(), distance.shape(), framed(mask, form.radius()));
        let weight: f64 = mask.data().iter().sum();
        let distance = distance.select(&mask, tape.constant(Tensor::zeros(shape)));
        let (penalty, divisor) = match form {
            CensusForm::ArFlow => (distance.scale(1.0 / 9.0), shape.len() as f64),
            CensusForm::Smurf => (distance.add_scalar(0.01).powf(0.4), weight + 1e-6 * shape.len() as f64),
            CensusForm::UnFlow { .. } => (charbonnier(distance, 1e-3, 0.45), shape.len() as f64),
        };
        penalty.mul(tape.constant(mask)).sum().scale(1.0 / divisor)
    }

    #[test]
    fn the_penalty_equals_the_composed_form() {
        for ([h, w], form) in [[40, 53], [77, 9], [3, 2], [7, 7]].into_iter().flat_map(|size| FORMS.map(|form| (size, form))) {
            let shape = Shape::new(2, 1, h, w);
            let weight = |n, h, w| [0.0, 1.0, 0.3, 0.7][(n + h + w) % 4];
            let mask = Tensor::from_fn(shape, |n, _, h, w| weight(n, h, w));
            let distances = random::<f64>(1, shape, 0.0, 9.0);
            // What is masked may hold anything.
            let hole = |n, c, h, w| if weight(n, h, w) == 0.0 { f64::NAN } else { distances.at(n, c, h, w) };
            let run = |penalty: for<'t> fn(Var<'t, f64>, &Tensor<f64>, CensusForm) -> Var<'t, f64>| {
                let tape = Tape::new();
                let leaf = tape.leaf(Tensor::from_fn(shape, hole));
                let loss = penalty(leaf, &mask, form).scale(3.0);
                [loss.value(), tape.backward(loss).wrt(leaf)]
            };
            for (fused, composed) in run(penalty::census_penalty).iter().zip(&run(composed)) {
                for (f, c) in fused.data().iter().zip(composed.data()) {
                    assert!((f - c).abs() <= 1e-10 * c.abs(), "{shape} {form:?}: {f} and {c}");
                }
            }
        }
    }

    #[test]
    fn brightness_does_not_matter_inside() {
        let shape = Shape::new(1, 3, 9, 10);
        let a = image(1, shape);
        let brighter = Tensor::from_vec(shape, a.data().iter().map(|x| x + 0.2).collect());
        let tape = Tape::<f64>::new();
        let all = Tensor::full(shape.with_c(1), 1.0);
        for form in FORMS {
            let cost = |b: &Tensor<f64>| census(tape.constant(a.clone()), tape.constant(b.clone()), &all, form).value().item();
            assert!((cost(&brighter) - cost(&a)).abs() < 1e-9, "{form:?}");
            assert!(cost(&image(2, shape)) > cost(&a) + 0.1, "{form:?}");
        }
    }

    #[test]
    fn equal_images_have_the_least_value_and_no_gradient() {
        let shape = Shape::new(2, 3, 8, 9);
        let all = Tensor::full(shape.with_c(1), 1.0);
        for (form, least) in FORMS.into_iter().zip([0.0, 0.01_f64.powf(0.4), 1e-6_f64.powf(0.45)]) {
            let tape = Tape::new();
            let (a, b) = (tape.leaf(image(1, shape)), tape.leaf(image(1, shape)));
            let loss = census(a, b, &all, form);
            let inside = framed(&all, form.radius()).data().iter().sum::<f64>() / 144.0;
            let share = if form == CensusForm::Smurf { inside / (inside + 1e-6) } else { inside };
            assert!((loss.value().item() - least * share).abs() < 1e-14, "{form:?}: {loss:?}");
            let grads = tape.backward(loss);
            assert!(grads.wrt(a).data().iter().chain(grads.wrt(b).data()).all(|&g| g == 0.0), "{form:?}");
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(2, 3, 7, 8);
        let mask = Tensor::from_fn(shape.with_c(1), |n, _, h, w| if (n + h + w) % 3 == 0 { 0.0 } else { 1.0 });
        let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
        for form in FORMS {
            gradcheck(&[image(1, shape), image(2, shape)], |_, v| census(v[0], v[1], &mask, form), check).assert_ok();
        }
    }

    #[test]
    fn masked_pixels_and_empty_masks_pass_no_gradient() {
        let shape = Shape::new(1, 3, 9, 12);
        // Only the left part counts: windows of radius 1 end at column 5.
        let left = Tensor::from_fn(shape.with_c(1), |_, _, _, w| if w < 5 { 1.0 } else { 0.0 });
        let tape = Tape::new();
        let (a, b) = (tape.leaf(image(1, shape)), tape.leaf(image(2, shape)));
        let grad = tape.backward(census(a, b, &left, CensusForm::ArFlow)).wrt(a);
        let at = |w: usize| (0..9).any(|h| grad.at(0, 0, h, w) != 0.0);
        assert_eq!((0..12).map(at).collect::<Vec<_>>(), [[true; 6], [false; 6]].concat());
        for form in FORMS {
            let loss = census(a, b, &Tensor::zeros(shape.with_c(1)), form);
            assert_eq!(loss.value().item(), 0.0);
            assert!(tape.backward(loss).wrt(a).data().iter().all(|&g| g == 0.0));
        }
    }

    #[test]
    fn the_order_of_the_batch_does_not_matter() {
        let shape = Shape::new(2, 3, 8, 8);
        let swapped = |x: &Tensor<f64>| Tensor::from_fn(shape, |n, c, h, w| x.at(1 - n, c, h, w));
        let (a, b, all) = (image(1, shape), image(2, shape), Tensor::full(shape.with_c(1), 1.0));
        let tape = Tape::<f64>::new();
        let cost = |a: Tensor<f64>, b: Tensor<f64>, form| census(tape.constant(a), tape.constant(b), &all, form).value().item();
        for form in FORMS {
            assert!((cost(a.clone(), b.clone(), form) - cost(swapped(&a), swapped(&b), form)).abs() < 1e-12);
        }
    }
}

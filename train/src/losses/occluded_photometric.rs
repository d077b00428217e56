//! Photometric error of ARFlow: occluded pixels are painted black in both images before their structure is compared.
//!
//! **Formula**: `L = [0.15 mean(M |a - b|) + 0.85 mean(dissim(M a, M b))] / mean(M)` with
//! `dissim = clamp((1 - SSIM) / 2, 0, 1)` over 3x3 means without padding, hence two rows and columns fewer; means over all
//! pixels and channels [lliuz/ARFlow, `losses/flow_loss.py`, `losses/loss_blocks.py`].
//!
//! **Gradient**: to both images, none to the mask. At equal colours and at the clamp the subgradient is 0.

use dimode_autodiff::{Scalar, Tensor, Var};

use super::photometric::ALPHA;
use super::ssim::{Border, dissimilarity};

/// Windows of the structure have this many pixels along a side.
const WINDOW: usize = 3;

/// Error of two images `[n, c, h, w]` with colours in [0, 1]; `mask` is `[n, 1, h, w]`, 1 = not occluded; one number.
///
/// An empty mask gives 0, with zero gradient.
///
/// # Panics
/// When shapes differ or a side is shorter than 3 pixels.
#[track_caller]
pub fn occluded_photometric<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>, mask: &Tensor<T>) -> Var<'t, T> {
    let (shape, tape) = (a.shape(), a.tape());
    assert!(
        b.shape() == shape && mask.shape() == shape.with_c(1),
        "occluded_photometric: images {shape} and {} with mask {}; the rule: equal but for the mask's one channel",
        b.shape(),
        mask.shape()
    );
    let share = mask.data().iter().map(|m| m.to_f64()).sum::<f64>() / mask.shape().len() as f64;
    if share == 0.0 {
        return tape.constant(Tensor::scalar(T::ZERO));
    }
    let weight = tape.constant(mask.clone()).broadcast_to(shape);
    let chosen = weight.value();
    let black = tape.constant(Tensor::zeros(shape));
    let (a, b) = (a.select(&chosen, black), b.select(&chosen, black));
    let absolute = a.sub(b).abs().mul(weight).mean().scale(1.0 - ALPHA);
    let structure = dissimilarity(a.mul(weight), b.mul(weight), WINDOW, Border::LeftOut).mean().scale(ALPHA);
    absolute.add(structure).scale(1.0 / share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    fn mask(shape: Shape) -> Tensor<f64> {
        Tensor::from_fn(shape.with_c(1), |n, _, h, w| if (n + h * w) % 4 == 1 { 0.0 } else { 1.0 })
    }

    #[test]
    fn constant_images_have_the_worked_value() {
        let shape = Shape::new(1, 3, 4, 5);
        let tape = Tape::<f64>::new();
        let (a, b) = (tape.constant(Tensor::full(shape, 0.5)), tape.constant(Tensor::full(shape, 0.4)));
        let loss = occluded_photometric(a, b, &Tensor::full(shape.with_c(1), 1.0)).value().item();
        // SSIM 0.975615703487: 0.85 * 0.5 * (1 - SSIM) + 0.15 * 0.1
        assert!((loss - 0.025_363_326_018).abs() < 1e-11, "{loss}");
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(2, 3, 5, 6);
        let inputs = [random(1, shape, 0.0, 1.0), random(2, shape, 0.0, 1.0)];
        let check = GradCheck { step: 1e-5, rtol: 1e-5, atol: 1e-8, allow_zero: false };
        gradcheck(&inputs, |_, v| occluded_photometric(v[0], v[1], &mask(shape)), check).assert_ok();
    }

    #[test]
    fn occluded_pixels_may_be_nan_and_have_no_gradient() {
        let shape = Shape::new(2, 3, 5, 6);
        let mask = mask(shape);
        let clean = random::<f64>(1, shape, 0.0, 1.0);
        let spoilt = Tensor::from_fn(shape, |n, c, h, w| match mask.at(n, 0, h, w) {
            0.0 => f64::NAN,
            _ => clean.at(n, c, h, w),
        });
        let tape = Tape::new();
        let (a, b) = (tape.leaf(spoilt), tape.leaf(random(2, shape, 0.0, 1.0)));
        let loss = occluded_photometric(a, b, &mask);
        let same = occluded_photometric(tape.leaf(clean), b, &mask);
        assert_eq!(loss.value().item(), same.value().item());
        let grads = tape.backward(loss);
        for image in [a, b] {
            let grad = grads.wrt(image);
            let zero = |n, c, h, w| grad.at(n, c, h, w) == 0.0;
            let hidden = |n, h, w| mask.at(n, 0, h, w) == 0.0;
            assert!(
                Tensor::from_fn(shape, |n, c, h, w| f64::from(u8::from(hidden(n, h, w) && !zero(n, c, h, w)))).data()
                    == [0.0; 180]
            );
        }
    }

    #[test]
    fn nothing_to_see_costs_nothing() {
        let shape = Shape::new(1, 3, 4, 4);
        let tape = Tape::<f64>::new();
        let a = tape.leaf(random(1, shape, 0.0, 1.0));
        let loss = occluded_photometric(a, a.scale(0.5), &Tensor::zeros(shape.with_c(1)));
        assert_eq!(loss.value().item(), 0.0);
        let equal = occluded_photometric(a, a, &Tensor::full(shape.with_c(1), 1.0));
        assert!(equal.value().item().abs() < 1e-14);
    }
}

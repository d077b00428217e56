//! Structural dissimilarity of two images, a map for each channel.
//!
//! **Formula** (Wang et al. 2004; Monodepth2, `layers.py`): with means `m` over k x k windows,
//! `S = (2 m_x m_y + C1)(2 (m_xy - m_x m_y) + C2) / ((m_x^2 + m_y^2 + C1)(m_xx - m_x^2 + m_yy - m_y^2 + C2))`,
//! `C1 = 0.01^2`, `C2 = 0.03^2`, and the result is `(1 - S) / 2` clamped to [0, 1].
//!
//! Variances are taken of colours minus 0.5, which changes nothing but keeps digits in `f32`. The fused
//! [`photometric`](super::photometric::photometric) error has the map with k = 3 inside.

use dimode_autodiff::{Scalar, Var};

use super::photometric::{C1, C2, SHIFT};

/// What happens to windows that reach over the border.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Border {
    /// The image is mirrored about its edge pixels, which are not repeated; the map has the size of the image.
    #[default]
    Mirrored,
    /// They are left out; the map is smaller by k - 1 rows and columns (ARFlow, `losses/loss_blocks.py`).
    LeftOut,
}

/// Dissimilarity `[n, c, h, w]` of images of that shape, with windows of `window` x `window` pixels.
///
/// **Gradient**: to both images; at the clamp it passes (S = 1: equal windows, where it is 0 anyway).
///
/// # Panics
/// When the shapes differ, or unless `window` is odd and less than twice as long as either side.
#[track_caller]
pub fn dissimilarity<'t, T: Scalar>(x: Var<'t, T>, y: Var<'t, T>, window: usize, border: Border) -> Var<'t, T> {
    let [x, y] = [x, y].map(|image| image.add_scalar(-SHIFT));
    let mean = |map: Var<'t, T>| map.box_mean(window);
    let (mx, my) = (mean(x), mean(y));
    let variances = mean(x.square().add(y.square())).sub(mx.square().add(my.square()));
    let covariance = mean(x.mul(y)).sub(mx.mul(my));
    let (mx, my) = (mx.add_scalar(SHIFT), my.add_scalar(SHIFT));
    let above = mx.mul(my).scale(2.0).add_scalar(C1).mul(covariance.scale(2.0).add_scalar(C2));
    let below = mx.square().add(my.square()).add_scalar(C1).mul(variances.add_scalar(C2));
    let map = above.div(below).scale(-0.5).add_scalar(0.5).clamp(0.0, 1.0);
    match border {
        Border::Mirrored => map,
        Border::LeftOut => {
            let (s, cut) = (map.shape(), window - 1);
            map.slice(2, cut / 2, s.h() - cut).slice(3, cut / 2, s.w() - cut)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, Tape, Tensor, gradcheck};

    use crate::losses::photometric::{ALPHA, photometric};

    #[test]
    fn flat_images_have_the_worked_value() {
        let tape = Tape::<f64>::new();
        let flat = |value| tape.constant(Tensor::full(Shape::new(1, 2, 4, 5), value));
        for (border, count) in [(Border::Mirrored, 40), (Border::LeftOut, 12)] {
            let map = dissimilarity(flat(0.5), flat(0.4), 3, border).value();
            assert_eq!(map.data().len(), count);
            // 1 - S = 1 - 0.4001 / 0.4101
            assert!(map.data().iter().all(|&d| (d - 0.5 * (1.0 - 0.4001 / 0.4101)).abs() < 1e-12));
        }
    }

    #[test]
    fn equal_images_do_not_differ_and_ask_for_nothing() {
        let tape = Tape::<f64>::new();
        let image = random(1, Shape::new(1, 3, 8, 9), 0.0, 1.0);
        let (x, y) = (tape.leaf(image.clone()), tape.leaf(image));
        let map = dissimilarity(x, y, 7, Border::Mirrored);
        assert!(map.value().data().iter().all(|&d| d < 1e-12));
        assert!(tape.backward(map.sum()).wrt(x).data().iter().all(|&g| g.abs() < 1e-10));
    }

    /// The composed form of the fused operation: values, and gradients to both images.
    #[test]
    fn with_the_absolute_difference_it_makes_the_photometric_error() {
        for (h, w) in [(2, 2), (2, 5), (6, 7), (33, 17), (70, 40)] {
            let image = |seed| random(seed, Shape::new(2, 3, h, w), 0.0, 1.0);
            let run = |error: for<'t> fn(Var<'t, f64>, Var<'t, f64>) -> Var<'t, f64>| {
                let tape = Tape::<f64>::new();
                let [x, y] = [1, 2].map(|seed| tape.leaf(image(seed)));
                let map = error(x, y);
                let gradients = tape.backward(weighted_sum(map, 3));
                [map.value(), gradients.wrt(x), gradients.wrt(y)]
            };
            let composed = run(|x, y| {
                let dissimilarity = dissimilarity(x, y, 3, Border::Mirrored).scale(ALPHA);
                dissimilarity.add(x.sub(y).abs().scale(1.0 - ALPHA)).mean_channels()
            });
            for (fused, composed) in run(photometric).iter().zip(&composed) {
                for (a, b) in fused.data().iter().zip(composed.data()) {
                    assert!((a - b).abs() < 1e-10 * (1.0 + b.abs()), "{h} x {w}: {a} and {b}");
                }
            }
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(1, 2, 8, 9);
        for (window, border) in [(3, Border::Mirrored), (7, Border::Mirrored), (3, Border::LeftOut), (7, Border::LeftOut)] {
            let (x, y) = (random(3, shape, 0.0, 1.0), random(4, shape, 0.0, 1.0));
            let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
            let report = gradcheck(&[x, y], |_, v| weighted_sum(dissimilarity(v[0], v[1], window, border), 5), check);
            assert!(report.is_ok(), "{window} {border:?}: {report}");
        }
    }
}

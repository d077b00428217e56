//! Grey values: `y = 255 (0.2989 r + 0.5870 g + 0.1140 b)`. Linear: each channel receives its weight times the gradient.

use dimode_autodiff::ops::kernel;
use dimode_autodiff::{GradSink, Scalar, Tensor, Var};

/// Weights of red, green and blue, for results from 0 to 255.
const GREY: [f64; 3] = [255.0 * 0.2989, 255.0 * 0.5870, 255.0 * 0.1140];

/// Grey values from 0 to 255 of images `[n, 3, h, w]` with colours in [0, 1]: `[n, 1, h, w]`.
///
/// # Panics
/// Unless there are three channels.
#[track_caller]
pub fn grey<T: Scalar>(image: Var<'_, T>) -> Var<'_, T> {
    let shape = image.shape();
    assert!(shape.c() == 3, "grey: images have three channels, got {shape}");
    let (tape, x, plane) = (image.tape(), image.value(), shape.plane());
    let weights = GREY.map(T::from_f64);
    let mut y = tape.scratch(shape.n() * plane);
    for (n, y) in y.chunks_exact_mut(plane).enumerate() {
        let [red, green, blue] = weights;
        kernel::zip3(y, x.plane(n, 0), x.plane(n, 1), x.plane(n, 2), move |r, g, b| r * red + g * green + b * blue);
    }
    let y = tape.tensor(shape.with_c(1), y);
    tape.push("grey", y, &[image], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| {
                for (i, out) in out.chunks_exact_mut(plane).enumerate() {
                    let weight = weights[i % 3];
                    kernel::map(out, g.plane(i / 3, 0), move |g| weight * g);
                }
            });
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    #[test]
    fn colours_have_the_known_grey() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 3, 1, 4);
        let colours = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]];
        let found = grey(tape.constant(Tensor::from_vec(shape, colours.concat()))).value();
        for (found, wanted) in found.data().iter().zip([0.2989, 0.5870, 0.1140, 0.9999]) {
            assert!((found / 255.0 - wanted).abs() < 1e-15);
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let image = random(1, Shape::new(2, 3, 3, 5), 0.0, 1.0);
        gradcheck(&[image], |_, v| weighted_sum(grey(v[0]), 3), GradCheck::default()).assert_ok();
    }
}

//! Images read along a flow.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Var};

/// The image as it would look from where the flow starts: `warped(p) = image(p + flow(p))`, bilinear.
///
/// **Shapes**: `image` (N,C,H,W); `flow` (N,2,H,W), pixels; the result (N,C,H,W). A source image and the flow from target to
/// source give the target.
///
/// **Gradient**: to the image and to the flow, as of [`bilinear_sample`](Var::bilinear_sample) to image and coordinates.
///
/// **Panics** when a shape does not fit.
#[must_use]
#[track_caller]
pub fn warp<'t, T: Scalar>(image: Var<'t, T>, flow: Var<'t, T>, padding: SamplePadding) -> Var<'t, T> {
    let ends = flow.tape().pixel_grid(flow.shape()).last_use(|grid| flow.add(grid));
    ends.last_use(|ends| image.bilinear_sample(ends, padding))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape, Tensor};

    #[test]
    fn whole_pixels_shift_the_image_and_the_padding_says_what_comes_in() {
        let tape = Tape::<f64>::new();
        let image = tape.constant(Tensor::from_fn(Shape::new(1, 1, 2, 3), |_, _, v, u| (10 * v + u + 1) as f64));
        let right = tape.constant(Tensor::from_fn(Shape::new(1, 2, 2, 3), |_, c, _, _| if c == 0 { 1.0 } else { 0.0 }));
        let shifted = |padding| warp(image, right, padding).value().to_vec();
        assert_eq!(shifted(SamplePadding::Border), [2.0, 3.0, 3.0, 12.0, 13.0, 13.0]);
        assert_eq!(shifted(SamplePadding::Zeros), [2.0, 3.0, 0.0, 12.0, 13.0, 0.0]);
    }
}

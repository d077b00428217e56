//! Removal of the rotation between two views by resampling one of them (SC-Depth V2, auto-rectify).
//!
//! For a pure rotation `R` the pixel `p` of the target appears in the source at `p' ~ K R K^-1 p`, whatever its depth. Reading the
//! source at `p'` gives a view that differs from the target by a translation only.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Shape, Tensor, Var};

use super::MIN_DEPTH;
use super::masks;
use super::projection::{Divisor, Projection, back_project, project};
use crate::camera::Intrinsics;

/// A position outside of every image.
const NOWHERE: f64 = -1e4;

/// The pixels `K R K^-1 p`, (N,2,H,W), of a map of the size of the cameras.
///
/// **Formula**: with `y = K R K^-1 (u, v, 1)`, `(y_1, y_2) / (y_3 + 1e-7)` (sc_depth_pl, `losses/inverse_warp.py`).
/// **Shapes**: `rotation` (N,1,3,3), `source_from_target`; one camera a sample, all of one size.
/// **Domain**: a direction that is turned behind the image plane gets a position outside of the image and no gradient.
/// **Gradient**: to the rotation. **Panics** when a shape does not fit or there is no camera.
#[must_use]
#[track_caller]
pub fn rotated_pixels<'t, T: Scalar>(rotation: Var<'t, T>, intrinsics: &[Intrinsics]) -> Var<'t, T> {
    let camera = intrinsics.first().expect("rotated_pixels: at least one camera");
    let tape = rotation.tape();
    let map = Shape::new(intrinsics.len(), 1, camera.height, camera.width);
    let rays = back_project(tape.constant(Tensor::full(map, T::ONE)), intrinsics);
    let still = tape.constant(Tensor::zeros(Shape::new(map.n(), 3, 1, 1)));
    let Projection { pixels, depth } = project(rays, rotation, still, intrinsics, Divisor::PlusGuard);
    let ahead = masks::above(&depth.value(), 0, MIN_DEPTH);
    let ahead = Tensor::from_fn(map.with_c(2), |n, _, v, u| ahead.at(n, 0, v, u));
    pixels.select(&ahead, tape.constant(Tensor::full(map.with_c(2), T::from_f64(NOWHERE))))
}

/// The source image as seen by a camera that is turned like the target's: `image(K R K^-1 p)`, bilinear, 0 outside.
///
/// **Shapes**: `image` (N,C,H,W), `rotation` (N,1,3,3) `source_from_target`, one camera a sample. Only the translation is left
/// between the target and the result.
/// **Gradient**: to image and rotation. **Panics** when a shape does not fit.
#[must_use]
#[track_caller]
pub fn derotate<'t, T: Scalar>(image: Var<'t, T>, rotation: Var<'t, T>, intrinsics: &[Intrinsics]) -> Var<'t, T> {
    image.bilinear_sample(rotated_pixels(rotation, intrinsics), SamplePadding::Zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Se3;
    use crate::flow::rotational::rotational_flow;
    use crate::so3;
    use crate::taped::pose::pose_tensors;
    use crate::taped::{RotationForm, so3_exp::rotation_matrix};
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};
    use nalgebra::{Vector2, Vector3};

    fn camera() -> Intrinsics {
        Intrinsics::new(6.0, 7.0, 2.2, 1.4, 6, 5).unwrap()
    }

    #[test]
    fn no_rotation_leaves_the_image() {
        let tape = Tape::<f64>::new();
        let image = random(1, Shape::new(1, 2, 5, 6), 0.0, 1.0);
        let (r, _) = pose_tensors(&[Se3::identity()]);
        let out = derotate(tape.constant(image.clone()), tape.constant(r), &[camera()]).value();
        // The guard of the division moves positions by a ten-millionth of a pixel.
        assert!(out.data().iter().zip(image.data()).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn pixels_move_by_the_rotational_flow() {
        let tape = Tape::<f64>::new();
        let w = Vector3::new(0.05, -0.08, 0.1);
        let (r, _) = pose_tensors(&[Se3::from_rotation_vector(&w, Vector3::zeros())]);
        let pixels = rotated_pixels(tape.constant(r), &[camera()]).value();
        for (v, u) in [(0, 0), (4, 1), (2, 5)] {
            let p = Vector2::new(u as f64, v as f64);
            let flow = rotational_flow(&camera(), &so3::exp(&w), &p).unwrap();
            assert!((pixels.at(0, 0, v, u) - p.x - flow.x).abs() < 1e-5);
            assert!((pixels.at(0, 1, v, u) - p.y - flow.y).abs() < 1e-5);
        }
    }

    #[test]
    fn directions_turned_away_are_black_and_carry_no_gradient() {
        let tape = Tape::<f64>::new();
        let image = tape.leaf(random(1, Shape::new(1, 1, 5, 6), 0.5, 1.0));
        let half_turn = tape.leaf(Tensor::from_vec(Shape::new(1, 3, 1, 1), vec![0.0, std::f64::consts::PI, 0.0]));
        let out = derotate(image, rotation_matrix(half_turn, RotationForm::Exponential), &[camera()]);
        assert!(out.value().data().iter().all(|&x| x == 0.0));
        let grads = tape.backward(out.sum());
        assert_eq!(grads.wrt(half_turn).data(), [0.0; 3]);
        assert!(grads.wrt(image).data().iter().all(|&x| x == 0.0));
    }

    #[test]
    fn gradients_match_differences() {
        let image = random(3, Shape::new(2, 2, 5, 6), 0.0, 1.0);
        let angles = random(4, Shape::new(2, 3, 1, 1), -0.08, 0.08);
        let check = GradCheck { step: 1e-6, rtol: 1e-6, atol: 1e-8, ..GradCheck::default() };
        gradcheck(
            &[image, angles],
            |_, v| weighted_sum(derotate(v[0], rotation_matrix(v[1], RotationForm::Euler), &[camera(), camera()]), 7),
            check,
        )
        .assert_ok();
    }
}

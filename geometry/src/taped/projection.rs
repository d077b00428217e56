//! Back-projection and projection, step by step as public programs do it.
//!
//! [`rigid_flow`](super::rigid_flow()) is the operation to train with: it loses no digits to small motions, and leaves out points
//! behind the camera. What stands here is for losses that need the points or the sampled positions themselves, and for comparison
//! with programs whose rules at small depths and at the border of the image differ.

use dimode_autodiff::{Scalar, Shape, Tensor, Var};

use super::rigid_flow::check_motion;
use crate::camera::Intrinsics;

/// What the image coordinates are divided by at a point of depth `Z`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Divisor {
    /// `Z + 1e-7`, whatever its sign: a point behind the camera appears mirrored. Monodepth2 (`layers.py`) and sc_depth_pl
    /// (`losses/inverse_warp.py`).
    #[default]
    PlusGuard,
    /// `max(Z, 1e-3)`, which is also the depth that is returned. SC-SfMLearner-Release (`inverse_warp.py`).
    AtLeast,
}

/// Added to the depth by [`Divisor::PlusGuard`].
const GUARD: f64 = 1e-7;
/// Smallest depth of [`Divisor::AtLeast`].
const LEAST: f64 = 1e-3;
/// No divisor comes nearer to 0; reached only where `Z = -1e-7` to this precision.
const TINY: f64 = 1e-12;

/// Where the points of a target image appear in a source image.
#[derive(Clone, Copy, Debug)]
pub struct Projection<'t, T: Scalar> {
    /// Pixel (u, v), (N,2,H,W).
    pub pixels: Var<'t, T>,
    /// Depth in the source camera, (N,1,H,W).
    pub depth: Var<'t, T>,
}

/// The points `X = D K^-1 (u, v, 1)` of depth maps.
///
/// **Shapes**: `depth` (N,1,H,W), one camera a sample; the result (N,3,H,W). **Gradient**: to the depth.
/// **Panics** when there is not one camera for each map.
#[track_caller]
pub fn back_project<'t, T: Scalar>(depth: Var<'t, T>, intrinsics: &[Intrinsics]) -> Var<'t, T> {
    let shape = depth.shape();
    assert!(shape.c() == 1 && intrinsics.len() == shape.n(), "back_project: {} cameras for depth {shape}", intrinsics.len());
    let points = shape.with_c(3);
    let rays = Tensor::from_fn(points, |n, c, v, u| T::from_f64(intrinsics[n].ray(u as f64, v as f64)[c]));
    depth.broadcast_to(points).mul(depth.tape().constant(rays))
}

/// `y = K (R X + t)`, pixels `(y_1, y_2) / divisor(y_3)`.
///
/// **Shapes**: `points` (N,3,H,W); `rotation` (N,1,3,3) and `translation` (N,3,1,1) of `source_from_target`; one camera a sample.
/// **Gradient**: to points, rotation and translation; to the depth 0 below the least depth of [`Divisor::AtLeast`].
/// **Panics** when a shape does not fit.
#[track_caller]
pub fn project<'t, T: Scalar>(
    points: Var<'t, T>,
    rotation: Var<'t, T>,
    translation: Var<'t, T>,
    intrinsics: &[Intrinsics],
    divisor: Divisor,
) -> Projection<'t, T> {
    let shape = points.shape();
    check_motion("project", shape, rotation.shape(), translation.shape(), intrinsics);
    assert!(shape.c() == 3, "project: points have shape (N, 3, H, W), got {shape}");
    let n = shape.n();
    let cameras = Tensor::from_fn(Shape::new(n, 1, 3, 3), |n, _, i, j| T::from_f64(intrinsics[n].matrix()[(i, j)]));
    let cameras = points.tape().constant(cameras);
    let columns = Shape::new(n, 1, 3, shape.plane());
    let turned = cameras.matmul(rotation).matmul(points.reshape(columns)).reshape(shape);
    let moved = cameras.matmul(translation.reshape(Shape::new(n, 1, 3, 1))).reshape(Shape::new(n, 3, 1, 1));
    let image = turned.add(moved.broadcast_to(shape));
    let depth = image.slice(1, 2, 1);
    let (depth, below) = match divisor {
        Divisor::PlusGuard => (depth, depth.add_scalar(GUARD)),
        Divisor::AtLeast => {
            let depth = depth.clamp(LEAST, f64::INFINITY);
            (depth, depth)
        }
    };
    let pixels = image.slice(1, 0, 2).div_guarded(below.broadcast_to(shape.with_c(2)), TINY);
    Projection { pixels, depth }
}

/// Where an image is read for a projected pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SampleGrid {
    /// At the pixel itself. Programs reach this with coordinates divided by `(size - 1) / 2` and `align_corners=True`.
    #[default]
    Pixels,
    /// At `p size / (size - 1) - 1/2`: coordinates divided by `(size - 1) / 2` but read with `align_corners=False`, as both
    /// SC-Depth programs do. Half a pixel off at the border; for comparison only.
    HalfPixelAsCoded,
}

impl SampleGrid {
    /// Coordinates at which to read an image of `height` x `width` for the `pixels` (N,2,H,W).
    ///
    /// **Panics** for [`SampleGrid::HalfPixelAsCoded`] when a side is one pixel short: its coordinates are divided by 0 then.
    #[must_use]
    #[track_caller]
    pub fn coordinates<T: Scalar>(self, pixels: Var<'_, T>, height: usize, width: usize) -> Var<'_, T> {
        match self {
            SampleGrid::Pixels => pixels,
            SampleGrid::HalfPixelAsCoded => {
                assert!(height > 1 && width > 1, "SampleGrid: {height} x {width} pixels, at least 2 x 2 are needed");
                let stretch = |size: usize| T::from_f64(size as f64 / (size - 1) as f64);
                let factors = Tensor::from_vec(Shape::new(1, 2, 1, 1), vec![stretch(width), stretch(height)]);
                pixels.mul(pixels.tape().constant(factors).broadcast_to(pixels.shape())).add_scalar(-0.5)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Se3;
    use crate::taped::pose::pose_tensors;
    use crate::taped::rigid_flow;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck, pixel_grid};
    use nalgebra::Vector3;

    const SHAPE: Shape = Shape([2, 1, 4, 5]);

    fn cameras() -> [Intrinsics; 2] {
        [Intrinsics::new(6.0, 7.0, 2.2, 1.4, 5, 4).unwrap(), Intrinsics::new(9.0, 8.0, 2.0, 1.8, 5, 4).unwrap()]
    }

    fn motions() -> (Tensor<f64>, Tensor<f64>) {
        pose_tensors(&[
            Se3::from_rotation_vector(&Vector3::new(0.05, -0.08, 0.1), Vector3::new(0.2, -0.1, 0.4)),
            Se3::from_rotation_vector(&Vector3::new(-0.02, 0.03, 0.06), Vector3::new(0.0, 0.3, -0.5)),
        ])
    }

    #[test]
    fn pixels_minus_grid_are_the_rigid_flow() {
        let tape = Tape::new();
        let depth = tape.constant(random::<f64>(1, SHAPE, 2.0, 5.0));
        let (r, t) = motions();
        let (r, t) = (tape.constant(r), tape.constant(t));
        let flow = rigid_flow(depth, r, t, &cameras()).value();
        for divisor in [Divisor::PlusGuard, Divisor::AtLeast] {
            let seen = project(back_project(depth, &cameras()), r, t, &cameras(), divisor);
            let moved = seen.pixels.sub(tape.constant(pixel_grid(SHAPE))).value();
            for (n, plane) in moved.data().chunks(40).enumerate() {
                assert!(plane.iter().zip(&flow.data()[60 * n..]).all(|(a, b)| (a - b).abs() < 1e-6));
            }
            assert!((seen.depth.value().at(1, 0, 3, 2) - flow.at(1, 2, 3, 2)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_point_behind_is_mirrored_or_held_at_the_least_depth() {
        let tape = Tape::new();
        let camera = [Intrinsics::new(2.0, 2.0, 0.0, 0.0, 1, 1).unwrap()];
        let (r, t) = pose_tensors(&[Se3 { translation: Vector3::new(1.0, 0.0, -3.0), ..Se3::identity() }]);
        let depth = tape.leaf(Tensor::full(Shape::new(1, 1, 1, 1), 1.0));
        let see = |divisor| {
            let points = back_project(depth, &camera);
            project(points, tape.constant(r.clone()), tape.constant(t.clone()), &camera, divisor)
        };
        let mirrored = see(Divisor::PlusGuard);
        assert!((mirrored.pixels.value().data()[0] + 1.0).abs() < 1e-6);
        assert_eq!(mirrored.depth.value().item(), -2.0);
        let held = see(Divisor::AtLeast);
        assert_eq!((held.pixels.value().data()[0], held.depth.value().item()), (2000.0, 1e-3));
        assert_eq!(tape.backward(held.depth).wrt(depth).item(), 0.0);
    }

    #[test]
    fn gradients_match_differences() {
        let (r, t) = motions();
        for divisor in [Divisor::PlusGuard, Divisor::AtLeast] {
            let report = gradcheck(
                &[random(3, SHAPE, 2.0, 5.0), r.clone(), t.clone()],
                |_, v| {
                    let seen = project(back_project(v[0], &cameras()), v[1], v[2], &cameras(), divisor);
                    let read = SampleGrid::HalfPixelAsCoded.coordinates(seen.pixels, 4, 5);
                    weighted_sum(read, 5).add(weighted_sum(seen.depth, 6))
                },
                GradCheck::default(),
            );
            assert!(report.is_ok(), "{divisor:?}: {report}");
        }
    }

    #[test]
    fn half_pixel_grid_moves_the_corners_out_by_half_a_pixel() {
        let tape = Tape::<f64>::new();
        let corners = tape.constant(Tensor::from_vec(Shape::new(1, 2, 1, 2), vec![0.0, 4.0, 0.0, 3.0]));
        let read = SampleGrid::HalfPixelAsCoded.coordinates(corners, 4, 5).value();
        assert_eq!(read.data(), [-0.5, 4.5, -0.5, 3.5]);
    }
}

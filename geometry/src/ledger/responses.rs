//! Responses of aligned flow directions to errors of the estimate, by forward mode, the tape and central differences: what the
//! closed forms of [`crate::sensitivity`] are compared with.
//!
//! Angles are measured from the true direction, so that none of them jumps.

use dimode_autodiff::proof::{Dual, Number};
use dimode_autodiff::{Tape, Var};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::forward::{self, V2, V3};
use super::taped;
use crate::alignment::Match;
use crate::camera::Intrinsics;
use crate::sensitivity::Response;
use crate::so3;

/// Which alignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plane {
    /// With the imaging plane: removes `(0, 0, a_z)`.
    Planar,
    /// With the optical axis: removes `(a_x, a_y, 0)`.
    Axial,
}

/// An exact match and the true motion.
pub(crate) struct Pixel<'a> {
    pub camera: &'a Intrinsics,
    pub rotation: &'a Matrix3<f64>,
    pub a: Vector3<f64>,
    pub matched: Match,
    /// The true direction of the aligned flow, of any length.
    pub direction: Vector2<f64>,
}

impl Pixel<'_> {
    /// Angle of the aligned flow from the true direction after the errors `(w, delta)`.
    fn angle<N: Number>(&self, plane: Plane, error: [N; 6]) -> N {
        let [w_x, w_y, w_z, x, y, z] = error;
        let a: V3<N> = forward::sum(forward::fixed(self.a.into()), [x, y, z]);
        let zero = N::zero();
        let removed = match plane {
            Plane::Planar => [zero, zero, a[2]],
            Plane::Axial => [a[0], a[1], zero],
        };
        let true_rotation = forward::fixed(so3::log(self.rotation).into());
        let (m, fixed) = (&self.matched, |p: Vector2<f64>| -> V2<N> { forward::fixed(p.into()) });
        let pixels = [fixed(m.target), fixed(m.source)];
        let rotations = [true_rotation, [w_x, w_y, w_z]];
        let (f, _) = forward::aligned(self.camera, rotations, removed, pixels, N::constant(m.source_depth));
        let d = fixed(self.direction);
        (d[0] * f[1] - d[1] * f[0]).atan2(d[0] * f[0] + d[1] * f[1])
    }

    /// In forward mode.
    pub(crate) fn forward(&self, plane: Plane) -> Response {
        let slopes = forward::jacobian([0.0; 6], |error: [Dual; 6]| [self.angle(plane, error)]);
        std::array::from_fn(|k| slopes[k])
    }

    /// By central differences, each step turning the flow by about 2e-5 rad; `expected` are the responses, to choose the steps.
    pub(crate) fn central(&self, plane: Plane, expected: &Response) -> Response {
        let depth = self.matched.source_depth;
        let largest = (0..6).map(|k| expected[k].abs() * if k < 3 { 1.0 } else { depth }).fold(1e-3, f64::max);
        let steps = std::array::from_fn(|k| 2e-5 / largest * if k < 3 { 1.0 } else { depth });
        let slopes = forward::central([0.0; 6], steps, |error: [f64; 6]| [self.angle(plane, error)]);
        std::array::from_fn(|k| slopes[k])
    }

    /// On the tape.
    pub(crate) fn taped(&self, plane: Plane) -> Response {
        let cameras = [taped::pixel_camera(self.camera, &self.matched.target)];
        let flow = self.matched.source - self.matched.target;
        let weights = [1.0];
        taped_response(&cameras, self.rotation, &self.a, [flow.as_slice(), &[self.matched.source_depth]], (plane, &weights))
    }
}

/// Derivative of a weighted sum of aligned flow angles over an image on the tape; `maps` are the flow and the source depth.
pub(crate) fn taped_response(
    cameras: &[Intrinsics; 1],
    rotation: &Matrix3<f64>,
    a: &Vector3<f64>,
    maps: [&[f64]; 2],
    (plane, weights): (Plane, &[f64]),
) -> Response {
    use dimode_autodiff::{Shape, Tensor};
    let (h, w) = (cameras[0].height, cameras[0].width);
    let tape = Tape::new();
    let map = |c: usize, x: &[f64]| tape.constant(Tensor::from_vec(Shape::new(1, c, h, w), x.to_vec()));
    let (eps, a) = (tape.leaf(taped::column(&[0.0; 3])), tape.leaf(taped::column(a.as_slice())));
    let start = tape.constant(Tensor::from_fn(Shape::new(1, 1, 3, 3), |_, _, i, j| rotation[(i, j)]));
    let turned = start.matmul(crate::taped::so3_exp(eps));
    let aligned = crate::taped::align(map(1, maps[1]), turned, a, map(2, maps[0]), cameras);
    let channel = if plane == Plane::Planar { 0 } else { 2 };
    let angle: Var<'_, f64> = aligned.slice(1, channel + 1, 1).atan2(aligned.slice(1, channel, 1));
    let gradients = tape.backward(angle.mul(map(1, weights)).sum());
    let (eps, a) = (gradients.wrt(eps), gradients.wrt(a));
    std::array::from_fn(|k| if k < 3 { eps.data()[k] } else { a.data()[k - 3] })
}

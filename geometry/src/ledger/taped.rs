//! The tape's side of comparisons: values and derivatives of taped geometry at single pixels and over scenes.

use dimode_autodiff::{Shape, Tape, Tensor, Var};
use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;
use crate::losses::{self, AlignedPair, LossOptions, PairInputs};
use crate::scenes::{STEP, Scene};
use crate::se3::Se3;
use crate::taped::masks;
use crate::taped::pose::pose_tensors;

/// Values and derivatives of a function on the tape: the values of all entries of the result, and for each of them one row with
/// the derivatives with respect to all entries of all inputs, in order.
#[must_use]
pub fn jacobian(inputs: &[Tensor<f64>], f: impl for<'t> Fn(&[Var<'t, f64>]) -> Var<'t, f64>) -> (Vec<f64>, Vec<Vec<f64>>) {
    let row = |entry: usize| {
        let tape = Tape::new();
        let leaves: Vec<_> = inputs.iter().map(|x| tape.leaf(x.clone())).collect();
        let y = f(&leaves);
        let mut picked = vec![0.0; y.shape().len()];
        picked[entry] = 1.0;
        let weights = tape.constant(Tensor::from_vec(y.shape(), picked));
        let gradients = tape.backward(y.mul(weights).sum());
        let row = leaves.iter().flat_map(|&leaf| gradients.wrt(leaf).data().to_vec()).collect();
        (y.value().data().to_vec(), row)
    };
    let (values, first) = row(0);
    let rest = (1..values.len()).map(|entry| row(entry).1);
    let rows = std::iter::once(first).chain(rest).collect();
    (values, rows)
}

/// Numbers as a tensor (1,K,1,1): a rotation vector, a translation, the depth of one pixel.
#[must_use]
pub fn column(values: &[f64]) -> Tensor<f64> {
    Tensor::from_vec(Shape::new(1, values.len(), 1, 1), values.to_vec())
}

/// Flow of eq. `p_s` and source depth at one pixel, on the tape: the three values, and for each a row of derivatives by the rotation
/// vector (columns 0 to 2), the translation in the source frame (3 to 5) and the target depth (6).
#[must_use]
pub fn rigid_flow(
    camera: &Intrinsics,
    omega: &Vector3<f64>,
    t: &Vector3<f64>,
    p: &Vector2<f64>,
    z: f64,
) -> (Vec<f64>, Vec<Vec<f64>>) {
    let one_pixel = [pixel_camera(camera, p)];
    let inputs = [column(omega.as_slice()), column(t.as_slice()), column(&[z])];
    jacobian(&inputs, |v| crate::taped::rigid_flow(v[2], crate::taped::so3_exp(v[0]), v[1], &one_pixel))
}

/// The four losses on the tape over a scene's exact matches under a motion, aligned with that motion: planar, axial, tangential,
/// radial. The image has the scene's grid for pixels, seen by [`Scene::grid_camera`].
#[must_use]
pub fn scene_losses(scene: &Scene, motion: &Se3, options: &LossOptions) -> [f64; 4] {
    let [columns, rows] = scene.grid;
    let map = Shape::new(1, 1, rows, columns);
    let matches = scene.matches(motion);
    let flow = |c: usize, v: usize, u: usize| {
        let m = &matches[v * columns + u];
        (m.source - m.target)[c] / STEP as f64
    };
    let (tape, camera, mask) = (Tape::new(), [scene.grid_camera()], masks::everywhere(map));
    let (rotation, translation) = pose_tensors(&[*motion]);
    let inputs = PairInputs {
        target_depth: tape.constant(Tensor::from_vec(map, scene.depths.clone())),
        source_depth: tape.constant(Tensor::from_fn(map, |_, _, v, u| matches[v * columns + u].source_depth)),
        flow: tape.constant(Tensor::from_fn(Shape::new(1, 2, rows, columns), |_, c, v, u| flow(c, v, u))),
        rotation: tape.constant(rotation),
        translation: tape.constant(translation),
        intrinsics: &camera,
        mask: &mask,
    };
    let pair = AlignedPair::from_sampled(&inputs, options);
    let terms = [
        losses::planar(&pair, options),
        losses::axial(&pair, options),
        losses::tangential(&pair, options),
        losses::radial(&pair, options),
    ];
    terms.map(|term| term.mean.value().item())
}

/// The camera of a one-pixel image that shows pixel `p` of another: taped maps of one entry then belong to `p`.
#[must_use]
pub fn pixel_camera(camera: &Intrinsics, p: &Vector2<f64>) -> Intrinsics {
    Intrinsics { u0: camera.u0 - p.x, v0: camera.v0 - p.y, width: 1, height: 1, ..*camera }
}

/// Options of losses without thresholds, noise allowance and cut gradients: the equations alone.
#[must_use]
pub fn bare() -> LossOptions {
    LossOptions {
        tau_flow: 0.0,
        tau_ratio: 0.0,
        q_min: 0.0,
        min_tangential_flow: 0.0,
        min_tangential_share: 0.0,
        noise_pixels: 0.0,
        noise_share: 0.0,
        min_valid_share: 0.0,
        detach_source_depth: false,
        ..LossOptions::default()
    }
}

/// A pair without rotation at depth 1. Its planar flow is `flow`, (N,2,H,W), where `a_z = 0`, its axial flow where
/// `a_x = a_y = 0`: losses become functions of the flows alone. The cameras take the size of the maps.
#[must_use]
pub fn still_pair<'t>(flow: Var<'t, f64>, a: [f64; 3], cameras: &[Intrinsics], options: &LossOptions) -> AlignedPair<'t, f64> {
    let shape = flow.shape();
    let map = Shape::new(shape.n(), 1, shape.h(), shape.w());
    let cameras: Vec<_> = cameras.iter().map(|k| Intrinsics { width: shape.w(), height: shape.h(), ..*k }).collect();
    let tape = flow.tape();
    let (ones, mask) = (tape.constant(Tensor::full(map, 1.0)), Tensor::full(map, 1.0));
    let identity = Tensor::from_fn(Shape::new(shape.n(), 1, 3, 3), |_, _, i, j| if i == j { 1.0 } else { 0.0 });
    let translation = Tensor::from_fn(Shape::new(shape.n(), 3, 1, 1), |_, k, _, _| a[k]);
    let inputs = PairInputs {
        target_depth: ones,
        source_depth: ones,
        flow,
        rotation: tape.constant(identity),
        translation: tape.constant(translation),
        intrinsics: &cameras,
        mask: &mask,
    };
    AlignedPair::from_sampled(&inputs, options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_entries_and_columns_are_inputs() {
        let (values, rows) = jacobian(&[column(&[2.0, 3.0]), column(&[5.0, 7.0])], |v| v[0].mul(v[1]));
        assert_eq!(values, [10.0, 21.0]);
        assert_eq!(rows, [[5.0, 0.0, 2.0, 0.0], [0.0, 7.0, 0.0, 3.0]]);
    }
    #[test]
    fn the_still_pair_hands_the_flow_on() {
        let camera = Intrinsics { fu: 300.0, fv: 200.0, u0: 1.0, v0: 2.0, width: 2, height: 1 };
        let tape = Tape::new();
        let flow = tape.leaf(Tensor::from_vec(Shape::new(1, 2, 1, 2), vec![3.0, -0.5, 0.25, 40.0]));
        let near = |x: &Tensor<f64>| x.data().iter().zip(flow.value().data()).all(|(a, b)| (a - b).abs() < 1e-13);
        assert!(near(&still_pair(flow, [0.4, 0.2, 0.0], &[camera], &bare()).planar_flow.value()));
        assert!(near(&still_pair(flow, [0.0, 0.0, -0.7], &[camera], &bare()).axial_flow.value()));
    }
}

//! A whole scene after the alignments: the flows whose directions and lengths the losses judge.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::alignment::{self, Match};
use crate::camera::Intrinsics;
use crate::scenes::Reference;
use crate::so3;

/// Aligned flows of all pixels under one estimate of the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedScene {
    /// The estimated translation `a = t'` in the target frame.
    pub a: Vector3<f64>,
    /// Flows after the alignment with the imaging plane, pixels.
    pub planar: Vec<Vector2<f64>>,
    /// Flows after the alignment with the optical axis, pixels.
    pub axial: Vec<Vector2<f64>>,
    /// Offsets `d = p - p0`, pixels.
    pub offsets: Vec<Vector2<f64>>,
}

impl AlignedScene {
    /// Aligns matches with an estimated rotation and translation; `None` when a point comes behind the camera.
    #[must_use]
    pub fn new(camera: &Intrinsics, rotation: &Matrix3<f64>, a: &Vector3<f64>, matches: &[Match]) -> Option<Self> {
        let flows = |m| Some((alignment::planar(camera, rotation, a, m)?.flow, alignment::axial(camera, rotation, a, m)?.flow));
        let (planar, axial) = matches.iter().map(flows).collect::<Option<_>>()?;
        let offsets = matches.iter().map(|m| m.target - camera.principal_point()).collect();
        Some(Self { a: *a, planar, axial, offsets })
    }

    /// Exact matches of a reference, aligned with the true motion plus an error: `R exp([w]_x)` and `t' + delta`, the error being
    /// `(w, delta)`, radians and metres. `None` when a point comes behind the camera.
    #[must_use]
    pub fn with_error(reference: &Reference, error: &[f64; 6]) -> Option<Self> {
        let [w_x, w_y, w_z, x, y, z] = *error;
        let rotation = reference.motion.rotation * so3::exp(&Vector3::new(w_x, w_y, w_z));
        let a = reference.motion.translation_in_from_frame() + Vector3::new(x, y, z);
        Self::new(&reference.scene.camera, &rotation, &a, &reference.scene.matches(&reference.motion))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::radial::radial_flow;
    use crate::flow::tangential::tangential_flow;
    use crate::scenes;

    #[test]
    fn without_error_both_flows_are_those_of_one_part_of_the_translation() {
        for reference in scenes::references() {
            let seen = AlignedScene::with_error(&reference, &[0.0; 6]).unwrap();
            let scene = &reference.scene;
            for (i, (p, &z)) in scene.pixels.iter().zip(&scene.depths).enumerate() {
                assert!((seen.planar[i] - tangential_flow(&scene.camera, &seen.a, z)).norm() < 1e-10);
                assert!((seen.axial[i] - radial_flow(&scene.camera, seen.a.z, p, z).unwrap()).norm() < 1e-10);
            }
        }
    }
}

//! A whole scene after the alignments: the flows whose directions and lengths the losses judge.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::alignment::{self, Match};
use crate::camera::Intrinsics;
use crate::loss_forms::{axial, planar, radial, tangential};
use crate::scenes::Reference;
use crate::so3;

/// Aligned flows of all pixels under one estimate of the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedScene {
    /// The camera.
    pub camera: Intrinsics,
    /// The translation `a` that was split.
    pub translation: Vector3<f64>,
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
        Some(Self { camera: *camera, translation: *a, planar, axial, offsets })
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

    /// Circular `L_pla`, `L_axi` with the sign of the split translation, `L_tan` and `L_rad` as printed, for these target depths.
    #[must_use]
    pub fn losses(&self, depths: &[f64]) -> [f64; 4] {
        [
            planar::circular(&self.planar),
            axial::pose_sign(&self.axial, &self.offsets, self.translation.z),
            tangential::printed(&self.camera, &self.planar, depths, &self.translation),
            radial::printed(&self.axial, &self.offsets, depths, &self.translation),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alignment::Convention;
    use crate::flow::radial::radial_flow;
    use crate::flow::tangential::tangential_flow;
    use crate::scenes;

    #[test]
    fn without_error_both_flows_are_those_of_one_part_of_the_translation() {
        for reference in scenes::references() {
            let seen = AlignedScene::with_error(&reference, &[0.0; 6]).unwrap();
            let scene = &reference.scene;
            for (i, (p, &z)) in scene.pixels.iter().zip(&scene.depths).enumerate() {
                assert!((seen.planar[i] - tangential_flow(&scene.camera, &seen.translation, z)).norm() < 1e-10);
                assert!((seen.axial[i] - radial_flow(&scene.camera, seen.translation.z, p, z).unwrap()).norm() < 1e-10);
            }
        }
    }

    #[test]
    fn exact_alignment_costs_nothing_and_the_printed_one_does() {
        let scenes::Reference { scene, motion, .. } = scenes::turn();
        let exact = scene.aligned(&motion, Convention::Consistent).losses(&scene.depths);
        assert!(exact.iter().all(|x| x.abs() < 1e-9), "{exact:?}");
        let printed = scene.aligned(&motion, Convention::AsPrinted).losses(&scene.depths);
        assert!((printed[1] - 0.0580573406461).abs() < 1e-11, "{printed:?}");
    }
}

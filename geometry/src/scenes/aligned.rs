//! A scene after the alignment of exact matches.

use nalgebra::{Vector2, Vector3};

use super::Scene;
use crate::alignment::{self, Convention};
use crate::camera::Intrinsics;
use crate::loss_forms::{axial, planar, radial, tangential};
use crate::se3::Se3;

/// Aligned flows of a scene, and what the losses read beside them.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedScene {
    /// The camera.
    pub camera: Intrinsics,
    /// Planar flows, pixels.
    pub planar: Vec<Vector2<f64>>,
    /// Axial flows, pixels.
    pub axial: Vec<Vector2<f64>>,
    /// Offsets `p - p0`, pixels.
    pub offsets: Vec<Vector2<f64>>,
    /// Target depths.
    pub depths: Vec<f64>,
    /// Translation that was split.
    pub translation: Vector3<f64>,
}

impl Scene {
    /// The scene's exact matches under a motion, aligned with that motion.
    ///
    /// **Panics** when a point comes behind a camera.
    #[must_use]
    #[track_caller]
    pub fn aligned(&self, source_from_target: &Se3, convention: Convention) -> AlignedScene {
        let (rotation, translation) = (&source_from_target.rotation, convention.translation(source_from_target));
        let matches = self.matches(source_from_target);
        let flow = |aligned: Option<alignment::Aligned>| aligned.expect("aligned points stay in front of the camera").flow;
        AlignedScene {
            camera: self.camera,
            planar: matches.iter().map(|m| flow(alignment::planar(&self.camera, rotation, &translation, m))).collect(),
            axial: matches.iter().map(|m| flow(alignment::axial(&self.camera, rotation, &translation, m))).collect(),
            offsets: self.offsets(),
            depths: self.depths.clone(),
            translation,
        }
    }
}

impl AlignedScene {
    /// Circular `L_pla`, `L_axi` with the sign of the split translation, `L_tan` and `L_rad` as printed.
    #[must_use]
    pub fn losses(&self) -> [f64; 4] {
        [
            planar::circular(&self.planar),
            axial::pose_sign(&self.axial, &self.offsets, self.translation.z),
            tangential::printed(&self.camera, &self.planar, &self.depths, &self.translation),
            radial::printed(&self.axial, &self.offsets, &self.depths, &self.translation),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    #[test]
    fn exact_alignment_costs_nothing_and_the_printed_one_does() {
        let reference = scenes::turn();
        let exact = reference.scene.aligned(&reference.motion, Convention::Consistent).losses();
        assert!(exact.iter().all(|x| x.abs() < 1e-9), "{exact:?}");
        let printed = reference.scene.aligned(&reference.motion, Convention::AsPrinted).losses();
        assert!((printed[1] - 0.0580573406461).abs() < 1e-11, "{printed:?}");
    }
}

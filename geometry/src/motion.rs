//! Splitting a motion into rotation, tangential and radial translation (eq. `transformation`).

use nalgebra::{Matrix3, Vector3};

use crate::se3::Se3;

/// Radial part `(0, 0, v_z)` of a vector.
#[must_use]
pub fn radial_part(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, v.z)
}

/// Tangential part `(v_x, v_y, 0)` of a vector.
#[must_use]
pub fn tangential_part(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, v.y, 0.0)
}

/// The three factors of a motion, each a motion of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionParts {
    /// `[R 0]`.
    pub rotation: Se3,
    /// `[I tan]`.
    pub tangential: Se3,
    /// `[I rad]`.
    pub radial: Se3,
}

impl MotionParts {
    fn new(rotation: Matrix3<f64>, translation: &Vector3<f64>) -> Self {
        let pure = |translation| Se3 { rotation: Matrix3::identity(), translation };
        Self {
            rotation: Se3 { rotation, translation: Vector3::zeros() },
            tangential: pure(tangential_part(translation)),
            radial: pure(radial_part(translation)),
        }
    }

    /// Split of eq. `transformation`: `T = T_rad T_tan T_rot`, translation in the source frame.
    #[must_use]
    pub fn in_source_frame(source_from_target: &Se3) -> Self {
        Self::new(source_from_target.rotation, &source_from_target.translation)
    }

    /// Split with the translation in the target frame: `T = T_rot T_rad T_tan` with `t' = R^T t`.
    ///
    /// Its parts differ from those of [`MotionParts::in_source_frame`] by [`translation_gap`].
    #[must_use]
    pub fn in_target_frame(source_from_target: &Se3) -> Self {
        let translation = source_from_target.translation_in_from_frame();
        Self::new(source_from_target.rotation, &translation)
    }

    /// `T_rad T_tan T_rot`.
    #[must_use]
    pub fn rotation_first(&self) -> Se3 {
        self.radial * self.tangential * self.rotation
    }

    /// `T_rot T_rad T_tan`.
    #[must_use]
    pub fn rotation_last(&self) -> Se3 {
        self.rotation * self.radial * self.tangential
    }
}

/// Difference `t' - t = (R^T - I) t` of the translations of both splits.
///
/// Its length is at most the rotation angle times `|t|`; it vanishes without rotation and for a rotation about `t`.
#[must_use]
pub fn translation_gap(source_from_target: &Se3) -> Vector3<f64> {
    source_from_target.translation_in_from_frame() - source_from_target.translation
}

/// [`translation_gap`] to first order in the rotation vector `omega`: `-(omega x t)`, off by at most `|omega|^2 |t| / 2`.
#[must_use]
pub fn translation_gap_first_order(omega: &Vector3<f64>, translation: &Vector3<f64>) -> Vector3<f64> {
    -omega.cross(translation)
}

/// What is left of `motion` after an estimated rotation and tangential translation were undone
/// before it: `T T_rot^-1 T_tan^-1`, exactly `T_rad` for a perfect estimate.
#[must_use]
pub fn remaining_radial(motion: &Se3, estimate: &MotionParts) -> Se3 {
    *motion * estimate.rotation.inverse() * estimate.tangential.inverse()
}

/// As [`remaining_radial`], for the radial translation undone: exactly `T_tan` for a perfect estimate.
#[must_use]
pub fn remaining_tangential(motion: &Se3, estimate: &MotionParts) -> Se3 {
    *motion * estimate.rotation.inverse() * estimate.radial.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use proptest::prelude::*;

    fn gap(a: &Se3, b: &Se3) -> f64 {
        (a.rotation - b.rotation).abs().max() + (a.translation - b.translation).norm()
    }

    proptest! {
        #[test]
        fn both_splits_compose_to_the_motion(case in testing::case()) {
            let scale = 1.0 + case.motion.translation.norm();
            let source = MotionParts::in_source_frame(&case.motion);
            prop_assert!(gap(&source.rotation_first(), &case.motion) < 1e-13 * scale);
            let target = MotionParts::in_target_frame(&case.motion);
            prop_assert!(gap(&target.rotation_last(), &case.motion) < 1e-13 * scale);
        }

        #[test]
        fn ideal_decomposition(case in testing::case()) {
            let scale = 1.0 + case.motion.translation.norm();
            let parts = MotionParts::in_source_frame(&case.motion);
            prop_assert!(gap(&remaining_radial(&case.motion, &parts), &parts.radial) < 1e-13 * scale);
            prop_assert!(gap(&remaining_tangential(&case.motion, &parts), &parts.tangential) < 1e-13 * scale);
        }
    }
}

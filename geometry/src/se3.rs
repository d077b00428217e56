//! Rigid motions.

use std::ops::Mul;

use nalgebra::{Matrix3, Vector3, Vector6};

use crate::error::GeometryError;
use crate::so3;
use crate::svd3::svd3;

/// The map `x -> R x + t` between two camera or world frames; name values `to_from_from`,
/// for example `source_from_target`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Se3 {
    /// Rotation matrix `R`.
    pub rotation: Matrix3<f64>,
    /// Translation `t`, expressed in the frame the map leads to.
    pub translation: Vector3<f64>,
}

impl Se3 {
    /// The motion that changes nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// Rotation vector (radians) and translation, taken separately: `R = exp(w)`, `t` as given.
    #[must_use]
    pub fn from_rotation_vector(omega: &Vector3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation: so3::exp(omega), translation }
    }

    /// Exponential of a twist `[omega, nu]`: rotation `exp(omega)`, translation `J_l(omega) nu`.
    #[must_use]
    pub fn exp(twist: &Vector6<f64>) -> Self {
        let omega = twist.fixed_rows::<3>(0).into_owned();
        let nu = twist.fixed_rows::<3>(3).into_owned();
        Self { rotation: so3::exp(&omega), translation: so3::left_jacobian(&omega) * nu }
    }

    /// Twist `[omega, nu]` whose exponential is this motion.
    #[must_use]
    pub fn log(&self) -> Vector6<f64> {
        let omega = so3::log(&self.rotation);
        let nu = so3::left_jacobian_inverse(&omega) * self.translation;
        Vector6::new(omega.x, omega.y, omega.z, nu.x, nu.y, nu.z)
    }

    /// First `other`, then `self`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        Self { rotation: self.rotation * other.rotation, translation: self.rotation * other.translation + self.translation }
    }

    /// The motion back, using `R^-1 = R^T`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Image of a point.
    #[must_use]
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// The translation expressed in the frame the map starts from: `R^T t`, so that
    /// `R x + t = R (x + R^T t)`.
    #[must_use]
    pub fn translation_in_from_frame(&self) -> Vector3<f64> {
        self.rotation.tr_mul(&self.translation)
    }

    /// Largest absolute entry of `R^T R - I`.
    #[must_use]
    pub fn orthonormality_error(&self) -> f64 {
        (self.rotation.tr_mul(&self.rotation) - Matrix3::identity()).abs().max()
    }

    /// Whether the 3x3 part is a proper rotation up to `tolerance` in every entry of `R^T R - I`.
    #[must_use]
    pub fn is_orthonormal(&self, tolerance: f64) -> bool {
        self.orthonormality_error() <= tolerance && self.rotation.determinant() > 0.0
    }

    /// This motion, if its 3x3 part is a rotation.
    ///
    /// # Errors
    /// [`GeometryError::NotARotation`] naming `what` otherwise.
    pub fn checked(self, what: &str, tolerance: f64) -> Result<Self, GeometryError> {
        if self.is_orthonormal(tolerance) {
            return Ok(self);
        }
        Err(GeometryError::NotARotation {
            what: what.to_owned(),
            deviation: self.orthonormality_error(),
            tolerance,
            determinant: self.rotation.determinant(),
        })
    }

    /// Rotation angle in `[0, pi]`, radians.
    #[must_use]
    pub fn rotation_angle(&self) -> f64 {
        so3::angle(&self.rotation)
    }

    /// The same motion with the 3x3 part replaced by the nearest rotation (Frobenius norm).
    ///
    /// # Panics
    /// When the 3x3 part holds a value that is not finite.
    #[must_use]
    #[track_caller]
    pub fn orthonormalised(&self) -> Self {
        assert!(self.rotation.iter().all(|x| x.is_finite()), "Se3::orthonormalised: the matrix is not finite: {}", self.rotation);
        let svd = svd3(&self.rotation);
        let sign = (svd.u * svd.v.transpose()).determinant().signum();
        let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign));
        Self { rotation: svd.u * flip * svd.v.transpose(), translation: self.translation }
    }
}

impl Mul for Se3 {
    type Output = Se3;

    fn mul(self, other: Se3) -> Se3 {
        self.compose(&other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn motion() -> impl Strategy<Value = Se3> {
        prop::array::uniform6(-1.5f64..1.5).prop_map(|x| Se3::exp(&Vector6::from(x)))
    }

    fn gap(a: &Se3, b: &Se3) -> f64 {
        (a.rotation - b.rotation).abs().max() + (a.translation - b.translation).norm()
    }

    #[test]
    fn inverse_translation_matches_reference_value() {
        let motion = Se3::from_rotation_vector(&Vector3::new(0.03, -0.05, 0.02), Vector3::new(0.06, 0.04, -0.08));
        assert!((motion.inverse().translation.x + 0.056661070926).abs() < 1e-12);
        let in_target = motion.translation_in_from_frame();
        let expected = Vector3::new(0.056661070926, 0.0363712893823, -0.0840633829333);
        assert!((in_target - expected).norm() < 1e-12);
    }

    #[test]
    fn screw_about_z() {
        let turn = std::f64::consts::PI;
        let m = Se3::exp(&Vector6::new(0.0, 0.0, turn, turn, 0.0, 1.0));
        // Half a turn with forward speed along x traces half a circle of radius 1.
        assert!((m.translation - Vector3::new(0.0, 2.0, 1.0)).norm() < 1e-12);
    }

    #[test]
    fn text_precision_rotations_are_repaired_and_mirrors_rejected() {
        let mut m = Se3::from_rotation_vector(&Vector3::new(0.1, 0.2, -0.3), Vector3::zeros());
        m.rotation += Matrix3::repeat(3e-7);
        assert!(!m.is_orthonormal(1e-9));
        assert!(m.orthonormalised().is_orthonormal(1e-14));
        assert!((m.orthonormalised().rotation - m.rotation).abs().max() < 1e-6);
        m.rotation = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        let message = m.checked("row 7", 1e-6).unwrap_err().to_string();
        assert!(message.contains("row 7") && message.contains("-1.0"), "{message}");
    }

    proptest! {
        #[test]
        fn group_laws(a in motion(), b in motion(), c in motion(), x in prop::array::uniform3(-5.0f64..5.0)) {
            let x = Vector3::from(x);
            prop_assert!(gap(&((a * b) * c), &(a * (b * c))) < 1e-13);
            prop_assert!(gap(&(a * a.inverse()), &Se3::identity()) < 1e-13);
            prop_assert!(gap(&(a.inverse().inverse()), &a) < 1e-13);
            prop_assert!(((a * b).transform(&x) - a.transform(&b.transform(&x))).norm() < 1e-12);
        }

        #[test]
        fn logarithm_inverts_exponential(x in prop::array::uniform6(-1.5f64..1.5)) {
            let twist = Vector6::from(x);
            prop_assert!((Se3::exp(&twist).log() - twist).norm() < 1e-11);
        }

        #[test]
        fn two_frames_of_the_translation_differ_by_the_commutator(
            axis in prop::array::uniform3(-1.0f64..1.0), angle in 0.0f64..0.2, t in prop::array::uniform3(-1.0f64..1.0)
        ) {
            let (axis, t) = (Vector3::from(axis), Vector3::from(t));
            prop_assume!(axis.norm() > 0.1);
            let omega = axis.normalize() * angle;
            let delta = Se3::from_rotation_vector(&omega, t).translation_in_from_frame() - t;
            prop_assert!((delta + omega.cross(&t)).norm() <= 0.5 * angle * angle * t.norm() + 1e-15);
        }
    }
}

//! The two orders in which rotation and translation come off a point of the source frame (footnote on the order).
//!
//! `P_s = R P_t + t = R (P_t + t')` with `t' = R^T t`: the translation may come off first, as `t`, or last, as `t'`.

use nalgebra::Vector3;

use crate::se3::Se3;

/// The point without the translation: `P_s - t = R P_t`. What is left is a pure rotation.
#[must_use]
pub fn without_translation(source_from_target: &Se3, source_point: &Vector3<f64>) -> Vector3<f64> {
    source_point - source_from_target.translation
}

/// Translation first: `R^T (P_s - t) = P_t`.
#[must_use]
pub fn translation_first(source_from_target: &Se3, source_point: &Vector3<f64>) -> Vector3<f64> {
    source_from_target.rotation.tr_mul(&without_translation(source_from_target, source_point))
}

/// Rotation first: `R^T P_s - R^T t = P_t`.
#[must_use]
pub fn rotation_first(source_from_target: &Se3, source_point: &Vector3<f64>) -> Vector3<f64> {
    source_from_target.rotation.tr_mul(source_point) - source_from_target.translation_in_from_frame()
}

/// Rotation first, then the translation of the wrong frame, as eq. `pplanar` prints it: `R^T P_s - t`.
///
/// **Reading**: misses `P_t` by `(R^T - I) t` ([`translation_gap`](crate::motion::translation_gap)). For comparison only.
#[must_use]
pub fn printed_rotation_first(source_from_target: &Se3, source_point: &Vector3<f64>) -> Vector3<f64> {
    source_from_target.rotation.tr_mul(source_point) - source_from_target.translation
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn both_orders_lead_back_and_the_printed_one_does_not(case in testing::case()) {
            let point = case.camera.ray(case.pixel.x, case.pixel.y) * case.depth;
            let source = case.motion.transform(&point);
            prop_assert!((translation_first(&case.motion, &source) - point).norm() < 1e-13 * point.norm());
            prop_assert!((rotation_first(&case.motion, &source) - point).norm() < 1e-13 * point.norm());
            let miss = printed_rotation_first(&case.motion, &source) - point;
            prop_assert!((miss - crate::motion::translation_gap(&case.motion)).norm() < 1e-13 * point.norm());
        }
    }
}

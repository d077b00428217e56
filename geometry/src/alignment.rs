//! Alignment of source points with the imaging plane and the optical axis of the target (eqs.
//! `pplanar`, `disflow`).
//!
//! Undoing the rotation and one part of the translation leaves a flow caused by the other part only:
//! the planar flow is purely tangential, the axial flow purely radial.

pub mod corrections;
pub mod printed;

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::backprojection::source_point;
use crate::camera::Intrinsics;
use crate::motion::{radial_part, tangential_part};
use crate::se3::Se3;
use crate::so3::hat;

/// Which translation the alignment splits.
///
/// **Reading**: eq. `pplanar` subtracts a part of `t` after `R^-1`. As `R^-1 P_s = P_t + R^T t`, that is
/// exact only where `R t = t`; what is left otherwise is `(R^T - I) t`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Convention {
    /// `a = t`, the equation as printed.
    AsPrinted,
    /// `a = R^T t`, the translation in the target frame: the alignment is exact.
    #[default]
    Consistent,
}

impl Convention {
    /// The translation `a` whose parts the alignment removes.
    #[must_use]
    pub fn translation(self, source_from_target: &Se3) -> Vector3<f64> {
        match self {
            Self::AsPrinted => source_from_target.translation,
            Self::Consistent => source_from_target.translation_in_from_frame(),
        }
    }
}

/// One aligned pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aligned {
    /// Flow after the alignment, pixels.
    pub flow: Vector2<f64>,
    /// Depth of the aligned point.
    pub depth: f64,
}

/// A target pixel, the source pixel the flow assigns to it, and the source depth found there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Target pixel `p`.
    pub target: Vector2<f64>,
    /// Source pixel `p_s = p + f_opt(p)`.
    pub source: Vector2<f64>,
    /// Depth of the source view at `p_s`, in the source frame.
    pub source_depth: f64,
}

/// Point of the match, turned into the target's orientation: `R^T D_st K^-1 p~_s`.
#[must_use]
pub fn unrotated_point(camera: &Intrinsics, rotation: &Matrix3<f64>, m: &Match) -> Vector3<f64> {
    rotation.tr_mul(&source_point(camera, &m.source, m.source_depth))
}

fn align(camera: &Intrinsics, rotation: &Matrix3<f64>, removed: Vector3<f64>, m: &Match) -> Option<Aligned> {
    let point = unrotated_point(camera, rotation, m) - removed;
    Some(Aligned { flow: camera.project(&point)? - m.target, depth: point.z })
}

/// Alignment with the imaging plane: removes rotation and `(0, 0, a_z)`. `None` behind the camera.
///
/// At the truth, with [`Convention::Consistent`]: `f = (f o a_tan) / z`.
#[must_use]
pub fn planar(camera: &Intrinsics, rotation: &Matrix3<f64>, a: &Vector3<f64>, m: &Match) -> Option<Aligned> {
    align(camera, rotation, radial_part(a), m)
}

/// Alignment with the optical axis: removes rotation and `(a_x, a_y, 0)`. `None` behind the camera.
///
/// At the truth, with [`Convention::Consistent`]: `f = -a_z / (z + a_z) (p - p0)`.
#[must_use]
pub fn axial(camera: &Intrinsics, rotation: &Matrix3<f64>, a: &Vector3<f64>, m: &Match) -> Option<Aligned> {
    align(camera, rotation, tangential_part(a), m)
}

/// Derivatives of one aligned flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignmentJacobian {
    /// With respect to `eps` in `R exp([eps]_x)`.
    pub rotation: Matrix2x3<f64>,
    /// With respect to the translation `a`; the columns that are not removed are zero.
    pub translation: Matrix2x3<f64>,
    /// With respect to the source depth.
    pub source_depth: Vector2<f64>,
}

fn jacobian(
    camera: &Intrinsics,
    rotation: &Matrix3<f64>,
    removed: Vector3<f64>,
    used: Vector3<f64>,
    m: &Match,
) -> AlignmentJacobian {
    let start = unrotated_point(camera, rotation, m);
    let q = start - removed;
    let (fu, fv) = (camera.fu / q.z, camera.fv / q.z);
    let projection = Matrix2x3::new(fu, 0.0, -fu * q.x / q.z, 0.0, fv, -fv * q.y / q.z);
    AlignmentJacobian {
        rotation: projection * hat(&start),
        translation: -projection * Matrix3::from_diagonal(&used),
        source_depth: projection * (start / m.source_depth),
    }
}

/// Derivatives of the flow of [`planar`].
#[must_use]
pub fn planar_jacobian(camera: &Intrinsics, rotation: &Matrix3<f64>, a: &Vector3<f64>, m: &Match) -> AlignmentJacobian {
    jacobian(camera, rotation, radial_part(a), Vector3::z(), m)
}

/// Derivatives of the flow of [`axial`].
#[must_use]
pub fn axial_jacobian(camera: &Intrinsics, rotation: &Matrix3<f64>, a: &Vector3<f64>, m: &Match) -> AlignmentJacobian {
    jacobian(camera, rotation, tangential_part(a), Vector3::new(1.0, 1.0, 0.0), m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::{radial::radial_flow, rigid::rigid_flow, tangential::tangential_flow};
    use crate::{so3, testing};
    use proptest::prelude::*;

    fn perfect_match(camera: &Intrinsics, motion: &Se3, p: Vector2<f64>, z: f64) -> Match {
        let (flow, source_depth) = rigid_flow(camera, motion, &p, z).unwrap();
        Match { target: p, source: p + flow, source_depth }
    }

    #[test]
    fn reference_pixel_in_both_conventions() {
        let (scene, motion) = (testing::room(), testing::handheld());
        let m = perfect_match(&scene.camera, &motion, scene.pixels[100], scene.depths[100]);
        let expected = [
            (Convention::Consistent, [5.50098096764, 3.68565724832], [-3.42761755499, -1.63442253984]),
            (Convention::AsPrinted, [5.32409395425, 3.60236651532], [-3.7131295388, -1.96920494175]),
        ];
        for (convention, pla, axi) in expected {
            let a = convention.translation(&motion);
            let plane = planar(&scene.camera, &motion.rotation, &a, &m).unwrap();
            let axis = axial(&scene.camera, &motion.rotation, &a, &m).unwrap();
            assert!((plane.flow - Vector2::from(pla)).norm() < 1e-9, "{convention:?}");
            assert!((axis.flow - Vector2::from(axi)).norm() < 1e-9, "{convention:?}");
        }
    }

    #[test]
    fn jacobians_match_reference_values() {
        let (scene, truth) = (testing::room(), testing::handheld());
        let mut m = perfect_match(&scene.camera, &truth, scene.pixels[100], scene.depths[100]);
        m.source_depth *= 1.03;
        let (r, a) = (so3::exp(&Vector3::new(0.032, -0.047, 0.021)), Vector3::new(0.066, 0.037, -0.085));
        let flow = planar(&scene.camera, &r, &a, &m).unwrap().flow;
        assert!((flow - Vector2::new(4.19141304797, 4.63037185311)).norm() < 1e-9);
        let pla = planar_jacobian(&scene.camera, &r, &a, &m);
        assert!((pla.translation.column(2) - Vector2::new(-39.9151020004, -18.447246261)).norm() < 1e-8);
        assert!((pla.source_depth - Vector2::new(-0.7935029307689584, -0.36672695894860047)).norm() < 1e-10);
        let axi = axial_jacobian(&scene.camera, &r, &a, &m);
        let row = axi.rotation.row(0).transpose() - Vector3::new(39.6614409565, -486.24625546, -84.0476472354);
        assert!(row.norm() < 1e-7);
        assert_eq!(pla.translation.column(0).norm() + axi.translation.column(2).norm(), 0.0);
    }

    proptest! {
        #[test]
        fn consistent_alignment_isolates_the_two_translations(case in testing::case()) {
            let m = perfect_match(&case.camera, &case.motion, case.pixel, case.depth);
            let a = Convention::Consistent.translation(&case.motion);
            let plane = planar(&case.camera, &case.motion.rotation, &a, &m).unwrap();
            let axis = axial(&case.camera, &case.motion.rotation, &a, &m).unwrap();
            prop_assert!((plane.flow - tangential_flow(&case.camera, &a, case.depth)).norm() < 1e-9);
            prop_assert!((axis.flow - radial_flow(&case.camera, a.z, &case.pixel, case.depth).unwrap()).norm() < 1e-9);
            prop_assert!((plane.depth - case.depth).abs() < 1e-12 * case.depth);
            prop_assert!((axis.depth - case.depth - a.z).abs() < 1e-12 * case.depth);
        }

        #[test]
        fn printed_alignment_has_the_stated_residual(case in testing::case()) {
            let m = perfect_match(&case.camera, &case.motion, case.pixel, case.depth);
            let (t, in_target) = (case.motion.translation, case.motion.translation_in_from_frame());
            let delta = in_target - t;
            prop_assume!(case.depth + delta.z > 0.1 * case.depth);
            let plane = planar(&case.camera, &case.motion.rotation, &t, &m).unwrap();
            let shifted = tangential_part(&in_target) + radial_part(&delta);
            let expected = crate::flow::translational::translational_flow(&case.camera, &shifted, &case.pixel, case.depth).unwrap();
            prop_assert!((plane.flow - expected).norm() < 1e-8);
        }

        #[test]
        fn jacobians_match_central_differences(case in testing::case(), bend in prop::array::uniform3(-0.02f64..0.02), c in 0.9f64..1.1) {
            let mut m = perfect_match(&case.camera, &case.motion, case.pixel, case.depth);
            m.source_depth *= c;
            let r = case.motion.rotation * so3::exp(&Vector3::from(bend));
            let a = case.motion.translation_in_from_frame() * 1.05;
            type Align = fn(&Intrinsics, &Matrix3<f64>, &Vector3<f64>, &Match) -> Option<Aligned>;
            type Jac = fn(&Intrinsics, &Matrix3<f64>, &Vector3<f64>, &Match) -> AlignmentJacobian;
            for (f, jac) in [(planar as Align, planar_jacobian as Jac), (axial, axial_jacobian)] {
                let j = jac(&case.camera, &r, &a, &m);
                let h = 1e-6;
                for k in 0..3 {
                    let e = Vector3::ith(k, h);
                    let at = |e: Vector3<f64>| f(&case.camera, &(r * so3::exp(&e)), &a, &m).unwrap().flow;
                    let numeric = (at(e) - at(-e)) / (2.0 * h);
                    prop_assert!((numeric - j.rotation.column(k)).norm() < 1e-5 * (1.0 + numeric.norm()));
                    let e = e * case.depth;
                    let at = |e: Vector3<f64>| f(&case.camera, &r, &(a + e), &m).unwrap().flow;
                    let numeric = (at(e) - at(-e)) / (2.0 * h * case.depth);
                    prop_assert!((numeric - j.translation.column(k)).norm() < 1e-5 * (1.0 + numeric.norm()));
                }
                let at = |s: f64| f(&case.camera, &r, &a, &Match { source_depth: m.source_depth * s, ..m }).unwrap().flow;
                let numeric = (at(1.0 + h) - at(1.0 - h)) / (2.0 * h * m.source_depth);
                prop_assert!((numeric - j.source_depth).norm() < 1e-5 * (1.0 + numeric.norm()));
            }
        }
    }
}

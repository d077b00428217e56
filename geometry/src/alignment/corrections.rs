//! Three other ways to make the alignment exact, beside splitting the translation in the target frame
//! ([`Convention::Consistent`](super::Convention::Consistent)).
//!
//! | function | what is read differently | what changes |
//! |---|---|---|
//! | [`source_to_target`] | `T` carries source points to the target | `Q = A P_s + part(a)`; eq. `p_s` takes the inverse motion |
//! | [`rotated_target`] | the target is turned first, as in eq. `transformation` | `P_s - part(t)` without `R^-1`; reference pixel `p_R`, depth `z_R` |
//! | [`moved_target`] | the target is turned and moved, as in the figure of the ideal transformation | `p_s` against `pi(R P_t + part(t))`; needs the target depth |

use nalgebra::{Vector2, Vector3};

use super::{Aligned, Match};
use crate::backprojection::source_point;
use crate::camera::Intrinsics;
use crate::homography::{rotation_homography, transfer};
use crate::motion::{radial_part, tangential_part};
use crate::se3::Se3;

/// An aligned pixel with the pixel and depth that its flow refers to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Referred {
    /// Flow after the alignment, pixels.
    pub flow: Vector2<f64>,
    /// Pixel that stands for `p_t` in the losses: radial directions are taken from `p0` to it.
    pub pixel: Vector2<f64>,
    /// Depth that stands for `z_t` in the losses.
    pub depth: f64,
}

/// The planar and the axial alignment of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignedBoth<T> {
    /// Aligned with the imaging plane.
    pub planar: T,
    /// Aligned with the optical axis.
    pub axial: T,
}

/// Correction E: the motion read as `P_t = A P_s + a`. `None` behind the camera.
///
/// **Formula**: `Q_pla = A P_s + rad(a)`, `Q_axi = A P_s + tan(a)`, flows `pi(Q) - p_t`. With `A = R^T`, `a = -R^T t` these are
/// the flows of [`Convention::Consistent`](super::Convention::Consistent).
/// **Reading**: eqs. `transformation` and `residual_rot` hold as printed; eq. `p_s` takes `(A^T, -A^T a)`, and the ratios change
/// sign: `z / a_x = -f_u / f_x`.
#[must_use]
pub fn source_to_target(camera: &Intrinsics, target_from_source: &Se3, m: &Match) -> Option<AlignedBoth<Aligned>> {
    let turned = target_from_source.rotation * source_point(camera, &m.source, m.source_depth);
    let align = |added: Vector3<f64>| {
        let point = turned + added;
        Some(Aligned { flow: camera.project(&point)? - m.target, depth: point.z })
    };
    let a = &target_from_source.translation;
    Some(AlignedBoth { planar: align(radial_part(a))?, axial: align(tangential_part(a))? })
}

/// Correction C: `[R t]` and eq. `transformation` as printed, compared with the rotated target. `None` behind a camera.
///
/// **Formula**: `p_R = pi(H p~_t)`, `z_R = z_t h_3 p~_t`; `f_pla = pi(P_s - rad(t)) - p_R = f o t_tan / z_R`,
/// `f_axi = pi(P_s - tan(t)) - p_R = -t_z / (z_R + t_z) (p_R - p0)`.
/// **Reading**: no `R^-1` in eq. `pplanar`; `p_R` and `z_R` stand for `p_t` and `z_t` in all four losses.
#[must_use]
pub fn rotated_target(
    camera: &Intrinsics,
    source_from_target: &Se3,
    m: &Match,
    target_depth: f64,
) -> Option<AlignedBoth<Referred>> {
    let (pixel, ratio) = transfer(&rotation_homography(camera, &source_from_target.rotation), &m.target)?;
    let point = source_point(camera, &m.source, m.source_depth);
    let align = |removed: Vector3<f64>| {
        Some(Referred { flow: camera.project(&(point - removed))? - pixel, pixel, depth: target_depth * ratio })
    };
    let t = &source_from_target.translation;
    Some(AlignedBoth { planar: align(radial_part(t))?, axial: align(tangential_part(t))? })
}

/// Correction C': the target point is moved instead of the source point. `None` behind a camera.
///
/// **Formula**: `f_pla = p_s - pi(R P_t + rad(t)) = f o t_tan / (z_R + t_z)`,
/// `f_axi = p_s - pi(R P_t + tan(t)) = -t_z / (z_R + t_z) (q - p0)`, `q = pi(R P_t + tan(t))`.
/// **Reading**: the figure of the ideal transformation, word for word; its deviation is eq. `residual_rot`. Needs the target
/// depth and no source depth.
#[must_use]
pub fn moved_target(
    camera: &Intrinsics,
    source_from_target: &Se3,
    m: &Match,
    target_depth: f64,
) -> Option<AlignedBoth<Referred>> {
    let turned = source_from_target.rotation * camera.ray(m.target.x, m.target.y) * target_depth;
    let align = |added: Vector3<f64>| {
        let point = turned + added;
        let pixel = camera.project(&point)?;
        Some(Referred { flow: m.source - pixel, pixel, depth: point.z })
    };
    let t = &source_from_target.translation;
    Some(AlignedBoth { planar: align(radial_part(t))?, axial: align(tangential_part(t))? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alignment::{Convention, axial, planar};
    use crate::scenes;

    #[test]
    fn all_corrections_agree_without_rotation() {
        let scene = scenes::room();
        let motion = scenes::motion([0.0; 3], [0.06, 0.04, -0.08]);
        let a = Convention::Consistent.translation(&motion);
        for (m, &z) in scene.matches(&motion).iter().zip(&scene.depths) {
            let plane = planar(&scene.camera, &motion.rotation, &a, m).unwrap().flow;
            let axis = axial(&scene.camera, &motion.rotation, &a, m).unwrap().flow;
            let e = source_to_target(&scene.camera, &motion.inverse(), m).unwrap();
            let c = rotated_target(&scene.camera, &motion, m, z).unwrap();
            assert!((e.planar.flow - plane).norm() < 1e-11 && (e.axial.flow - axis).norm() < 1e-11);
            assert!((c.planar.flow - plane).norm() < 1e-11 && (c.axial.flow - axis).norm() < 1e-11);
            let moved = moved_target(&scene.camera, &motion, m, z).unwrap();
            assert!((moved.planar.flow * moved.planar.depth - plane * z).norm() < 1e-10);
        }
    }
}

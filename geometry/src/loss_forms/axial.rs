//! Radial direction of axial flows (eq. `la`).

pub mod gradients;

use nalgebra::Vector2;

use super::mean;

fn angles(flows: &[Vector2<f64>], d: &[Vector2<f64>], cosine: impl Fn(f64) -> f64) -> f64 {
    mean(flows.iter().zip(d).map(|(f, d)| f.perp(d).abs().atan2(cosine(f.dot(d)))))
}

/// Eq. `la` as printed: mean angle between flow and `d`, radians in `[0, pi]`.
///
/// **Reading**: for a source behind the target (`a_z > 0`) the flow points toward the principal point, so
/// this is pi at the truth.
#[must_use]
pub fn printed(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> f64 {
    angles(flows, d, |dot| dot)
}

/// Mean angle between the lines of flow and `d`, radians in `[0, pi/2]`: no sign needed.
#[must_use]
pub fn folded(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> f64 {
    angles(flows, d, f64::abs)
}

/// Mean angle to the direction that the sign of `a_z` asks for: away from `p0` for `a_z < 0`.
#[must_use]
pub fn pose_sign(flows: &[Vector2<f64>], d: &[Vector2<f64>], a_z: f64) -> f64 {
    angles(flows, d, |dot| dot * -a_z.signum())
}

/// `sign(E[f . d])`: which way most of the flow points, read from the flows instead of the pose (L44).
///
/// Equals `-sign(a_z)` at the truth.
#[must_use]
pub fn sign_of_flows(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> f64 {
    mean(flows.iter().zip(d).map(|(f, d)| f.dot(d))).signum()
}

/// Mean angle to the direction that most of the flow takes ([`sign_of_flows`]).
#[must_use]
pub fn flow_sign(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> f64 {
    let sign = sign_of_flows(flows, d);
    angles(flows, d, |dot| dot * sign)
}

/// Mean squared sine of the angle between flow and radius, `E[(f x d)^2 / (f.f d.d)]`, in `[0, 1]`: smooth at the solution,
/// blind to the sign (L44).
#[must_use]
pub fn smooth(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> f64 {
    mean(flows.iter().zip(d).map(|(f, d)| f.perp(d).powi(2) / (f.norm_squared() * d.norm_squared())))
}

/// Mean distance of the flows from the radial lines, pixels: `E[|f x d| / |d|]`.
#[must_use]
pub fn perpendicular(flows: &[Vector2<f64>], d: &[Vector2<f64>]) -> f64 {
    mean(flows.iter().zip(d).map(|(f, d)| f.perp(d).abs() / d.norm()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Se3;
    use crate::alignment::{self, Match};
    use crate::flow::rigid::rigid_flow;
    use crate::testing;

    fn sweep(motion: &Se3, error: f64) -> [f64; 3] {
        let scene = testing::road();
        let mut a = motion.translation_in_from_frame();
        let a_z = a.z;
        a.x += error;
        let (mut flows, mut d) = (Vec::new(), Vec::new());
        for (p, &z) in scene.pixels.iter().zip(&scene.depths) {
            let (flow, source_depth) = rigid_flow(&scene.camera, motion, p, z).unwrap();
            let m = Match { target: *p, source: p + flow, source_depth };
            flows.push(alignment::axial(&scene.camera, &motion.rotation, &a, &m).unwrap().flow);
            d.push(p - scene.camera.principal_point());
        }
        [printed(&flows, &d), pose_sign(&flows, &d, a_z), folded(&flows, &d)]
    }

    #[test]
    fn error_sweep_matches_reference_values() {
        for (error, expected) in [
            (0.0, [0.0, 0.0, 0.0]),
            (0.01, [0.0204563938571, 0.0204563938571, 0.0204563938571]),
            (0.5, [1.0070857059398, 1.0070857059398, 0.5769091270059]),
        ] {
            let values = sweep(&testing::drive_next(), error);
            for (value, expected) in values.into_iter().zip(expected) {
                assert!((value - expected).abs() < 1e-9, "{error}: {value} {expected}");
            }
        }
    }

    #[test]
    fn printed_form_is_worst_at_the_truth_of_a_backward_source() {
        let motion = testing::drive_prev();
        let values: Vec<_> = [0.0, 0.01, 0.1].iter().map(|&e| sweep(&motion, e)).collect();
        assert!((values[0][0] - std::f64::consts::PI).abs() < 1e-9);
        assert!((values[2][0] - 2.93530112755).abs() < 1e-9);
        assert!(values[0][0] > values[1][0] && values[1][0] > values[2][0]);
        assert!(values[0][1] < values[1][1] && values[1][1] < values[2][1]);
    }

    #[test]
    fn distance_from_the_radius() {
        let d = [Vector2::new(10.0, 0.0), Vector2::new(0.0, -2.0)];
        let f = [Vector2::new(5.0, 3.0), Vector2::new(-1.0, 9.0)];
        assert!((perpendicular(&f, &d) - 2.0).abs() < 1e-15);
    }
}

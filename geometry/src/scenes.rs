//! Reference scenes and motions: what the numbers of the ledger and of the tests refer to.
//!
//! The road is seen by a KITTI-like camera of 640x192, the room by a hand-held camera of 512x288; both on a grid of every
//! sixteenth pixel, with smooth depth. The numbers of `tests/golden/derivations` were computed on them with 40 digits.

pub mod families;

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::aligned_scene::AlignedScene;
use crate::alignment::{self, Convention, Match};
use crate::camera::Intrinsics;
use crate::flow::rigid::rigid_flow;
use crate::se3::Se3;
use crate::so3;

/// Distance between neighbouring pixels of the grids.
pub const STEP: usize = 16;
const FIRST: usize = 8;

/// A camera and the depth of a grid of its pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The camera.
    pub camera: Intrinsics,
    /// Columns and rows of the grid.
    pub grid: [usize; 2],
    /// Pixels, row by row.
    pub pixels: Vec<Vector2<f64>>,
    /// Depths of the pixels, metres.
    pub depths: Vec<f64>,
}

impl Scene {
    fn new(camera: Intrinsics, grid: [usize; 2], depth: impl Fn(f64, f64) -> f64) -> Self {
        let at = |i: usize| (FIRST + STEP * i) as f64;
        let pixels: Vec<_> = (0..grid[0] * grid[1]).map(|i| Vector2::new(at(i % grid[0]), at(i / grid[0]))).collect();
        let depths = pixels.iter().map(|p| depth(p.x, p.y)).collect();
        Self { camera, grid, pixels, depths }
    }

    /// The same grid before a wall at one depth, metres.
    #[must_use]
    pub fn at_depth(&self, depth: f64) -> Self {
        Self { depths: vec![depth; self.pixels.len()], ..self.clone() }
    }

    /// Offsets `d = p - p0` of the pixels.
    #[must_use]
    pub fn offsets(&self) -> Vec<Vector2<f64>> {
        self.pixels.iter().map(|p| p - self.camera.principal_point()).collect()
    }

    /// Exact matches of all pixels under a motion `source_from_target`.
    ///
    /// **Panics** when a point comes behind the source camera.
    #[must_use]
    #[track_caller]
    pub fn matches(&self, motion: &Se3) -> Vec<Match> {
        let exact = |(p, &z): (&Vector2<f64>, &f64)| {
            let (flow, source_depth) =
                rigid_flow(&self.camera, motion, p, z).expect("every point of a scene stays in front of the camera");
            Match { target: *p, source: p + flow, source_depth }
        };
        self.pixels.iter().zip(&self.depths).map(exact).collect()
    }

    /// The scene's exact matches under a motion, aligned with that motion.
    ///
    /// **Panics** when a point comes behind a camera.
    #[must_use]
    #[track_caller]
    pub fn aligned(&self, source_from_target: &Se3, convention: Convention) -> AlignedScene {
        let translation = convention.translation(source_from_target);
        AlignedScene::new(&self.camera, &source_from_target.rotation, &translation, &self.matches(source_from_target))
            .expect("aligned points stay in front of the camera")
    }

    /// The camera of an image whose pixels are those of the grid: it sees pixel `(i, j)` where [`Scene::camera`] sees
    /// `8 + 16 i`, `8 + 16 j`. Its flows are shorter by the factor [`STEP`], the angles between them the same.
    #[must_use]
    pub fn grid_camera(&self) -> Intrinsics {
        let (k, step, first) = (&self.camera, STEP as f64, FIRST as f64);
        let [width, height] = self.grid;
        Intrinsics { fu: k.fu / step, fv: k.fv / step, u0: (k.u0 - first) / step, v0: (k.v0 - first) / step, width, height }
    }
}

/// 640x192 camera with the usual KITTI proportions.
#[must_use]
pub fn kitti640() -> Intrinsics {
    Intrinsics { fu: 371.2, fv: 368.64, u0: 320.0, v0: 96.0, width: 640, height: 192 }
}

/// 512x288 hand-held camera.
#[must_use]
pub fn hand512() -> Intrinsics {
    Intrinsics { fu: 400.0, fv: 402.0, u0: 255.5, v0: 143.5, width: 512, height: 288 }
}

/// Street-like depths, 3.7 to 58 m, on 40x12 pixels of [`kitti640`].
#[must_use]
pub fn road() -> Scene {
    Scene::new(kitti640(), [40, 12], |u, v| {
        let e = 0.6 * (0.011 * u + 0.4).sin() + 0.5 * (0.023 * v - 0.3).cos() + 0.3 * (0.007 * (u + 2.0 * v)).sin();
        15.0 * e.exp()
    })
}

/// Room-like depths, 1.8 to 6.1 m, on 32x18 pixels of [`hand512`].
#[must_use]
pub fn room() -> Scene {
    Scene::new(hand512(), [32, 18], |u, v| {
        let e = 0.35 * (0.013 * u + 0.2).sin() + 0.3 * (0.017 * v + 0.5).cos() + 0.15 * (0.009 * (u - v)).sin();
        3.0 * e.exp()
    })
}

/// A motion with the scene it is looked at in.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Its name.
    pub name: &'static str,
    /// [`road`] or [`room`].
    pub scene: Scene,
    /// `source_from_target`.
    pub motion: Se3,
}

/// `source_from_target` of a rotation vector, radians, and a translation in the target frame, metres.
#[must_use]
pub fn motion(omega: [f64; 3], in_target: [f64; 3]) -> Se3 {
    let rotation = so3::exp(&Vector3::from(omega));
    Se3 { rotation, translation: rotation * Vector3::from(in_target) }
}

/// Forward driving, source ahead of the target.
#[must_use]
pub fn drive_next() -> Reference {
    Reference { name: "drive_next", scene: road(), motion: motion([0.001, 0.004, -0.0005], [0.02, -0.01, -0.8]) }
}

/// Forward driving, source behind the target.
#[must_use]
pub fn drive_prev() -> Reference {
    Reference { name: "drive_prev", scene: road(), motion: motion([-0.001, -0.004, 0.0005], [-0.017, 0.011, 0.8]) }
}

/// Driving through a bend, two degrees a frame.
#[must_use]
pub fn turn() -> Reference {
    Reference { name: "turn", scene: road(), motion: motion([0.002, 0.035, 0.001], [0.03, -0.008, -0.75]) }
}

/// Hand-held motion.
#[must_use]
pub fn handheld() -> Reference {
    Reference { name: "handheld", scene: room(), motion: motion([0.03, -0.05, 0.02], [0.06, 0.04, -0.08]) }
}

/// Sideways motion.
#[must_use]
pub fn lateral() -> Reference {
    Reference { name: "lateral", scene: room(), motion: motion([0.004, 0.006, -0.003], [0.12, 0.015, 0.02]) }
}

/// A large motion with all components.
#[must_use]
pub fn generic() -> Reference {
    Reference { name: "generic", scene: room(), motion: motion([0.01, -0.02, 0.015], [0.25, 0.18, -0.4]) }
}

/// All six, in the order above.
#[must_use]
pub fn references() -> [Reference; 6] {
    [drive_next(), drive_prev(), turn(), handheld(), lateral(), generic()]
}

/// What a network in training could say of a scene: exact flow, but depths and motion that are off.
#[derive(Clone, Debug, PartialEq)]
pub struct Perturbed {
    /// The scene with its true target depths.
    pub scene: Scene,
    /// Estimated rotation vector of `source_from_target`, radians.
    pub omega: Vector3<f64>,
    /// Estimated translation in the target frame, `t'`, metres.
    pub in_target: Vector3<f64>,
    /// Estimated target depths, metres.
    pub target_depths: Vec<f64>,
    /// The exact flow with estimated source depths.
    pub matches: Vec<Match>,
}

impl Perturbed {
    /// All estimates are the truth.
    #[must_use]
    pub fn exact(reference: &Reference) -> Self {
        Self {
            scene: reference.scene.clone(),
            omega: so3::log(&reference.motion.rotation),
            in_target: reference.motion.translation_in_from_frame(),
            target_depths: reference.scene.depths.clone(),
            matches: reference.scene.matches(&reference.motion),
        }
    }

    /// The same with target depths multiplied by `factor(p)`.
    #[must_use]
    pub fn with_target_depths(self, factor: impl Fn(&Vector2<f64>) -> f64) -> Self {
        let target_depths = self.scene.pixels.iter().zip(&self.scene.depths).map(|(p, z)| z * factor(p)).collect();
        Self { target_depths, ..self }
    }

    /// An estimated motion, and relative errors of the depths in waves of these heights.
    ///
    /// Target depths are `1 + a sin(0.05 u + 0.03 v)` times the truth, source depths `1 + b cos(0.03 u - 0.04 v)` times, both at
    /// the target pixel `(u, v)`.
    #[must_use]
    pub fn new(reference: &Reference, omega: Vector3<f64>, in_target: Vector3<f64>, [a, b]: [f64; 2]) -> Self {
        let mut out = Self::exact(reference).with_target_depths(|p| 1.0 + a * target_wave(p));
        out.matches.iter_mut().for_each(|m| m.source_depth *= 1.0 + b * (0.03 * m.target.x - 0.04 * m.target.y).cos());
        Self { omega, in_target, ..out }
    }

    /// Errors from numbers in `[-1, 1]`: up to 0.003 rad about each axis, 10 % of each component of `t'`, 5 % of the depths.
    #[must_use]
    pub fn drawn(reference: &Reference, x: &[f64; 8]) -> Self {
        let (omega, t) = (so3::log(&reference.motion.rotation), reference.motion.translation_in_from_frame());
        let omega = omega + Vector3::new(x[0], x[1], x[2]) * 0.003;
        let in_target = Vector3::from_fn(|k, _| t[k] * (1.0 + 0.1 * x[3 + k]));
        Self::new(reference, omega, in_target, [0.05 * x[6], 0.05 * x[7]])
    }

    /// Estimated target depths, source depths and translation multiplied by one factor each.
    #[must_use]
    pub fn scaled(&self, target: f64, source: f64, translation: f64) -> Self {
        let mut out = self.clone();
        out.target_depths.iter_mut().for_each(|z| *z *= target);
        out.matches.iter_mut().for_each(|m| m.source_depth *= source);
        Self { in_target: self.in_target * translation, ..out }
    }

    /// Estimated rotation of `source_from_target`.
    #[must_use]
    pub fn rotation(&self) -> Matrix3<f64> {
        so3::exp(&self.omega)
    }

    /// Planar flows of all pixels under the estimates, consistent convention.
    ///
    /// **Panics** when a point comes behind the camera.
    #[must_use]
    #[track_caller]
    pub fn planar_flows(&self) -> Vec<Vector2<f64>> {
        self.aligned(alignment::planar)
    }

    /// As [`Perturbed::planar_flows`], the axial ones.
    #[must_use]
    #[track_caller]
    pub fn axial_flows(&self) -> Vec<Vector2<f64>> {
        self.aligned(alignment::axial)
    }

    #[track_caller]
    fn aligned(
        &self,
        align: fn(&Intrinsics, &Matrix3<f64>, &Vector3<f64>, &Match) -> Option<alignment::Aligned>,
    ) -> Vec<Vector2<f64>> {
        let rotation = self.rotation();
        let flow = |m: &Match| align(&self.scene.camera, &rotation, &self.in_target, m).map(|a| a.flow);
        self.matches.iter().map(|m| flow(m).expect("every point of a scene stays in front of the camera")).collect()
    }
}

/// `sin(0.05 u + 0.03 v)`, the wave in which estimated target depths err.
#[must_use]
pub fn target_wave(p: &Vector2<f64>) -> f64 {
    (0.05 * p.x + 0.03 * p.y).sin()
}

/// [`handheld`] with estimates that are far off.
#[must_use]
pub fn perturbed_handheld() -> Perturbed {
    let (omega, in_target) = (Vector3::new(0.032, -0.047, 0.021), Vector3::new(0.066, 0.037, -0.085));
    Perturbed::new(&handheld(), omega, in_target, [0.05, 0.04])
}

/// [`generic`] with estimates that are a little off.
#[must_use]
pub fn perturbed_generic() -> Perturbed {
    let (omega, in_target) = (Vector3::new(0.0105, -0.0192, 0.0153), Vector3::new(0.256, 0.176, -0.41));
    Perturbed::new(&generic(), omega, in_target, [0.02, 0.01])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_lie_where_the_scenes_say() {
        let range = |s: &Scene| s.depths.iter().fold((f64::INFINITY, 0.0f64), |(a, b), &z| (a.min(z), b.max(z)));
        let (near, far) = range(&road());
        assert!((near - 3.7).abs() < 0.1 && (far - 58.0).abs() < 1.0, "{near} {far}");
        let (near, far) = range(&room());
        assert!((near - 1.8).abs() < 0.1 && (far - 6.1).abs() < 0.1, "{near} {far}");
        assert_eq!(room().pixels[100], Vector2::new(72.0, 56.0));
        assert!((room().depths[100] - 4.362858214052638).abs() < 1e-14);
    }

    #[test]
    fn estimates_without_error_align_exactly_and_errors_lie_where_they_say() {
        let reference = handheld();
        let exact = Perturbed::exact(&reference);
        let t = exact.in_target;
        for (i, (plane, axis)) in exact.planar_flows().iter().zip(exact.axial_flows()).enumerate() {
            let (d, z) = (exact.scene.offsets()[i], exact.scene.depths[i]);
            assert!((plane - crate::flow::tangential::tangential_flow(&exact.scene.camera, &t, z)).norm() < 1e-10);
            assert!((axis + d * (t.z / (z + t.z))).norm() < 1e-10);
        }
        let off = perturbed_handheld();
        let p = off.scene.pixels[100];
        assert!((off.target_depths[100] / exact.target_depths[100] - 1.0 - 0.05 * target_wave(&p)).abs() < 1e-15);
        let source = off.matches[100].source_depth / exact.matches[100].source_depth;
        assert!((source - 1.0 - 0.04 * (0.03 * p.x - 0.04 * p.y).cos()).abs() < 1e-15);
        assert_eq!(off.matches[100].source, exact.matches[100].source);
    }

    #[test]
    fn drawn_errors_keep_their_bounds_and_vanish_at_zero() {
        let reference = turn();
        let exact = Perturbed::exact(&reference);
        assert_eq!(Perturbed::drawn(&reference, &[0.0; 8]), exact);
        let far = Perturbed::drawn(&reference, &[1.0; 8]);
        assert!(((far.omega - exact.omega) / 0.003 - Vector3::repeat(1.0)).norm() < 1e-9);
        assert!((far.in_target - exact.in_target * 1.1).norm() < 1e-15);
        let error = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
        let target = error(&far.target_depths, &exact.target_depths);
        assert!(target > 0.049 && target < 0.05 + 1e-15, "{target}");
        let scaled = far.scaled(2.0, 3.0, 5.0);
        assert_eq!(scaled.target_depths[7], 2.0 * far.target_depths[7]);
        assert_eq!(scaled.matches[7].source_depth, 3.0 * far.matches[7].source_depth);
        assert_eq!(scaled.in_target, far.in_target * 5.0);
    }

    #[test]
    fn the_grid_camera_sees_the_same_rays() {
        for scene in [road(), room()] {
            let small = scene.grid_camera();
            let p = scene.pixels[scene.grid[0] + 3];
            assert!((small.ray(3.0, 1.0) - scene.camera.ray(p.x, p.y)).norm() < 1e-15);
        }
    }
}

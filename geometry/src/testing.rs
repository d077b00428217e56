//! Cameras, scenes and random cases shared by the unit tests.

use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

use crate::{Intrinsics, Se3};

/// 640x192 camera with the usual KITTI proportions.
pub fn kitti640() -> Intrinsics {
    Intrinsics::new(371.2, 368.64, 320.0, 96.0, 640, 192).unwrap()
}

/// 512x288 hand-held camera.
pub fn hand512() -> Intrinsics {
    Intrinsics::new(400.0, 402.0, 255.5, 143.5, 512, 288).unwrap()
}

/// A camera, a pixel with depth, and a motion that keeps it in front of both cameras.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub camera: Intrinsics,
    pub pixel: Vector2<f64>,
    pub depth: f64,
    pub motion: Se3,
}

/// Focal lengths 100 to 1000, depth 0.5 to 80 (log-uniform), rotation up to 0.2 rad, translation up
/// to 0.3 of the depth.
pub fn case() -> impl Strategy<Value = Case> {
    let camera = (100.0f64..1000.0, 100.0f64..1000.0, 0.4f64..0.6, 0.4f64..0.6);
    let pixel = (0.0f64..640.0, 0.0f64..192.0, (0.5f64).ln()..(80.0f64).ln());
    let motion = (prop::array::uniform3(-1.0f64..1.0), 0.0f64..0.2, prop::array::uniform3(-1.0f64..1.0), 0.0f64..0.3);
    (camera, pixel, motion).prop_filter_map(
        "degenerate direction or ray behind",
        |(c, (u, v, log_z), (axis, angle, dir, size))| {
            let (axis, dir) = (Vector3::from(axis), Vector3::from(dir));
            if axis.norm() < 0.05 || dir.norm() < 0.05 {
                return None;
            }
            let camera = Intrinsics::new(c.0, c.1, c.2 * 640.0, c.3 * 192.0, 640, 192).ok()?;
            let depth = log_z.exp();
            let motion = Se3::from_rotation_vector(&(axis.normalize() * angle), dir.normalize() * size * depth);
            let case = Case { camera, pixel: Vector2::new(u, v), depth, motion };
            ((motion.rotation * camera.ray(u, v)).z > 0.35).then_some(case)
        },
    )
}

/// The reference scenes: pixels and depths on a coarse grid.
pub struct Scene {
    pub camera: Intrinsics,
    pub pixels: Vec<Vector2<f64>>,
    pub depths: Vec<f64>,
}

fn scene(camera: Intrinsics, nu: usize, nv: usize, depth: impl Fn(f64, f64) -> f64) -> Scene {
    let pixels: Vec<_> = (0..nu * nv).map(|i| Vector2::new((8 + 16 * (i % nu)) as f64, (8 + 16 * (i / nu)) as f64)).collect();
    let depths = pixels.iter().map(|p| depth(p.x, p.y)).collect();
    Scene { camera, pixels, depths }
}

/// Street-like depths, 3.7 to 58 m.
pub fn road() -> Scene {
    scene(kitti640(), 40, 12, |u, v| {
        let e = 0.6 * (0.011 * u + 0.4).sin() + 0.5 * (0.023 * v - 0.3).cos() + 0.3 * (0.007 * (u + 2.0 * v)).sin();
        15.0 * e.exp()
    })
}

/// Room-like depths, 1.8 to 6.1 m.
pub fn room() -> Scene {
    scene(hand512(), 32, 18, |u, v| {
        let e = 0.35 * (0.013 * u + 0.2).sin() + 0.3 * (0.017 * v + 0.5).cos() + 0.15 * (0.009 * (u - v)).sin();
        3.0 * e.exp()
    })
}

/// `source_from_target` of a motion given by rotation vector and translation in the target frame.
pub fn motion(omega: [f64; 3], in_target: [f64; 3]) -> Se3 {
    let mut m = Se3::from_rotation_vector(&Vector3::from(omega), Vector3::zeros());
    m.translation = m.rotation * Vector3::from(in_target);
    m
}

/// Forward driving, source ahead of the target (road scene).
pub fn drive_next() -> Se3 {
    motion([0.001, 0.004, -0.0005], [0.02, -0.01, -0.8])
}

/// Forward driving, source behind the target (road scene).
pub fn drive_prev() -> Se3 {
    motion([-0.001, -0.004, 0.0005], [-0.017, 0.011, 0.8])
}

/// Hand-held motion (room scene).
pub fn handheld() -> Se3 {
    motion([0.03, -0.05, 0.02], [0.06, 0.04, -0.08])
}

//! Cameras, scenes and random cases shared by the unit tests.

use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

use crate::{Intrinsics, Se3};

pub use crate::scenes::{Scene, kitti640, motion, road, room};

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

/// Forward driving, source ahead of the target (road scene).
pub fn drive_next() -> Se3 {
    crate::scenes::drive_next().motion
}

/// Forward driving, source behind the target (road scene).
pub fn drive_prev() -> Se3 {
    crate::scenes::drive_prev().motion
}

/// Hand-held motion (room scene).
pub fn handheld() -> Se3 {
    crate::scenes::handheld().motion
}

//! Families of motions with a rotation that grows: how the printed alignment's error depends on it.

use nalgebra::Vector3;

use super::{Scene, road, room};
use crate::se3::Se3;
use crate::so3;

/// The translation of a family, in the target frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heading {
    /// One direction, of any length.
    Fixed([f64; 3]),
    /// The chord of a circular arc about the vertical, camera above the rear axle: the direction turns by half of the rotation.
    Arc,
}

/// Motions about one axis, seen in one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Family {
    /// Its name.
    pub name: &'static str,
    /// [`road`] or [`room`].
    pub scene: Scene,
    /// Axis of the rotation, of any length.
    pub axis: [f64; 3],
    /// Direction of the translation.
    pub heading: Heading,
}

impl Family {
    /// Motion with a rotation of `angle` radians and a translation of `length` metres.
    #[must_use]
    pub fn motion(&self, angle: f64, length: f64) -> Se3 {
        let direction = match self.heading {
            Heading::Fixed(direction) => Vector3::from(direction).normalize(),
            Heading::Arc => Vector3::new((angle / 2.0).sin(), 0.0, -(angle / 2.0).cos()),
        };
        let rotation = so3::exp(&(Vector3::from(self.axis).normalize() * angle));
        Se3 { rotation, translation: rotation * direction * length }
    }
}

/// Driving straight while the camera yaws.
#[must_use]
pub fn driving_yaw() -> Family {
    Family { name: "driving_yaw", scene: road(), axis: [0.0, 1.0, 0.0], heading: Heading::Fixed([0.02, -0.01, -1.0]) }
}

/// Driving along a circular arc.
#[must_use]
pub fn driving_arc() -> Family {
    Family { name: "driving_arc", scene: road(), axis: [0.0, 1.0, 0.0], heading: Heading::Arc }
}

/// Driving straight while the camera pitches.
#[must_use]
pub fn driving_pitch() -> Family {
    Family { name: "driving_pitch", scene: road(), axis: [1.0, 0.0, 0.0], heading: Heading::Fixed([0.02, -0.01, -1.0]) }
}

/// Hand-held, diagonal.
#[must_use]
pub fn handheld() -> Family {
    Family { name: "handheld", scene: room(), axis: [0.6, 0.64, 0.48], heading: Heading::Fixed([0.55, 0.45, -0.70]) }
}

/// Sideways.
#[must_use]
pub fn lateral() -> Family {
    Family { name: "lateral", scene: room(), axis: [0.6, 0.64, 0.48], heading: Heading::Fixed([0.98, 0.15, 0.12]) }
}

/// All five, in the order above.
#[must_use]
pub fn all() -> [Family; 5] {
    [driving_yaw(), driving_arc(), driving_pitch(), handheld(), lateral()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chord_of_an_arc_turns_its_sideways_part_over() {
        let motion = driving_arc().motion(0.1, 2.0);
        let (t, in_target) = (motion.translation, motion.translation_in_from_frame());
        assert!((t.x + in_target.x).abs() < 1e-15 && (t.z - in_target.z).abs() < 1e-15);
        assert!((t.norm() - 2.0).abs() < 1e-14 && t.z < -1.9);
    }
}

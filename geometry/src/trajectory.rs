//! Camera trajectories and their text files.
//!
//! A pose is `world_from_camera` (KITTI: x right, y down, z forward). Two file forms are read and
//! written: KITTI (12 numbers a line, or 13 with the frame index first) and TUM
//! (`stamp tx ty tz qx qy qz qw`).

mod kitti;
mod text;
mod tum;

use nalgebra::Vector3;

use crate::se3::Se3;

/// Largest entry of `R^T R - I` accepted from a text file.
pub const ROTATION_TOLERANCE: f64 = 1e-4;
/// Largest distance of a quaternion's length from 1 accepted from a text file.
pub const QUATERNION_TOLERANCE: f64 = 1e-2;

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Frame index within the sequence.
    pub index: usize,
    /// Time in seconds, where the file has one.
    pub stamp: Option<f64>,
    /// Carries camera-frame points to the world.
    pub world_from_camera: Se3,
}

/// Poses in rising order of their frame index.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// The poses.
    pub poses: Vec<StampedPose>,
}

impl Trajectory {
    /// Poses with indices 0, 1, 2 and so on.
    #[must_use]
    pub fn from_poses(world_from_camera: impl IntoIterator<Item = Se3>) -> Self {
        let poses = world_from_camera
            .into_iter()
            .enumerate()
            .map(|(index, world_from_camera)| StampedPose { index, stamp: None, world_from_camera })
            .collect();
        Self { poses }
    }

    /// Chains motions between neighbouring frames.
    ///
    /// `steps[i]` is the `source_from_target` of target frame `i` and source frame `i + 1`;
    /// `W_0 = I`, `W_{i+1} = W_i T_i^-1`. The result has one pose more than there are steps.
    #[must_use]
    pub fn accumulate(steps: &[Se3]) -> Self {
        let mut world_from_camera = Se3::identity();
        let mut poses = vec![world_from_camera];
        for source_from_target in steps {
            world_from_camera = world_from_camera * source_from_target.inverse();
            poses.push(world_from_camera);
        }
        Self::from_poses(poses)
    }

    /// Number of poses.
    #[must_use]
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Camera centres in the world, in order.
    #[must_use]
    pub fn positions(&self) -> Vec<Vector3<f64>> {
        self.poses.iter().map(|p| p.world_from_camera.translation).collect()
    }

    /// The pose of frame `index`.
    #[must_use]
    pub fn pose(&self, index: usize) -> Option<&Se3> {
        let at = self.poses.binary_search_by_key(&index, |p| p.index).ok()?;
        Some(&self.poses[at].world_from_camera)
    }

    /// Motion from frame `target` to frame `source` (`source_from_target`), if both exist.
    #[must_use]
    pub fn source_from_target(&self, target: usize, source: usize) -> Option<Se3> {
        Some(self.pose(source)?.inverse() * *self.pose(target)?)
    }

    /// The same trajectory seen from its first camera, so that the first pose is the identity.
    #[must_use]
    pub fn anchored_at_first(&self) -> Self {
        let Some(first) = self.poses.first() else {
            return Self::default();
        };
        let camera_from_world = first.world_from_camera.inverse();
        let poses =
            self.poses.iter().map(|p| StampedPose { world_from_camera: camera_from_world * p.world_from_camera, ..*p }).collect();
        Self { poses }
    }

    /// Length of the polyline through the camera centres, in the units of the translations.
    #[must_use]
    pub fn path_length(&self) -> f64 {
        self.positions().windows(2).map(|w| (w[1] - w[0]).norm()).sum()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    pub(super) fn steps() -> Vec<Se3> {
        (0..7)
            .map(|i| {
                let x = f64::from(i);
                Se3::from_rotation_vector(&Vector3::new(0.02 * x, -0.05, 0.01), Vector3::new(0.1, 0.02 * x, -1.0))
            })
            .collect()
    }

    pub(super) fn gap(a: &Trajectory, b: &Trajectory) -> f64 {
        assert_eq!(a.len(), b.len());
        a.poses
            .iter()
            .zip(&b.poses)
            .map(|(a, b)| {
                assert_eq!(a.index, b.index);
                let (a, b) = (a.world_from_camera, b.world_from_camera);
                (a.rotation - b.rotation).abs().max() + (a.translation - b.translation).norm()
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn straight_driving_moves_forward() {
        // The source lies one metre ahead: its points are one metre nearer.
        let step = Se3::from_rotation_vector(&Vector3::zeros(), Vector3::new(0.0, 0.0, -1.0));
        let trajectory = Trajectory::accumulate(&[step; 3]);
        assert_eq!(trajectory.positions()[3], Vector3::new(0.0, 0.0, 3.0));
        assert_eq!(trajectory.path_length(), 3.0);
    }

    #[test]
    fn steps_come_back_from_the_trajectory() {
        let trajectory = Trajectory::accumulate(&steps());
        for (i, step) in steps().iter().enumerate() {
            let back = trajectory.source_from_target(i, i + 1).unwrap();
            assert!((back.rotation - step.rotation).abs().max() < 1e-14);
            assert!((back.translation - step.translation).norm() < 1e-13);
        }
        assert!(trajectory.source_from_target(0, 8).is_none());
    }

    #[test]
    fn anchoring_puts_the_first_camera_at_the_origin() {
        let moved = Trajectory::from_poses(Trajectory::accumulate(&steps()).poses[2..].iter().map(|p| p.world_from_camera));
        let anchored = moved.anchored_at_first();
        assert!((anchored.poses[0].world_from_camera.rotation - Matrix3::identity()).abs().max() < 1e-14);
        assert!((anchored.path_length() - moved.path_length()).abs() < 1e-12);
        assert!(Trajectory::default().anchored_at_first().is_empty());
    }
}

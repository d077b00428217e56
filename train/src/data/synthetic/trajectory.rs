//! Camera paths: a drive, a hand-held walk, a sideways slide. All are smooth random functions of the frame number.

use dimode_geometry::Se3;
use nalgebra::{Matrix3, Vector2, Vector3};

use super::face::rotation_y;
use super::random::{Draw, Smooth};
use super::road::PathPoint;

/// Frames driven before the first frame, so that there is a road behind the camera.
const FRAMES_BEFORE: usize = 25;
/// Metres of road beyond the last frame.
const METRES_AFTER: f64 = 55.0;
/// Metres from the rear axle forward to the camera.
const LEVER: f64 = 1.3;

/// Camera orientation from heading, pitch (positive: up) and roll, radians: first roll, then pitch, then heading.
pub fn orientation(heading: f64, pitch: f64, roll: f64) -> Matrix3<f64> {
    let ((sp, cp), (sr, cr)) = (pitch.sin_cos(), roll.sin_cos());
    let about_x = Matrix3::new(1.0, 0.0, 0.0, 0.0, cp, -sp, 0.0, sp, cp);
    let about_z = Matrix3::new(cr, -sr, 0.0, sr, cr, 0.0, 0.0, 0.0, 1.0);
    rotation_y(heading) * about_x * about_z
}

/// A drive: the road it defines and the camera poses.
pub struct Drive {
    /// The rear axle's path without weaving, from behind the first frame to beyond the last, one point a frame step.
    pub path: Vec<PathPoint>,
    /// World from camera, one a frame.
    pub poses: Vec<Se3>,
    /// Index in `path` of the first frame.
    pub first: usize,
}

/// Yaw rate of the drive, degrees a frame.
struct Steering {
    gentle: Smooth,
    /// (middle frame, half duration in frames, peak in degrees a frame)
    turns: Vec<[f64; 3]>,
}

impl Steering {
    fn new(draw: &mut Draw, steps: usize) -> Self {
        let gentle = Smooth::new(draw, 6, 14.0, 70.0);
        let mut turns = Vec::new();
        let mut start = draw.range(-40.0, 10.0);
        while start < steps as f64 {
            let half = draw.range(6.0, 10.0);
            turns.push([start + half, half, draw.sign() * draw.range(1.4, 2.8)]);
            start += 2.0 * half + draw.range(25.0, 90.0);
        }
        Self { gentle, turns }
    }

    fn at(&self, step: f64) -> f64 {
        let turn: f64 = self
            .turns
            .iter()
            .filter(|[middle, half, _]| (step - middle).abs() < *half)
            .map(|[middle, half, peak]| 0.5 * peak * (1.0 + (std::f64::consts::PI * (step - middle) / half).cos()))
            .sum();
        1.7 * (0.63 * self.gentle.at(step)).tanh() + turn
    }
}

/// A random drive of `frames` frames: 0.3 to 0.9 m a frame, yaw as a car steers it, the camera ahead of the rear axle at
/// 1.3 to 2.2 m, weaving sideways and bobbing.
pub fn drive(draw: &mut Draw, frames: usize) -> Drive {
    let steering = Steering::new(draw, FRAMES_BEFORE + frames + 200);
    let (cruise, speed) = (draw.range(0.45, 0.75), Smooth::new(draw, 3, 25.0, 90.0));
    let speed_at = |step: f64| (cruise + 0.13 * speed.at(step)).clamp(0.32, 0.88);
    let path = drive_path(frames, &steering, speed_at);
    let height = draw.range(1.3, 2.2);
    let weave = Smooth::new(draw, 4, 16.0, 34.0);
    let bob = Smooth::new(draw, 4, 8.0, 15.0);
    let [pitch, roll] = [0; 2].map(|_| Smooth::new(draw, 4, 7.0, 20.0));
    let tilt = draw.range(-3.0, 2.5f64).to_radians();
    let poses = (0..frames)
        .map(|frame| {
            let at = frame as f64;
            let point = &path[FRAMES_BEFORE + frame];
            // Weaving and bobbing follow the speed, so that a slow car does not dance.
            let ground = point.position + point.forward() * LEVER + point.right() * (0.23 * cruise * 1.6 * weave.at(at));
            let y = -height + 0.105 * cruise * 1.6 * bob.at(at);
            let jitter = 0.25f64.to_radians();
            Se3 {
                rotation: orientation(point.heading, tilt + jitter * pitch.at(at), jitter * roll.at(at)),
                translation: Vector3::new(ground.x, y, ground.y),
            }
        })
        .collect();
    Drive { path, poses, first: FRAMES_BEFORE }
}

/// Integrates speed and steering; the road beyond the last frame straightens a little.
fn drive_path(frames: usize, steering: &Steering, speed_at: impl Fn(f64) -> f64) -> Vec<PathPoint> {
    let mut path = Vec::new();
    let mut point = PathPoint { position: Vector2::zeros(), heading: 0.0, arc: 0.0 };
    let mut end = f64::INFINITY;
    for step in 0.. {
        path.push(point);
        if step + 1 == FRAMES_BEFORE + frames {
            end = point.arc + METRES_AFTER;
        }
        if point.arc >= end {
            break;
        }
        let beyond = step as f64 - (FRAMES_BEFORE + frames) as f64;
        let ease = 1.0 / (1.0 + (0.04 * beyond.max(0.0)).powi(2));
        let (speed, yaw) = (speed_at(step as f64), ease * steering.at(step as f64).to_radians());
        let middle = point.heading + 0.5 * yaw;
        point.position += speed * Vector2::new(middle.sin(), middle.cos());
        point.heading += yaw;
        point.arc += speed;
    }
    path
}

/// A point that walks along a smooth closed-form curve in steps of given length.
struct Walker {
    parameter: f64,
}

impl Walker {
    /// Moves on until `distance(from, to)` of the curve at both parameters reaches `length`; returns the new parameter.
    fn advance(&mut self, length: f64, distance: impl Fn(f64, f64) -> f64) -> f64 {
        let start = self.parameter;
        let mut high = start + 0.02;
        while distance(start, high) < length && high < start + 40.0 {
            high += 0.02;
        }
        let mut low = high - 0.02;
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if distance(start, middle) < length {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.parameter = high;
        high
    }
}

/// A hand-held walk within `reach` metres (half extents) of the origin: steps of 0.04 to 0.25 m in any direction, 1.5 to 5
/// degrees a frame about any axis.
pub fn walk(draw: &mut Draw, frames: usize, reach: Vector3<f64>) -> Vec<Se3> {
    let axes = [(); 3].map(|()| Smooth::new(draw, 3, 18.0, 50.0));
    let position = |t: f64| Vector3::from_fn(|i, _| reach[i] * axes[i].bounded(t));
    let turn = draw.range(0.0, std::f64::consts::TAU);
    let angles = [(); 3].map(|()| Smooth::new(draw, 3, 22.0, 70.0));
    let rotation = |t: f64| {
        let [yaw, pitch, roll] = [0, 1, 2].map(|i| angles[i].at(t));
        orientation(turn + 0.95 * yaw, 0.42 * pitch.tanh() * 1.2, 0.42 * roll.tanh() * 1.2)
    };
    let (pace, spin) = (Smooth::new(draw, 3, 15.0, 50.0), Smooth::new(draw, 3, 15.0, 50.0));
    let (mut at, mut facing) = (Walker { parameter: 0.0 }, Walker { parameter: 0.0 });
    (0..frames)
        .map(|frame| {
            if frame > 0 {
                let t = frame as f64;
                let length = (0.13 + 0.06 * pace.at(t)).clamp(0.045, 0.24);
                at.advance(length, |a, b| (position(a) - position(b)).norm());
                let angle = (3.0 + 1.0 * spin.at(t)).clamp(1.55, 4.9).to_radians();
                facing.advance(angle, |a, b| angle_between(&rotation(a), &rotation(b)));
            }
            Se3 { rotation: rotation(facing.parameter), translation: position(at.parameter) }
        })
        .collect()
}

/// Angle of the rotation between two orientations, radians.
pub fn angle_between(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    // Through the chord, exact for small angles: |a - b| = 2 sqrt(2) sin(angle / 2).
    2.0 * ((a - b).norm() / 8f64.sqrt()).clamp(0.0, 1.0).asin()
}

/// A sideways slide along world x, to one side for the whole sequence: 0.1 to 0.5 m a frame, drifting a little up, down,
/// forward and back, turning less than half a degree a frame.
pub fn slide(draw: &mut Draw, frames: usize) -> Vec<Se3> {
    let side = draw.sign();
    let (cruise, pace) = (draw.range(0.18, 0.42), Smooth::new(draw, 3, 15.0, 60.0));
    let [forward, vertical] = [0; 2].map(|_| Smooth::new(draw, 3, 20.0, 50.0));
    let angles = [(); 3].map(|()| Smooth::new(draw, 3, 14.0, 45.0));
    let height = draw.range(1.3, 1.9);
    let mut x = 0.0;
    (0..frames)
        .map(|frame| {
            let t = frame as f64;
            if frame > 0 {
                x += side * (cruise + 0.07 * pace.at(t)).clamp(0.11, 0.47);
            }
            let [heading, pitch, roll] = [(0, 0.5f64), (1, 0.24), (2, 0.24)].map(|(i, a)| (a * angles[i].at(t)).to_radians());
            Se3 {
                rotation: orientation(heading, pitch, roll),
                translation: Vector3::new(x, -height + 0.11 * vertical.at(t), 0.22 * forward.at(t)),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientation_turns_the_right_way() {
        let forward = |h, p| orientation(h, p, 0.0) * Vector3::z();
        assert!(forward(0.3, 0.0).x > 0.0, "heading turns towards +x");
        assert!(forward(0.0, 0.3).y < 0.0, "pitch looks up, y points down");
        assert!((angle_between(&Matrix3::identity(), &orientation(0.3, 0.0, 0.0)) - 0.3).abs() < 1e-12);
    }

    #[test]
    fn drive_reaches_beyond_the_last_frame() {
        let drive = drive(&mut Draw::new(4, 0), 20);
        let last = drive.path[drive.first + 19];
        assert_eq!(drive.poses.len(), 20);
        assert!(drive.path.last().unwrap().arc > last.arc + METRES_AFTER - 1.0);
        assert!(drive.poses.iter().all(|p| p.is_orthonormal(1e-9)));
    }
}

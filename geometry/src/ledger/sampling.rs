//! Random inputs of checks: numbers from a seed, and the default case of a camera, a pixel with depth and a motion.

use dimode_autodiff::rng::splitmix64;
use nalgebra::{Vector2, Vector3};

use crate::alignment::Match;
use crate::camera::Intrinsics;
use crate::flow::rigid::rigid_flow;
use crate::se3::Se3;
use crate::so3;

/// A stream of numbers that a seed and a name determine.
#[derive(Clone, Debug)]
pub struct Draw {
    state: u64,
    index: u64,
}

impl Draw {
    /// The stream of one claim: other claims' samples do not move when the number of samples changes.
    #[must_use]
    pub fn new(seed: u64, name: &str) -> Self {
        let state = name.bytes().fold(splitmix64(seed, 0), |state, byte| splitmix64(state, u64::from(byte)));
        Self { state, index: 0 }
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        let bits = splitmix64(self.state, self.index) >> 11;
        self.index += 1;
        bits as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `[lo, hi)`.
    pub fn uniform(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Uniform in the logarithm.
    pub fn log_uniform(&mut self, lo: f64, hi: f64) -> f64 {
        self.uniform(lo.ln(), hi.ln()).exp()
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> Vector3<f64> {
        direction(self.unit(), self.unit())
    }

    /// A default [`Case`]; draws again until one is usable.
    pub fn case(&mut self) -> Case {
        loop {
            if let Some(case) = Case::from_unit(&std::array::from_fn(|_| self.unit())) {
                return case;
            }
        }
    }
}

/// The point of the unit sphere at two uniform numbers: equal areas are equally likely.
fn direction(height: f64, turn: f64) -> Vector3<f64> {
    let z = 2.0 * height - 1.0;
    let (sin, cos) = (std::f64::consts::TAU * turn).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vector3::new(r * cos, r * sin, z)
}

/// Further uniform numbers that come with a case, for what a single claim needs.
pub const EXTRA: usize = 11;

/// Numbers in `[0, 1)` that make a case.
pub const DIMENSIONS: usize = 13 + EXTRA;

/// A camera, a pixel with depth, and a motion that keeps its point in front of both cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Focal lengths 100 to 1000 px, principal point within 40 to 60 % of 640x192.
    pub camera: Intrinsics,
    /// Target pixel, anywhere in the image.
    pub pixel: Vector2<f64>,
    /// Target depth, 0.5 to 80 m, uniform in the logarithm.
    pub depth: f64,
    /// `source_from_target`: up to 0.2 rad about any axis, up to 0.3 of the depth in any direction.
    pub motion: Se3,
    /// Uniform in `[0, 1)`.
    pub extra: [f64; EXTRA],
}

impl Case {
    /// The case at a point of the unit cube; `None` where the pixel's ray comes too close to the source camera's image plane.
    #[must_use]
    pub fn from_unit(x: &[f64; DIMENSIONS]) -> Option<Self> {
        let between = |x: f64, lo: f64, hi: f64| lo + (hi - lo) * x;
        let camera = Intrinsics {
            fu: between(x[0], 100.0, 1000.0),
            fv: between(x[1], 100.0, 1000.0),
            u0: 640.0 * between(x[2], 0.4, 0.6),
            v0: 192.0 * between(x[3], 0.4, 0.6),
            width: 640,
            height: 192,
        };
        let pixel = Vector2::new(640.0 * x[4], 192.0 * x[5]);
        let depth = between(x[6], 0.5f64.ln(), 80f64.ln()).exp();
        let rotation = so3::exp(&(direction(x[7], x[8]) * (0.2 * x[9])));
        let translation = direction(x[10], x[11]) * (0.3 * x[12] * depth);
        let motion = Se3 { rotation, translation };
        let extra = std::array::from_fn(|i| x[13 + i]);
        // Depth 0.05 z at least: |t| <= 0.3 z.
        let usable = (rotation * camera.ray(pixel.x, pixel.y)).z > 0.35;
        usable.then_some(Self { camera, pixel, depth, motion, extra })
    }

    /// The point in the target camera's frame, metres.
    #[must_use]
    pub fn point(&self) -> Vector3<f64> {
        self.camera.ray(self.pixel.x, self.pixel.y) * self.depth
    }

    /// `d = p - p0`, pixels.
    #[must_use]
    pub fn offset(&self) -> Vector2<f64> {
        self.pixel - self.camera.principal_point()
    }

    /// `t' = R^T t`, the translation in the target frame.
    #[must_use]
    pub fn in_target(&self) -> Vector3<f64> {
        self.motion.translation_in_from_frame()
    }

    /// Exact flow and source depth of the pixel; `None` behind the source camera.
    #[must_use]
    pub fn exact_match(&self) -> Option<Match> {
        let (flow, source_depth) = rigid_flow(&self.camera, &self.motion, &self.pixel, self.depth)?;
        Some(Match { target: self.pixel, source: self.pixel + flow, source_depth })
    }

    /// The case with another translation in the source frame.
    #[must_use]
    pub fn with_translation(&self, t: Vector3<f64>) -> Self {
        Self { motion: Se3 { translation: t, ..self.motion }, ..*self }
    }

    /// The case without rotation.
    #[must_use]
    pub fn without_rotation(&self) -> Self {
        Self { motion: Se3 { translation: self.motion.translation, ..Se3::identity() }, ..*self }
    }

    /// A further number of the case, uniform in `[lo, hi)`.
    #[must_use]
    pub fn extra(&self, index: usize, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.extra[index]
    }

    /// A further direction, from the numbers `index` and `index + 1`.
    #[must_use]
    pub fn extra_direction(&self, index: usize) -> Vector3<f64> {
        direction(self.extra[index], self.extra[index + 1])
    }

    /// A further flow, 0.01 to 100 px long (uniform in the logarithm) and in any direction, from the numbers `index` and
    /// `index + 1`.
    #[must_use]
    pub fn extra_flow(&self, index: usize) -> Vector2<f64> {
        let length = self.extra(index, 0.01f64.ln(), 100f64.ln()).exp();
        let (sin, cos) = self.extra(index + 1, 0.0, std::f64::consts::TAU).sin_cos();
        Vector2::new(cos, sin) * length
    }

    /// Number of [`Case::limit`]s.
    pub const LIMITS: usize = 9;

    /// The case taken to a limit: no or hardly any rotation, no or hardly any radial translation, no tangential one, no
    /// translation at all, a pixel at or hardly off the principal point, and all of it at once.
    #[must_use]
    pub fn limit(&self, number: usize) -> Self {
        let t = self.motion.translation;
        let at = |pixel| Self { pixel, ..*self };
        let p0 = self.camera.principal_point();
        match number % Self::LIMITS {
            0 => self.without_rotation(),
            1 => Self { motion: Se3 { rotation: so3::exp(&(so3::log(&self.motion.rotation) * 1e-9)), ..self.motion }, ..*self },
            2 => self.with_translation(Vector3::new(t.x, t.y, 0.0)),
            3 => self.with_translation(Vector3::new(t.x, t.y, 1e-9 * t.z)),
            4 => self.with_translation(Vector3::new(0.0, 0.0, t.z)),
            5 => self.with_translation(Vector3::zeros()),
            6 => at(p0),
            7 => at(p0 + Vector2::new(1e-6, -2e-6)),
            _ => at(p0).without_rotation().with_translation(Vector3::zeros()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_depends_on_seed_and_name() {
        let first = |seed, name| Draw::new(seed, name).unit();
        assert_eq!(first(1, "L01"), first(1, "L01"));
        assert_ne!(first(1, "L01"), first(2, "L01"));
        assert_ne!(first(1, "L01"), first(1, "L02"));
        assert_ne!(first(1, "L12"), first(1, "L21"));
    }

    #[test]
    fn cases_fill_their_ranges_and_stay_in_front() {
        let mut draw = Draw::new(3, "cases");
        let (mut angle, mut length, mut depth) = (0.0f64, 0.0f64, (f64::INFINITY, 0.0f64));
        for _ in 0..5000 {
            let case = draw.case();
            assert!(case.motion.transform(&case.point()).z > 0.05 * case.depth);
            for number in 0..Case::LIMITS {
                let limit = case.limit(number);
                assert!(limit.motion.transform(&limit.point()).z > 0.05 * limit.depth, "limit {number}");
            }
            angle = angle.max(so3::angle(&case.motion.rotation));
            length = length.max(case.motion.translation.norm() / case.depth);
            depth = (depth.0.min(case.depth), depth.1.max(case.depth));
        }
        assert!(angle > 0.19 && angle <= 0.2 + 1e-12, "{angle}");
        assert!(length > 0.29 && length <= 0.3 + 1e-12, "{length}");
        assert!(depth.0 < 0.51 && depth.1 > 79.0, "{depth:?}");
    }
}

//! The ground as a plane below the camera, from the lower part of a view by random sampling (YihongSun/Dynamo-Depth, `tools.py`;
//! numbers of `options.py`).
//!
//! **Formula**: plane `y = a x + b z + c` in the camera frame, y downwards. A hundred times five points are drawn with replacement
//! from the lower 40 % of the rows (rounded down) and a plane is fitted to them by least squares along y; of these planes the one
//! wins that has the most points of the same rows within 0.005 along y, the first of equals.
//!
//! **Reading**: every sample of a batch is judged by its own points. The public code, for batches of more than one, scores the planes
//! of a sample on the points of all samples in turn, and adds 1e-6 to all nine entries of the normal equations' matrix; neither is
//! repeated here. Planes of points on a line, which have no solution, are passed over.
//!
//! Nothing here carries a gradient. All of it is computed in `f64`.

use dimode_autodiff::{Scalar, Shape, Tensor, par, rng};
use nalgebra::{Matrix3, Vector3};

/// The plane `y = a x + b z + c` in the camera frame, y downwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPlane {
    /// Slopes `a` and `b`, no unit.
    pub slopes: [f64; 2],
    /// How far the plane lies below the camera, `c`, units of depth.
    pub below: f64,
}

impl GroundPlane {
    /// How far a point lies above the plane along y, units of depth.
    #[must_use]
    pub fn height_of(&self, point: &Vector3<f64>) -> f64 {
        self.slopes[0] * point.x + self.slopes[1] * point.z + self.below - point.y
    }

    /// Depth at which a ray with third component 1 meets the plane, `c / (y - a x - b)`; `None` unless it does so ahead.
    #[must_use]
    pub fn depth_along(&self, ray: &Vector3<f64>) -> Option<f64> {
        let depth = self.below / (ray.y - self.slopes[0] * ray.x - self.slopes[1] * ray.z);
        (depth.is_finite() && depth > 0.0).then_some(depth)
    }

    /// The parallel plane further down.
    #[must_use]
    pub fn lowered(self, by: f64) -> Self {
        Self { below: self.below + by, ..self }
    }

    /// The least-squares plane of some points.
    fn fit(points: &[Vector3<f64>]) -> Option<Self> {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for point in points {
            let row = Vector3::new(point.x, point.z, 1.0);
            normal += row * row.transpose();
            right += row * point.y;
        }
        let solution = normal.lu().solve(&right)?;
        solution.iter().all(|x| x.is_finite()).then(|| Self { slopes: [solution.x, solution.y], below: solution.z })
    }
}

/// How the plane is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundSearch {
    /// Share of the rows, from below, in which ground is expected; at least one row is taken.
    pub rows: f64,
    /// Planes that are tried.
    pub trials: usize,
    /// Points that a plane is fitted to, at least three.
    pub points: usize,
    /// Distance along y up to which a point belongs to a plane, units of depth.
    pub tolerance: f64,
}

impl Default for GroundSearch {
    /// That of Dynamo-Depth.
    fn default() -> Self {
        Self { rows: 0.4, trials: 100, points: 5, tolerance: 0.005 }
    }
}

/// The ground of every sample; `None` where no plane can be fitted.
///
/// **Shapes**: `points` `[n, 3, h, w]`, camera frame, units of depth. The same seed gives the same planes, and a sample's do not
/// depend on the other samples.
///
/// # Panics
/// When there are not three components.
#[must_use]
#[track_caller]
pub fn ground_planes<T: Scalar>(points: &Tensor<T>, search: GroundSearch, seed: u64) -> Vec<Option<GroundPlane>> {
    let s = points.shape();
    assert!(s.c() == 3, "ground_planes: points have shape [n, 3, h, w], got {s}");
    par::map_indices(s.n(), |n| {
        let rows = ((search.rows * s.h() as f64) as usize).max(1).min(s.h());
        let [x, y, z] = [0, 1, 2].map(|c| &points.plane(n, c)[(s.h() - rows) * s.w()..]);
        let lower: Vec<_> = (0..x.len()).map(|i| Vector3::new(x[i].to_f64(), y[i].to_f64(), z[i].to_f64())).collect();
        best_plane(&lower, search, rng::splitmix64(seed, n as u64))
    })
}

fn best_plane(points: &[Vector3<f64>], search: GroundSearch, seed: u64) -> Option<GroundPlane> {
    let last = points.len().checked_sub(1)?;
    let draws = rng::uniform::<f64>(seed, Shape::new(1, 1, search.trials.max(1), search.points.max(1)), 0.0, 1.0);
    let drawn = |&share: &f64| points[((share * points.len() as f64) as usize).min(last)];
    let mut best: Option<(usize, GroundPlane)> = None;
    for trial in draws.data().chunks(search.points.max(1)) {
        let Some(plane) = GroundPlane::fit(&trial.iter().map(drawn).collect::<Vec<_>>()) else { continue };
        let near = points.iter().filter(|point| plane.height_of(point).abs() < search.tolerance).count();
        if best.is_none_or(|(most, _)| near > most) {
            best = Some((near, plane));
        }
    }
    best.map(|(_, plane)| plane)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;

    const TRUTH: GroundPlane = GroundPlane { slopes: [0.1, -0.05], below: 1.5 };

    /// Points on the true plane in the lower half, elsewhere and at one pixel in five anywhere above or below it.
    fn scene(samples: usize, plane: impl Fn(usize) -> GroundPlane) -> Tensor<f64> {
        let s = Shape::new(samples, 3, 20, 15);
        let (free, off) = (random::<f64>(1, s, -5.0, 5.0), random::<f64>(2, s, 0.0, 1.0));
        Tensor::from_fn(s, |n, c, v, u| {
            let [x, z] = [free.at(n, 0, v, u), 8.0 + free.at(n, 2, v, u)];
            let ground = plane(n).height_of(&Vector3::new(x, 0.0, z));
            let y = if v < 10 || off.at(n, 1, v, u) < 0.2 { ground + free.at(n, 1, v, u) } else { ground };
            [x, y, z][c]
        })
    }

    #[test]
    fn worked_plane() {
        let plane = GroundPlane { slopes: [0.5, 0.25], below: 2.0 };
        assert_eq!(plane.height_of(&Vector3::new(2.0, 1.0, 4.0)), 1.0 + 1.0 + 2.0 - 1.0);
        assert_eq!(plane.lowered(0.5).height_of(&Vector3::new(2.0, 1.0, 4.0)), 3.5);
        let depth = plane.depth_along(&Vector3::new(0.5, 1.0, 1.0)).unwrap();
        assert_eq!(depth, 4.0);
        assert_eq!(plane.height_of(&(Vector3::new(0.5, 1.0, 1.0) * depth)), 0.0);
        // Along the plane, and up into the sky.
        assert_eq!(plane.depth_along(&Vector3::new(0.5, 0.5, 1.0)), None);
        assert_eq!(plane.depth_along(&Vector3::new(0.5, 0.0, 1.0)), None);
    }

    #[test]
    fn a_fit_minimises_the_distance_along_y() {
        let at = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
        let four = [at(0.0, 1.0, 1.0), at(1.0, 2.0, 1.0), at(0.0, 3.0, 2.0), at(1.0, 6.0, 2.0)];
        // Saddle: the best plane leaves +-1/2 at the corners.
        let plane = GroundPlane::fit(&four).unwrap();
        for (point, left) in four.iter().zip([-0.5, 0.5, 0.5, -0.5]) {
            assert!((plane.height_of(point) - left).abs() < 1e-12);
        }
        assert_eq!(GroundPlane::fit(&[at(1.0, 1.0, 1.0); 5]), None);
    }

    #[test]
    fn the_ground_is_found_among_other_things() {
        let planes = ground_planes(&scene(1, |_| TRUTH), GroundSearch::default(), 1);
        let found = planes[0].unwrap();
        assert!((found.below - TRUTH.below).abs() < 1e-9);
        assert!((0..2).all(|k| (found.slopes[k] - TRUTH.slopes[k]).abs() < 1e-9));
        // The upper rows alone show none.
        let sky = GroundSearch { rows: 1.0, ..GroundSearch::default() };
        let upper = Tensor::from_fn(Shape::new(1, 3, 10, 15), |n, c, v, u| scene(1, |_| TRUTH).at(n, c, v, u));
        assert!((ground_planes(&upper, sky, 1)[0].unwrap().below - TRUTH.below).abs() > 1e-3);
    }

    #[test]
    fn every_sample_has_its_own_plane() {
        let of = |n: usize| TRUTH.lowered(n as f64);
        let points = scene(3, of);
        let planes = ground_planes(&points, GroundSearch::default(), 7);
        for (n, plane) in planes.iter().enumerate() {
            assert!((plane.unwrap().below - of(n).below).abs() < 1e-9, "sample {n}");
        }
        assert_eq!(planes, ground_planes(&points, GroundSearch::default(), 7));
        let first = Tensor::from_fn(points.shape().with_axis(0, 1), |_, c, v, u| points.at(0, c, v, u));
        assert_eq!(ground_planes(&first, GroundSearch::default(), 7)[0], planes[0]);
    }

    #[test]
    fn points_that_are_not_finite_belong_to_no_plane() {
        let mut points = scene(1, |_| TRUTH).to_vec();
        points.iter_mut().skip(299).step_by(7).for_each(|x| *x = f64::NAN);
        let points = Tensor::from_vec(Shape::new(1, 3, 20, 15), points);
        let found = ground_planes(&points, GroundSearch::default(), 1)[0].unwrap();
        assert!((found.below - TRUTH.below).abs() < 1e-9);
        let none = ground_planes(&Tensor::full(points.shape(), f64::NAN), GroundSearch::default(), 1);
        assert_eq!(none, [None]);
        let one = ground_planes(&Tensor::full(Shape::new(1, 3, 1, 1), 1.0_f32), GroundSearch::default(), 1);
        assert_eq!(one, [None]);
    }
}

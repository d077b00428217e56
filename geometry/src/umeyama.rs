//! Least-squares alignment of two point sets (Umeyama's closed form).

use nalgebra::{Matrix3, Vector3};

use crate::error::GeometryError;
use crate::se3::Se3;
use crate::svd3::svd3;

/// Singular values below this part of the largest one leave a twist of the rotation undetermined.
const COLLINEAR: f64 = 1e-9;
/// Points closer to each other than this part of their distance to the origin count as equal.
const NO_EXTENT: f64 = 1e-12;

/// The map `x -> scale R x + t` that brings the source points closest to the reference points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Proper rotation `R`.
    pub rotation: Matrix3<f64>,
    /// Translation `t`, in the units of the reference.
    pub translation: Vector3<f64>,
    /// Scale; exactly 1 for [`rigid`].
    pub scale: f64,
    /// The points lie on a line (or are fewer than three), so any twist about it fits as well:
    /// distances after alignment are right, the rotation itself means nothing.
    pub rotation_ambiguous: bool,
}

impl Alignment {
    /// Image of a point.
    #[must_use]
    pub fn apply(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.translation
    }

    /// Image of a `world_from_camera` pose: the position is mapped, the orientation only rotated.
    #[must_use]
    pub fn apply_to_pose(&self, world_from_camera: &Se3) -> Se3 {
        Se3 { rotation: self.rotation * world_from_camera.rotation, translation: self.apply(&world_from_camera.translation) }
    }
}

/// Best rotation, translation and scale.
///
/// # Errors
/// [`GeometryError::CountMismatch`] for lists of different length and
/// [`GeometryError::DegenerateTrajectory`] for fewer than two points, points that are not finite,
/// or a set without extent.
pub fn similarity(source: &[Vector3<f64>], reference: &[Vector3<f64>]) -> Result<Alignment, GeometryError> {
    let moments = Moments::new(source, reference)?;
    if !moments.source_extends {
        return Err(degenerate("source points have no extent".to_owned()));
    }
    Ok(moments.solve(true))
}

/// Best rotation and translation, scale fixed to 1.
///
/// # Errors
/// As [`similarity`], except that source points without extent give a result whose rotation is
/// flagged as ambiguous.
pub fn rigid(source: &[Vector3<f64>], reference: &[Vector3<f64>]) -> Result<Alignment, GeometryError> {
    Ok(Moments::new(source, reference)?.solve(false))
}

fn degenerate(reason: String) -> GeometryError {
    GeometryError::DegenerateTrajectory { reason }
}

/// Means, spread and cross covariance of two point lists.
struct Moments {
    count: usize,
    source_mean: Vector3<f64>,
    reference_mean: Vector3<f64>,
    source_variance: f64,
    source_extends: bool,
    covariance: Matrix3<f64>,
}

impl Moments {
    fn new(source: &[Vector3<f64>], reference: &[Vector3<f64>]) -> Result<Self, GeometryError> {
        if source.len() != reference.len() {
            return Err(GeometryError::CountMismatch {
                what: "alignment: source and reference points",
                left: source.len(),
                right: reference.len(),
            });
        }
        if source.len() < 2 {
            return Err(degenerate(format!("{} point(s) for an alignment, at least 2 are needed", source.len())));
        }
        if let Some(i) = (0..source.len()).find(|&i| !source[i].iter().chain(reference[i].iter()).all(|x| x.is_finite())) {
            return Err(degenerate(format!("point {i} is not finite")));
        }
        let n = source.len() as f64;
        let (mx, my) = (mean(source), mean(reference));
        let mut covariance = Matrix3::zeros();
        for (x, y) in source.iter().zip(reference) {
            covariance += (y - my) * (x - mx).transpose();
        }
        if !extends(reference, &my) {
            return Err(degenerate("reference points have no extent".to_owned()));
        }
        Ok(Self {
            count: source.len(),
            source_mean: mx,
            reference_mean: my,
            source_variance: variance(source, &mx),
            source_extends: extends(source, &mx),
            covariance: covariance / n,
        })
    }

    fn solve(&self, with_scale: bool) -> Alignment {
        let svd = svd3(&self.covariance);
        let sign = (svd.u * svd.v.transpose()).determinant().signum();
        let flip = Vector3::new(1.0, 1.0, sign);
        let rotation = svd.u * Matrix3::from_diagonal(&flip) * svd.v.transpose();
        let scale = if with_scale { svd.values.dot(&flip) / self.source_variance } else { 1.0 };
        Alignment {
            rotation,
            translation: self.reference_mean - rotation * self.source_mean * scale,
            scale,
            rotation_ambiguous: self.count < 3 || !self.source_extends || svd.values[1] <= COLLINEAR * svd.values[0],
        }
    }
}

fn mean(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len() as f64
}

fn variance(points: &[Vector3<f64>], mean: &Vector3<f64>) -> f64 {
    points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / points.len() as f64
}

fn extends(points: &[Vector3<f64>], mean: &Vector3<f64>) -> bool {
    variance(points, mean).sqrt() > NO_EXTENT * mean.norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::so3;
    use proptest::prelude::*;

    fn cloud() -> Vec<Vector3<f64>> {
        (0..12)
            .map(|i| {
                let x = f64::from(i);
                Vector3::new((1.3 * x).sin() * 4.0, (0.7 * x).cos() * 9.0, x - 5.0 * (x * 0.9).sin())
            })
            .collect()
    }

    fn rmse(a: &Alignment, x: &[Vector3<f64>], y: &[Vector3<f64>]) -> f64 {
        let sum: f64 = x.iter().zip(y).map(|(x, y)| (a.apply(x) - y).norm_squared()).sum();
        (sum / x.len() as f64).sqrt()
    }

    #[test]
    fn planar_points_are_exact() {
        let x: Vec<_> = cloud().iter().map(|p| Vector3::new(p.x, p.y, 0.0)).collect();
        let r = so3::exp(&Vector3::new(0.2, 1.9, -0.4));
        let y: Vec<_> = x.iter().map(|p| r * p * 0.3 + Vector3::new(1.0, 2.0, 3.0)).collect();
        let a = similarity(&x, &y).unwrap();
        assert!((a.rotation - r).abs().max() < 1e-12 && (a.scale - 0.3).abs() < 1e-13);
        assert!(!a.rotation_ambiguous);
    }

    #[test]
    fn mirrored_reference_gives_a_proper_rotation() {
        let x = cloud();
        let y: Vec<_> = x.iter().map(|p| Vector3::new(-p.x, p.y, p.z)).collect();
        let a = similarity(&x, &y).unwrap();
        assert!((a.rotation.determinant() - 1.0).abs() < 1e-12);
        assert!(rmse(&a, &x, &y) > 0.1);
    }

    #[test]
    fn collinear_points_are_flagged_and_still_fit() {
        let direction = Vector3::new(1.0, 2.0, -0.5);
        let x: Vec<_> = (0..9).map(|i| direction * f64::from(i)).collect();
        let r = so3::exp(&Vector3::new(0.0, 0.4, 0.1));
        let y: Vec<_> = x.iter().map(|p| r * p * 2.0).collect();
        let a = similarity(&x, &y).unwrap();
        assert!(a.rotation_ambiguous && rmse(&a, &x, &y) < 1e-12);
        assert!((a.rotation.determinant() - 1.0).abs() < 1e-12);
        assert!(rigid(&x[..2], &y[..2]).unwrap().rotation_ambiguous);
        // A nearly straight road is not a line.
        let bend = |p: &Vector3<f64>| p + Vector3::new(0.0, 0.0, 2e-3 * p.x * p.x);
        let bent: Vec<_> = x.iter().map(bend).collect();
        assert!(!similarity(&bent, &bent).unwrap().rotation_ambiguous);
    }

    #[test]
    fn degenerate_inputs_name_the_side() {
        let (x, equal) = (cloud(), vec![Vector3::new(1.0, -4.0, 2.0); 12]);
        let text = |r: Result<Alignment, GeometryError>| r.unwrap_err().to_string();
        assert!(text(similarity(&equal, &x)).contains("source points have no extent"));
        assert!(text(similarity(&x, &equal)).contains("reference points have no extent"));
        assert!(text(similarity(&x[..1], &x[..1])).contains("at least 2"));
        assert!(text(rigid(&x[..3], &x[..4])).contains("3 and 4"));
        assert!(rigid(&equal, &x).unwrap().rotation_ambiguous);
        let mut broken = x.clone();
        broken[5].y = f64::NAN;
        assert!(text(rigid(&broken, &x)).contains("point 5"));
    }

    #[test]
    fn poses_keep_orthonormal_orientations() {
        let a = Alignment {
            rotation: so3::exp(&Vector3::new(0.1, 0.2, 0.3)),
            translation: Vector3::new(1.0, 0.0, 0.0),
            scale: 4.0,
            rotation_ambiguous: false,
        };
        let pose = a.apply_to_pose(&Se3::from_rotation_vector(&Vector3::new(0.5, 0.0, 0.0), Vector3::x()));
        assert!(pose.is_orthonormal(1e-14));
        assert!((pose.translation - a.apply(&Vector3::x())).norm() < 1e-15);
    }

    proptest! {
        #[test]
        fn recovers_a_similarity(w in prop::array::uniform3(-1.8f64..1.8), t in prop::array::uniform3(-50.0f64..50.0), s in 0.01f64..30.0) {
            let (r, t) = (so3::exp(&Vector3::from(w)), Vector3::from(t));
            let x = cloud();
            let y: Vec<_> = x.iter().map(|p| r * p * s + t).collect();
            let a = similarity(&x, &y).unwrap();
            prop_assert!((a.rotation - r).abs().max() < 1e-11);
            prop_assert!((a.scale / s - 1.0).abs() < 1e-11);
            prop_assert!((a.translation - t).norm() < 1e-9);
            let rigid_y: Vec<_> = x.iter().map(|p| r * p + t).collect();
            prop_assert!(rmse(&rigid(&x, &rigid_y).unwrap(), &x, &rigid_y) < 1e-11);
        }
    }
}

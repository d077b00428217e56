//! Rotations: exponential and logarithm of SO(3), and the Jacobians of the exponential.
//!
//! A rotation vector `w` turns by `|w|` radians about `w / |w|`. Every coefficient function below
//! is evaluated by a form that stays exact through `w = 0`.

use nalgebra::{Matrix3, Vector3};

/// Coefficients of the exponential and its Jacobian as functions of the squared angle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coefficients {
    /// `sin(x) / x`
    pub a: f64,
    /// `(1 - cos(x)) / x^2`
    pub b: f64,
    /// `(x - sin(x)) / x^3`
    pub c: f64,
}

impl Coefficients {
    /// Evaluates the three coefficients for the squared angle `x2`.
    pub(crate) fn new(x2: f64) -> Self {
        if x2 < 0.25 {
            // Terms alternate and fall by at least 1/500 each: eight reach full precision.
            return Self { a: alternating(x2, 2.0, 1.0), b: alternating(x2, 3.0, 0.5), c: alternating(x2, 4.0, 1.0 / 6.0) };
        }
        let x = x2.sqrt();
        let half = 0.5 * x;
        let sinc_half = half.sin() / half;
        Self { a: x.sin() / x, b: 0.5 * sinc_half * sinc_half, c: (x - x.sin()) / (x2 * x) }
    }
}

/// Sum of `first * (-x2)^k / (n (n+1) ... (n+2k-1))`.
fn alternating(x2: f64, n: f64, first: f64) -> f64 {
    let (mut term, mut sum, mut next) = (first, first, n);
    for _ in 0..8 {
        term *= -x2 / (next * (next + 1.0));
        sum += term;
        next += 2.0;
    }
    sum
}

/// The matrix of the cross product: `hat(w) x = w x x`.
#[must_use]
pub fn hat(w: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// Inverse of [`hat`] on the antisymmetric part of `m`.
#[must_use]
pub fn vee(m: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)])
}

/// Rotation matrix of a rotation vector in radians (Rodrigues' formula).
#[must_use]
pub fn exp(w: &Vector3<f64>) -> Matrix3<f64> {
    let k = Coefficients::new(w.norm_squared());
    let generator = hat(w);
    Matrix3::identity() + generator * k.a + generator * generator * k.b
}

/// What two rotations, given by their vectors in radians, differ by in the other order: `exp(a) exp(b) - exp(b) exp(a)`.
///
/// To lowest order `hat(a x b)`, of Frobenius norm `sqrt(2) |a x b|`.
#[must_use]
pub fn commutator(a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    let (a, b) = (exp(a), exp(b));
    a * b - b * a
}

/// Rotation angle in `[0, pi]`, radians, accurate at both ends.
#[must_use]
pub fn angle(rotation: &Matrix3<f64>) -> f64 {
    vee(rotation).norm().atan2(0.5 * (rotation.trace() - 1.0))
}

/// Rotation vector of a rotation matrix, length in `[0, pi]`.
///
/// At exactly half a turn both signs describe the same rotation; the axis is then the one whose
/// largest component is positive.
#[must_use]
pub fn log(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let sine_axis = vee(rotation);
    let cosine = 0.5 * (rotation.trace() - 1.0);
    let theta = sine_axis.norm().atan2(cosine);
    if cosine > 0.0 {
        return sine_axis / Coefficients::new(theta * theta).a;
    }
    // Symmetric part: cos I + (1 - cos) a a^T, well conditioned for more than a quarter turn.
    let outer = (rotation + rotation.transpose()) * 0.5 - Matrix3::identity() * cosine;
    let k = outer.diagonal().imax();
    let mut axis = outer.column(k).normalize();
    if axis.dot(&sine_axis) < 0.0 {
        axis = -axis;
    }
    axis * theta
}

/// Left Jacobian: `exp(w + d) = exp(J_l d) exp(w)` to first order in `d`.
#[must_use]
pub fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let k = Coefficients::new(w.norm_squared());
    let generator = hat(w);
    Matrix3::identity() + generator * k.b + generator * generator * k.c
}

/// Right Jacobian: `exp(w + d) = exp(w) exp(J_r d)` to first order in `d`.
#[must_use]
pub fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-w)
}

/// Inverse of [`left_jacobian`] for angles below `2 pi`.
#[must_use]
pub fn left_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let x2 = w.norm_squared();
    let d = if x2 < 1e-2 {
        1.0 / 12.0 + x2 * (1.0 / 720.0 + x2 * (1.0 / 30240.0 + x2 / 1_209_600.0))
    } else {
        let k = Coefficients::new(x2);
        (1.0 - 0.5 * k.a / k.b) / x2
    };
    let generator = hat(w);
    Matrix3::identity() - generator * 0.5 + generator * generator * d
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(limit: f64) -> impl Strategy<Value = Vector3<f64>> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| Vector3::new(x, y, z))
    }

    #[test]
    fn quarter_turn_about_z() {
        let r = exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        let image = r * Vector3::new(1.0, 0.0, 0.0);
        assert!((image - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-15);
    }

    #[test]
    fn coefficients_agree_across_the_switch() {
        for x2 in [0.2499999999f64, 0.2500000001] {
            let x = x2.sqrt();
            let k = Coefficients::new(x2);
            assert!((k.a - x.sin() / x).abs() < 1e-15);
            assert!((k.b - (1.0 - x.cos()) / x2).abs() < 1e-14);
            assert!((k.c - (x - x.sin()) / (x2 * x)).abs() < 1e-14);
        }
    }

    #[test]
    fn log_near_half_a_turn() {
        for gap in [0.0, 1e-12, 1e-8, 1e-3] {
            let w = Vector3::new(0.48, -0.6, 0.64) * (std::f64::consts::PI - gap);
            let back = log(&exp(&w));
            let error = (back - w).norm().min((back + w).norm());
            assert!(error < 1e-9, "gap {gap}: {error}");
        }
    }

    #[test]
    fn rotations_about_one_axis_commute_and_others_do_not() {
        let (x, y) = (Vector3::x() * 0.01, Vector3::y() * 0.01);
        assert_eq!(commutator(&x, &(x * 2.0)).norm(), 0.0);
        assert!((commutator(&x, &y) - hat(&x.cross(&y))).norm() < 0.01 * commutator(&x, &y).norm());
    }

    #[test]
    fn tiny_rotations_keep_all_digits() {
        let w = Vector3::new(1e-9, -3e-10, 2e-9);
        assert!((log(&exp(&w)) - w).norm() < 1e-24);
        assert!((angle(&exp(&w)) - w.norm()).abs() < 1e-22);
        assert_eq!(exp(&Vector3::zeros()), Matrix3::identity());
    }

    proptest! {
        #[test]
        fn exponential_is_orthonormal_and_log_inverts_it(w in vector(1.7)) {
            let r = exp(&w);
            prop_assert!((r.transpose() * r - Matrix3::identity()).abs().max() < 1e-14);
            prop_assert!((r.determinant() - 1.0).abs() < 1e-14);
            prop_assert!((log(&r) - w).norm() < 1e-12);
        }

        #[test]
        fn jacobians_match_differences(w in vector(1.5), d in vector(1.0)) {
            let h = 1e-6;
            let plus = exp(&(w + d * h));
            let minus = exp(&(w - d * h));
            let left = log(&(plus * minus.transpose())) / (2.0 * h);
            let right = log(&(minus.transpose() * plus)) / (2.0 * h);
            prop_assert!((left - left_jacobian(&w) * d).norm() < 1e-8);
            prop_assert!((right - right_jacobian(&w) * d).norm() < 1e-8);
        }

        #[test]
        fn inverse_jacobian(w in vector(1.7)) {
            let product = left_jacobian(&w) * left_jacobian_inverse(&w);
            prop_assert!((product - Matrix3::identity()).abs().max() < 1e-12);
        }
    }
}

//! Singular values of a 3x3 matrix by one-sided Jacobi rotations.
//!
//! Small singular values keep their relative accuracy, which the tests for collinear point sets
//! need; methods that pass through `A^T A` lose them below `1e-8` of the largest one.

use nalgebra::{Matrix3, Vector3};

/// `A = U diag(values) V^T`, values falling, `U` and `V` orthogonal (either may be a reflection).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Svd3 {
    pub u: Matrix3<f64>,
    pub values: Vector3<f64>,
    pub v: Matrix3<f64>,
}

const SWEEPS: usize = 40;

/// Decomposes `a`; entries must be finite.
pub(crate) fn svd3(a: &Matrix3<f64>) -> Svd3 {
    let (mut w, mut v) = (*a, Matrix3::identity());
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotated |= orthogonalise(&mut w, &mut v, p, q);
        }
        if !rotated {
            break;
        }
    }
    sort(&mut w, &mut v);
    let values = Vector3::from_fn(|i, _| w.column(i).norm());
    Svd3 { u: left_vectors(&w, &values), values, v }
}

/// Rotates columns `p` and `q` until they are orthogonal; false when they already were.
fn orthogonalise(w: &mut Matrix3<f64>, v: &mut Matrix3<f64>, p: usize, q: usize) -> bool {
    let (alpha, beta) = (w.column(p).norm_squared(), w.column(q).norm_squared());
    let gamma = w.column(p).dot(&w.column(q));
    if gamma.abs() <= f64::EPSILON * (alpha * beta).sqrt() {
        return false;
    }
    let zeta = (beta - alpha) / (2.0 * gamma);
    let t = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
    let cosine = 1.0 / t.hypot(1.0);
    let sine = cosine * t;
    for m in [w, v] {
        for row in 0..3 {
            let (x, y) = (m[(row, p)], m[(row, q)]);
            m[(row, p)] = cosine * x - sine * y;
            m[(row, q)] = sine * x + cosine * y;
        }
    }
    true
}

fn sort(w: &mut Matrix3<f64>, v: &mut Matrix3<f64>) {
    for (p, q) in [(0, 1), (1, 2), (0, 1)] {
        if w.column(p).norm_squared() < w.column(q).norm_squared() {
            w.swap_columns(p, q);
            v.swap_columns(p, q);
        }
    }
}

/// Normalised columns; directions that the matrix does not determine are completed.
fn left_vectors(w: &Matrix3<f64>, values: &Vector3<f64>) -> Matrix3<f64> {
    if values[0] == 0.0 {
        return Matrix3::identity();
    }
    let first = w.column(0) / values[0];
    let mut second = w.column(1).into_owned();
    if values[1] <= f64::EPSILON * values[0] {
        let mut axis = Vector3::zeros();
        axis[first.iamin()] = 1.0;
        second = axis;
    }
    second -= first * first.dot(&second);
    second.normalize_mut();
    let mut third = first.cross(&second);
    if third.dot(&w.column(2)) < 0.0 {
        third = -third;
    }
    Matrix3::from_columns(&[first, second, third])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(a: Matrix3<f64>) -> Svd3 {
        let svd = svd3(&a);
        let back = svd.u * Matrix3::from_diagonal(&svd.values) * svd.v.transpose();
        assert!((back - a).abs().max() <= 1e-14 * (1.0 + a.abs().max()), "{a} {back}");
        for m in [svd.u, svd.v] {
            assert!((m.tr_mul(&m) - Matrix3::identity()).abs().max() < 1e-14, "{m}");
        }
        assert!(svd.values[0] >= svd.values[1] && svd.values[1] >= svd.values[2]);
        svd
    }

    #[test]
    fn known_values() {
        let svd = check(Matrix3::new(0.0, 2.0, 0.0, 0.0, 0.0, -5.0, 3.0, 0.0, 0.0));
        assert!((svd.values - Vector3::new(5.0, 3.0, 2.0)).norm() < 1e-15);
    }

    #[test]
    fn deficient_ranks() {
        check(Matrix3::zeros());
        let a = Vector3::new(0.3, -2.0, 1.1);
        let b = Vector3::new(1.0, 0.5, -0.7);
        let one = check(a * b.transpose());
        assert!(one.values[1] < 1e-15 * one.values[0]);
        check(a * b.transpose() + b * a.transpose());
    }

    #[test]
    fn tiny_values_keep_their_digits() {
        let (u, v) = (crate::so3::exp(&Vector3::new(0.3, -0.2, 0.9)), crate::so3::exp(&Vector3::new(-1.0, 0.4, 0.1)));
        let svd = check(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1e-6, 1e-12)) * v.transpose());
        assert!((svd.values[1] / 1e-6 - 1.0).abs() < 1e-9);
        assert!((svd.values[2] / 1e-12 - 1.0).abs() < 1e-3);
    }

    proptest! {
        #[test]
        fn random_matrices(x in prop::array::uniform9(-3.0f64..3.0)) {
            let svd = check(Matrix3::from_column_slice(&x));
            let det = Matrix3::from_column_slice(&x).determinant().abs();
            prop_assert!((svd.values.product() - det).abs() < 1e-12);
        }
    }
}

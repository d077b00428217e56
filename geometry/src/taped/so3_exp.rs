//! Rotation matrices of three numbers: a rotation vector, or angles about the axes.
//!
//! The exponential map has the exact derivative everywhere: with `M = G R^T`, the vector of the
//! antisymmetric part `m = (M_32 - M_23, M_13 - M_31, M_21 - M_12)` gives `grad w = J_l(w)^T m`. At `w = 0`
//! that is the generator. Small matrices are worked in `f64` whatever the tape's type.

use dimode_autodiff::{GradSink, Scalar, Shape, Tensor, Var};
use nalgebra::{Matrix3, Vector3};

use crate::so3;

/// Which formula turns a rotation vector into a matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RotationForm {
    /// The exponential map: orthonormal, gradient exact also at zero.
    #[default]
    Exponential,
    /// The common network formula with the axis `w / (|w| + 1e-7)`: orthonormal only to about 1e-7, and
    /// its gradient at `w = 0` is zero. For comparison with other programs.
    Guarded,
    /// Angles about the axes, `R = R_x R_y R_z`: orthonormal, singular where the second angle is a quarter turn. The pose
    /// networks of SC-Depth say these.
    Euler,
}

const GUARD: f64 = 1e-7;

/// `R = exp([w]_x)` for every sample.
///
/// **Shapes**: `w` (N,3,1,1), radians; result (N,1,3,3).
/// **Panics** on another shape.
#[track_caller]
pub fn so3_exp<T: Scalar>(w: Var<'_, T>) -> Var<'_, T> {
    rotation_matrix(w, RotationForm::Exponential)
}

/// Rotation matrix by either formula.
///
/// **Shapes**: `w` (N,3,1,1), radians; result (N,1,3,3).
/// **Panics** on another shape.
#[track_caller]
pub fn rotation_matrix<T: Scalar>(w: Var<'_, T>, form: RotationForm) -> Var<'_, T> {
    let n = w.shape().n();
    assert!(w.shape() == Shape::new(n, 3, 1, 1), "so3_exp: rotation vectors have shape (N, 3, 1, 1), got {}", w.shape());
    let vectors = w.value();
    let mut out = w.tape().scratch(9 * n);
    for (r, w) in out.chunks_exact_mut(9).zip(vectors.data().chunks_exact(3)) {
        store(&value(&vector(w), form), r);
    }
    let out = w.tape().tensor(Shape::new(n, 1, 3, 3), out);
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|grad| {
                let pairs = vectors.data().chunks_exact(3).zip(g.data().chunks_exact(9));
                for (out, (w, g)) in grad.chunks_exact_mut(3).zip(pairs) {
                    let gradient = pullback(&vector(w), &matrix(g), form);
                    out.iter_mut().zip(gradient.iter()).for_each(|(o, &x)| *o = T::from_f64(x));
                }
            });
        }
    };
    w.tape().push("so3_exp", out, &[w], record)
}

fn value(w: &Vector3<f64>, form: RotationForm) -> Matrix3<f64> {
    match form {
        RotationForm::Exponential => so3::exp(w),
        RotationForm::Euler => about_axes(w).iter().product(),
        RotationForm::Guarded => {
            let theta = w.norm();
            let a = w / (theta + GUARD);
            Matrix3::identity() * theta.cos() + a * a.transpose() * (1.0 - theta.cos()) + so3::hat(&a) * theta.sin()
        }
    }
}

fn pullback(w: &Vector3<f64>, g: &Matrix3<f64>, form: RotationForm) -> Vector3<f64> {
    match form {
        RotationForm::Exponential => {
            let left = so3::vee(&(g * so3::exp(w).transpose())) * 2.0;
            so3::left_jacobian(w).tr_mul(&left)
        }
        RotationForm::Guarded => guarded_pullback(w, g),
        RotationForm::Euler => euler_pullback(w, g),
    }
}

/// The turns about x, y and z by the three angles.
fn about_axes(angles: &Vector3<f64>) -> [Matrix3<f64>; 3] {
    std::array::from_fn(|k| so3::exp(&Vector3::from_fn(|i, _| if i == k { angles[k] } else { 0.0 })))
}

/// By angle `k`: with `R = A R_k C` the derivative is `A [e_k]_x R_k C`, whose product with `g` is component `k` of the
/// antisymmetric part of `A^T g (R_k C)^T`.
fn euler_pullback(angles: &Vector3<f64>, g: &Matrix3<f64>) -> Vector3<f64> {
    let turns = about_axes(angles);
    Vector3::from_fn(|k, _| {
        let before: Matrix3<f64> = turns[..k].iter().product();
        let from_here: Matrix3<f64> = turns[k..].iter().product();
        2.0 * so3::vee(&(before.transpose() * g * from_here.transpose()))[k]
    })
}

fn guarded_pullback(w: &Vector3<f64>, g: &Matrix3<f64>) -> Vector3<f64> {
    let theta = w.norm();
    if theta == 0.0 {
        return Vector3::zeros();
    }
    let (sine, cosine, length) = (theta.sin(), theta.cos(), theta + GUARD);
    let a = w / length;
    let antisymmetric = so3::vee(g) * 2.0;
    let to_axis = (g + g.transpose()) * a * (1.0 - cosine) + antisymmetric * sine;
    let to_angle = -sine * g.trace() + sine * a.dot(&(g * a)) + cosine * antisymmetric.dot(&a);
    to_axis / length + w / theta * (to_angle - to_axis.dot(w) / (length * length))
}

fn vector<T: Scalar>(x: &[T]) -> Vector3<f64> {
    Vector3::from_fn(|i, _| x[i].to_f64())
}

fn matrix<T: Scalar>(x: &[T]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| x[3 * i + j].to_f64())
}

fn store<T: Scalar>(m: &Matrix3<f64>, out: &mut [T]) {
    for i in 0..3 {
        for j in 0..3 {
            out[3 * i + j] = T::from_f64(m[(i, j)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    fn column(w: [f64; 3]) -> Tensor<f64> {
        Tensor::from_vec(Shape::new(1, 3, 1, 1), w.to_vec())
    }

    #[test]
    fn equals_the_plain_exponential() {
        let tape = Tape::new();
        let r = so3_exp(tape.leaf(column([0.3, -0.2, 0.5]))).value();
        let expected = so3::exp(&Vector3::new(0.3, -0.2, 0.5));
        assert!((matrix(r.data()) - expected).abs().max() < 1e-15);
    }

    #[test]
    fn gradient_at_zero_is_the_generator() {
        let tape = Tape::new();
        let w = tape.leaf(column([0.0; 3]));
        let r = so3_exp(w).slice(2, 2, 1).slice(3, 1, 1);
        assert_eq!(tape.backward(r).wrt(w).to_vec(), [1.0, 0.0, 0.0]);
        let guarded = rotation_matrix(w, RotationForm::Guarded).sum();
        assert_eq!(tape.backward(guarded).wrt(w).to_vec(), [0.0; 3]);
    }

    #[test]
    fn euler_angles_turn_about_z_first_and_x_last() {
        let quarter = std::f64::consts::FRAC_PI_2;
        // z by a quarter takes x to y, x by a quarter takes y to z.
        let r = value(&Vector3::new(quarter, 0.0, quarter), RotationForm::Euler);
        assert!((r * Vector3::x() - Vector3::z()).norm() < 1e-15);
        let (a, b, c) = (0.3_f64, -0.2_f64, 0.5_f64);
        let r = value(&Vector3::new(a, b, c), RotationForm::Euler);
        let first_row = [b.cos() * c.cos(), -b.cos() * c.sin(), b.sin()];
        assert!((0..3).all(|j| (r[(0, j)] - first_row[j]).abs() < 1e-15), "{r}");
        let tape = Tape::new();
        let angles = tape.leaf(column([0.0; 3]));
        let grads = tape.backward(rotation_matrix(angles, RotationForm::Euler).slice(2, 1, 1).slice(3, 0, 1));
        assert_eq!(grads.wrt(angles).to_vec(), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn gradients_match_differences() {
        let shape = Shape::new(4, 3, 1, 1);
        for (seed, size) in [(1, 0.02), (2, 0.5), (3, 1.5)] {
            let w = random(seed, shape, -size, size);
            for form in [RotationForm::Exponential, RotationForm::Guarded, RotationForm::Euler] {
                gradcheck(std::slice::from_ref(&w), |_, v| weighted_sum(rotation_matrix(v[0], form), 9), GradCheck::default())
                    .assert_ok();
            }
        }
        let zero = Tensor::zeros(shape);
        gradcheck(&[zero], |_, v| weighted_sum(so3_exp(v[0]), 9), GradCheck::default()).assert_ok();
    }

    #[test]
    #[should_panic(expected = "(N, 3, 1, 1), got [1, 1, 1, 3]")]
    fn rows_are_refused() {
        so3_exp(Tape::<f64>::new().leaf(Tensor::zeros(Shape::new(1, 1, 1, 3))));
    }
}

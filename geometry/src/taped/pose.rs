//! From a pose network's numbers to `source_from_target`.

use dimode_autodiff::{Scalar, Shape, Tensor, Var};

use super::so3_exp::{RotationForm, rotation_matrix};
use crate::se3::Se3;

/// A batch of motions `X_s = R X_t + t` on the tape.
#[derive(Clone, Copy, Debug)]
pub struct Pose<'t, T: Scalar> {
    /// Rotations (N,1,3,3).
    pub rotation: Var<'t, T>,
    /// Translations (N,3,1,1), source frame.
    pub translation: Var<'t, T>,
}

impl<'t, T: Scalar> Pose<'t, T> {
    /// The motions back: `R^T`, `-R^T t`.
    #[must_use]
    pub fn inverse(self) -> Self {
        let rotation = self.rotation.transpose_hw();
        Self { rotation, translation: rotate(rotation, self.translation).neg() }
    }

    /// `self` after `other`: `R R_other`, `R t_other + t`.
    ///
    /// **Frames**: `c_from_b.compose(b_from_a)` is `c_from_a`.
    #[must_use]
    pub fn compose(self, other: Self) -> Self {
        let translation = rotate(self.rotation, other.translation).add(self.translation);
        Self { rotation: self.rotation.matmul(other.rotation), translation }
    }

    /// `R^T t`, the translations in the target frame (N,3,1,1).
    #[must_use]
    pub fn translation_in_target_frame(self) -> Var<'t, T> {
        rotate(self.rotation.transpose_hw(), self.translation)
    }

    /// The same values without history.
    #[must_use]
    pub fn detach(self) -> Self {
        Self { rotation: self.rotation.detach(), translation: self.translation.detach() }
    }

    /// Values as plain motions, one a sample.
    #[must_use]
    pub fn to_se3(self) -> Vec<Se3> {
        let (r, t) = (self.rotation.value(), self.translation.value());
        (0..self.rotation.shape().n())
            .map(|n| Se3 {
                rotation: nalgebra::Matrix3::from_fn(|i, j| r.at(n, 0, i, j).to_f64()),
                translation: nalgebra::Vector3::from_fn(|i, _| t.at(n, i, 0, 0).to_f64()),
            })
            .collect()
    }
}

/// Rotation matrices (N,1,3,3) and translations (N,3,1,1) of plain motions, as tensors.
///
/// **Panics** for an empty list.
#[must_use]
pub fn pose_tensors<T: Scalar>(motions: &[Se3]) -> (Tensor<T>, Tensor<T>) {
    assert!(!motions.is_empty(), "pose_tensors: no motion given");
    let n = motions.len();
    (
        Tensor::from_fn(Shape::new(n, 1, 3, 3), |n, _, i, j| T::from_f64(motions[n].rotation[(i, j)])),
        Tensor::from_fn(Shape::new(n, 3, 1, 1), |n, i, _, _| T::from_f64(motions[n].translation[i])),
    )
}

/// `R x` for a batch of rotations (N,1,3,3) and vectors (N,3,1,1).
#[track_caller]
pub(crate) fn rotate<'t, T: Scalar>(rotation: Var<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
    let n = x.shape().n();
    rotation.matmul(x.reshape(Shape::new(n, 1, 3, 1))).reshape(Shape::new(n, 3, 1, 1))
}

/// Motion of a network output that always reads its two frames in temporal order.
///
/// **Shapes**: `axis_angle` (N,3,1,1) radians, `translation` (N,3,1,1).
/// For the next frame (`invert` false): `R = exp(w)`, `t = tau`. For the previous frame (`invert` true) the
/// network saw (source, target), so the motion is inverted: `R = exp(w)^T`, `t = -R tau`; its translation in
/// the target frame is then `-tau`.
/// **Panics** on other shapes.
#[track_caller]
pub fn source_from_target<'t, T: Scalar>(
    axis_angle: Var<'t, T>,
    translation: Var<'t, T>,
    invert: bool,
    form: RotationForm,
) -> Pose<'t, T> {
    let pose = Pose { rotation: rotation_matrix(axis_angle, form), translation };
    if invert { pose.inverse() } else { pose }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    #[test]
    fn previous_frame_has_the_negated_network_translation_in_the_target_frame() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(2, 3, 1, 1);
        let (w, tau) = (random(1, shape, -0.1, 0.1), random(2, shape, -1.0, 1.0));
        let pose = source_from_target(tape.leaf(w), tape.leaf(tau.clone()), true, RotationForm::Exponential);
        let a = pose.translation_in_target_frame().value();
        for (a, tau) in a.data().iter().zip(tau.data()) {
            assert!((a + tau).abs() < 1e-14);
        }
    }

    #[test]
    fn agrees_with_the_plain_motions() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(3, 3, 1, 1);
        let (w, tau) = (random::<f64>(5, shape, -0.5, 0.5), random::<f64>(6, shape, -1.0, 1.0));
        let vector = |t: &Tensor<f64>, n: usize| nalgebra::Vector3::from_column_slice(&t.data()[3 * n..3 * n + 3]);
        for invert in [false, true] {
            let pose = source_from_target(tape.leaf(w.clone()), tape.leaf(tau.clone()), invert, RotationForm::Exponential);
            for (n, motion) in pose.to_se3().into_iter().enumerate() {
                let mut expected = Se3::from_rotation_vector(&vector(&w, n), vector(&tau, n));
                if invert {
                    expected = expected.inverse();
                }
                assert!((motion.rotation - expected.rotation).abs().max() < 1e-14);
                assert!((motion.translation - expected.translation).norm() < 1e-14);
            }
        }
        let (r, t) = pose_tensors::<f64>(&[Se3::identity()]);
        assert_eq!((r.at(0, 0, 1, 1), t.data()), (1.0, [0.0; 3].as_slice()));
    }

    #[test]
    fn one_motion_after_another_agrees_with_the_plain_motions_and_has_their_gradient() {
        let shape = Shape::new(2, 3, 1, 1);
        let inputs: Vec<_> = (0..4).map(|i| random::<f64>(10 + i, shape, -0.5, 0.5)).collect();
        fn two<'t>(v: &[Var<'t, f64>]) -> [Pose<'t, f64>; 2] {
            [0, 2].map(|i| source_from_target(v[i], v[i + 1], false, RotationForm::Exponential))
        }
        let tape = Tape::<f64>::new();
        let leaves: Vec<_> = inputs.iter().map(|x| tape.leaf(x.clone())).collect();
        let [a, b] = two(&leaves);
        for ((got, a), b) in a.compose(b).to_se3().into_iter().zip(a.to_se3()).zip(b.to_se3()) {
            let expected = a * b;
            assert!((got.rotation - expected.rotation).abs().max() < 1e-14);
            assert!((got.translation - expected.translation).norm() < 1e-14);
        }
        let check = gradcheck(
            &inputs,
            |_, v| {
                let [a, b] = two(v);
                let both = a.compose(b);
                weighted_sum(both.rotation, 3).add(weighted_sum(both.translation, 4))
            },
            GradCheck::default(),
        );
        check.assert_ok();
    }

    #[test]
    fn gradients_match_differences() {
        let shape = Shape::new(2, 3, 1, 1);
        let inputs = [random(1, shape, -0.3, 0.3), random(2, shape, -1.0, 1.0)];
        for invert in [false, true] {
            let check = gradcheck(
                &inputs,
                |_, v| {
                    let pose = source_from_target(v[0], v[1], invert, RotationForm::Exponential);
                    let a = pose.translation_in_target_frame();
                    weighted_sum(pose.rotation, 3).add(weighted_sum(pose.translation, 4)).add(weighted_sum(a, 5))
                },
                GradCheck::default(),
            );
            check.assert_ok();
        }
    }
}

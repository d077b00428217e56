//! Rotation removed by a network before depth and pose look (SC-Depth V2, auto-rectify): what it means in training and where motions
//! are predicted.
//!
//! The network says the rotation between a target and a source; the source is read as a camera turned like the target's would see
//! it, and everything else works on the target and this image. What the pose network says is then `rectified_from_target`, and
//! the whole motion is the removed rotation after it.

use dimode_autodiff::{Pool, Shape, Tape, Tensor, Var};
use dimode_geometry::taped::so3_exp::rotation_matrix;
use dimode_geometry::taped::{Pose, RotationForm, derotate};
use dimode_geometry::{Intrinsics, Se3};
use dimode_nets::{Binder, Mode, RectifyNet};

use crate::inference::Buffers;
use crate::losses::rectify::rectify;
use crate::losses::view_pair::COLOURS;
use crate::model::{Model, Weights};
use crate::pose_refinement::Pairs;

/// The sources of a batch without rotation, `[2 n, 3, h, w]`, and what the network that removed it is trained by.
pub struct RectifiedSources<'t> {
    /// As depth and pose networks see them.
    pub seen: Tensor<f32>,
    /// As the losses compare them; passes a gradient to the angles.
    pub plain: Var<'t, f32>,
    /// How far a known rotation was missed, radians.
    pub consistency: Var<'t, f32>,
    /// How much less rotation is left than there was, radians.
    pub triplet: Var<'t, f32>,
}

/// Colours around 0, so that what lies outside of an image, which is read as 0, has the mean colour: the programs work on such
/// images, and take what is exactly of this colour for not seen.
fn centred(images: Var<'_, f32>) -> Var<'_, f32> {
    images.add_scalar(-COLOURS[0])
}

fn uncentred(images: Var<'_, f32>) -> Var<'_, f32> {
    images.add_scalar(COLOURS[0])
}

/// Removes the rotation of sources against targets, both `[2 n, 3, h, w]` as the networks see them; `plain` are the same sources as
/// the losses compare them.
pub fn rectified_sources<'t>(
    net: &RectifyNet,
    binder: &mut Binder<'t, f32>,
    [target, seen, plain]: [&Tensor<f32>; 3],
    cameras: &[Intrinsics],
    seed: u64,
) -> RectifiedSources<'t> {
    let tape = binder.tape();
    let [target, seen, plain] = [target, seen, plain].map(|images| centred(tape.constant(images.clone())));
    let said = rectify(target, seen, cameras, seed, |a, b| net.forward(binder, uncentred(a), uncentred(b)));
    RectifiedSources {
        seen: uncentred(said.reference).value(),
        plain: uncentred(derotate(plain, said.rotation, cameras)),
        consistency: said.consistency,
        triplet: said.triplet,
    }
}

impl Model {
    /// Motions `source_from_target` as a trained model predicts them: in a number of looks, after the rotation was removed where
    /// there is a network for it.
    ///
    /// # Panics
    /// As [`Model::motions`].
    pub fn predict_motions(&self, weights: &Weights, pairs: &Pairs<'_>, looks: usize) -> Vec<Se3> {
        self.predict_motions_in(&Pool::new(), weights, pairs, looks)
    }

    /// The same over buffers that stay.
    ///
    /// # Panics
    /// As [`Model::motions`].
    pub fn predict_motions_in(&self, buffers: &Buffers, weights: &Weights, pairs: &Pairs<'_>, looks: usize) -> Vec<Se3> {
        let said = |pairs: &Pairs<'_>| self.motions_in(buffers, &weights.pose, Mode::Eval, pairs, looks);
        let Some(net) = &self.rectify else { return said(pairs) };
        let (source, rotations) = without_rotation(net, weights, pairs);
        let motions = said(&Pairs { source: &source, ..*pairs });
        rotations.iter().zip(motions).map(|(rotation, motion)| *rotation * motion).collect()
    }
}

/// The sources without rotation against the targets, and the rotations `source_from_rectified`.
fn without_rotation(net: &RectifyNet, weights: &Weights, pairs: &Pairs<'_>) -> (Tensor<f32>, Vec<Se3>) {
    let tape = Tape::new();
    let angles = net.predict(&weights.rectify, pairs.target, pairs.source);
    let rotation = rotation_matrix(tape.constant(angles), RotationForm::Euler);
    let source = centred(tape.constant(pairs.source.clone()));
    let source = uncentred(derotate(source, rotation, pairs.cameras)).value();
    let translation = tape.constant(Tensor::zeros(Shape::new(pairs.cameras.len(), 3, 1, 1)));
    (source, Pose { rotation, translation }.to_se3())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{NetsConfig, Rectify};
    use nalgebra::Vector3;

    const SIZE: (usize, usize) = (64, 64);

    fn camera() -> Intrinsics {
        Intrinsics::new(50.0, 52.0, 31.0, 33.0, SIZE.0, SIZE.1).unwrap()
    }

    /// A smooth picture by its pixel coordinates.
    fn picture(c: usize, u: f64, v: f64) -> f32 {
        (0.5 + 0.3 * (0.11 * u + c as f64).sin() * (0.13 * v - 0.4 * c as f64).cos()) as f32
    }

    /// A model whose rectifying network always says these angles.
    fn saying(angles: Vector3<f64>) -> (Model, Weights) {
        let model = Model::new(&NetsConfig { rectify: Rectify::Nano, ..NetsConfig::default() });
        let mut weights = model.init(3);
        let last = |name: &str| format!("rectify:decoder.convs_pose.2.{name}");
        let shape = weights.rectify.get(&last("weight")).unwrap().tensor().shape();
        weights.rectify.set(&last("weight"), Tensor::zeros(shape));
        let shape = weights.rectify.get(&last("bias")).unwrap().tensor().shape();
        weights.rectify.set(&last("bias"), Tensor::from_vec(shape, angles.iter().map(|&x| x as f32).collect()));
        (model, weights)
    }

    /// The pair terms take what is exactly of the mean colour for not seen.
    #[test]
    fn sources_in_training_are_turned_alike_and_what_they_do_not_show_has_the_mean_colour() {
        let (model, weights) = saying(Vector3::new(0.0, 0.2, 0.0));
        let images =
            |shift: f64| Tensor::from_fn(Shape::new(2, 3, SIZE.1, SIZE.0), |_, c, v, u| picture(c, u as f64 + shift, v as f64));
        let (target, seen, plain) = (images(0.0), images(3.0), images(7.0));
        let cameras = [camera(), camera()];
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &weights.rectify, Mode::Train);
        let net = model.rectify.as_ref().unwrap();
        let made = rectified_sources(net, &mut binder, [&target, &seen, &plain], &cameras, 1);
        for (made, source) in [(&made.seen, &seen), (&made.plain.value(), &plain)] {
            let pairs = Pairs { target: &target, source, earlier: 0, depth: None, cameras: &cameras };
            assert_eq!(made.data(), without_rotation(net, &weights, &pairs).0.data());
            // A turn about y of 0.2 rad is some 10 columns.
            let hidden = |u: usize| (0..3).all(|c| made.at(0, c, 30, u) - COLOURS[0] as f32 == 0.0);
            assert!(hidden(SIZE.0 - 1) && !hidden(SIZE.0 / 2) && !hidden(5));
        }
        let bias = tape.backward(made.plain.square().sum()).wrt(binder.param("rectify:decoder.convs_pose.2.bias"));
        assert!(bias.data()[1] != 0.0, "the images teach the angles nothing");
    }

    #[test]
    fn a_turned_camera_is_told_its_turn_and_what_the_pose_network_says_of_the_rest() {
        let angles = Vector3::new(0.03, -0.05, 0.04);
        let (model, weights) = saying(angles);
        let tape = Tape::<f64>::new();
        let euler = rotation_matrix(
            tape.constant(Tensor::from_vec(Shape::new(1, 3, 1, 1), angles.as_slice().to_vec())),
            RotationForm::Euler,
        );
        let turn = Pose { rotation: euler, translation: tape.constant(Tensor::zeros(Shape::new(1, 3, 1, 1))) }.to_se3()[0];
        // The source sees the same far scene from a camera that is turned: the point of target pixel p is at K R K^-1 p.
        let shape = Shape::new(1, 3, SIZE.1, SIZE.0);
        let target = Tensor::from_fn(shape, |_, c, v, u| picture(c, u as f64, v as f64));
        let source = Tensor::from_fn(shape, |_, c, v, u| {
            let ray = turn.rotation.transpose() * camera().ray(u as f64, v as f64);
            let camera = camera();
            picture(c, camera.fu * ray.x / ray.z + camera.u0, camera.fv * ray.y / ray.z + camera.v0)
        });
        let depth = Tensor::full(Shape::new(1, 1, SIZE.1, SIZE.0), 5.0);
        let cameras = [camera()];
        let pairs = |source| Pairs { target: &target, source, earlier: 0, depth: Some(&depth), cameras: &cameras };
        let (level, turns) = without_rotation(model.rectify.as_ref().unwrap(), &weights, &pairs(&source));
        assert!((turns[0].rotation - turn.rotation).norm() < 1e-6);
        for (v, u) in (8..56).flat_map(|v| (8..56).map(move |u| (v, u))) {
            assert!((level.at(0, 1, v, u) - target.at(0, 1, v, u)).abs() < 2e-3, "row {v}, column {u}");
        }
        let said = model.predict_motions(&weights, &pairs(&source), 2)[0];
        let rest = model.motions(&weights.pose, Mode::Eval, &pairs(&level), 2)[0];
        assert!((said.rotation - turn.rotation * rest.rotation).norm() < 1e-6);
        assert!((said.translation - turn.rotation * rest.translation).norm() < 1e-6);
        let without = Model { rectify: None, ..model.clone() };
        let plain = without.predict_motions(&weights, &pairs(&source), 2)[0];
        assert_eq!(plain.rotation, model.motions(&weights.pose, Mode::Eval, &pairs(&source), 2)[0].rotation);
    }
}

//! Cross-task consistency of DF-Net and the depth consistency of DCPI-Depth.

use dimode::losses::contextual_geometric::{
    ContextualForm, ContextualInputs, TriangulatedForm, radial_depth, stretched, triangulated_depth,
};
use dimode::losses::cross_task::cross_task;
use dimode::losses::gated::Gated;
use dimode_autodiff::{Scalar, Tape, Tensor, Var, pixel_grid};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{Divisor, Pose, RotationForm, back_project, project, source_from_target};

use crate::compared::Compared;

/// Inputs in the order of the stored gradients' names.
const LEAVES: [&str; 4] = ["flow", "depth_t", "axisangle", "translation"];

/// The rigid flow of the reference, which divides by the depth plus 1e-7.
fn guarded_flow<'t, T: Scalar>(depth: Var<'t, T>, pose: Pose<'t, T>, intrinsics: &[Intrinsics]) -> Var<'t, T> {
    let points = back_project(depth, intrinsics);
    let seen = project(points, pose.rotation, pose.translation, intrinsics, Divisor::PlusGuard);
    seen.pixels.sub(depth.tape().constant(pixel_grid(depth.shape())))
}

struct Scene<'t, T: Scalar> {
    leaves: Vec<(&'static str, Var<'t, T>)>,
    pose: Pose<'t, T>,
    intrinsics: Vec<Intrinsics>,
    /// Flow of the rotation alone.
    rotational: Tensor<T>,
}

impl<'t, T: Scalar> Scene<'t, T> {
    fn new(c: &Compared<T>, tape: &'t Tape<T>) -> Self {
        let leaf = |name: &'static str| {
            let stored = format!("in.{name}");
            (name, if name.starts_with(['a', 't']) { tape.leaf(c.vectors(&stored)) } else { c.leaf(tape, &stored) })
        };
        let leaves: Vec<_> = LEAVES.map(leaf).to_vec();
        let pose = source_from_target(leaves[2].1, leaves[3].1, false, RotationForm::Guarded);
        let intrinsics = c.cameras();
        let turn = Pose { translation: pose.translation.scale(0.0), ..pose };
        let rotational = guarded_flow(leaves[1].1, turn, &intrinsics).value();
        Self { leaves, pose, intrinsics, rotational }
    }

    fn inputs(&self) -> ContextualInputs<'_, 't, T> {
        ContextualInputs {
            flow: self.leaves[0].1,
            depth: self.leaves[1].1,
            rotation: self.pose.rotation,
            translation: self.pose.translation,
            rotational: &self.rotational,
            intrinsics: &self.intrinsics,
        }
    }
}

fn check_cross_task<T: Scalar>(c: &Compared<T>) {
    let tape = Tape::new();
    let scene = Scene::new(c, &tape);
    let rigid = guarded_flow(scene.leaves[1].1, scene.pose, &scene.intrinsics);
    c.matches("out.rigid_flow", &rigid.value());
    let loss = cross_task(rigid, scene.leaves[0].1, &c.map("in.mask"));
    c.matches("out.cross_task", &loss.value());
    c.gradients_match("grad_cross_task", &tape.backward(loss), &scene.leaves);
}

/// The map is stored with errors above a million cut.
fn check_map<T: Scalar>(c: &Compared<T>, name: &str, errors: &Tensor<T>) {
    let cut = errors.data().iter().map(|e| e.min(T::from_f64(1e6))).collect();
    c.matches(name, &Tensor::from_vec(errors.shape(), cut));
}

fn check_depth_consistency<T: Scalar>(c: &Compared<T>) {
    let tape = Tape::new();
    let scene = Scene::new(c, &tape);
    c.matches("out.rot_flow", &scene.rotational);
    c.matches("out.rot_flow_repo", &stretched(&scene.rotational));
    let check_mean = |name: &str, gated: &Gated<'_, T>| {
        c.matches(&format!("out.{name}"), &gated.mean.value());
        c.gradients_match(&format!("grad_{name}"), &tape.backward(gated.mean), &scene.leaves);
    };
    for (suffix, form) in [("", ContextualForm::ImageCentre), ("_repo", ContextualForm::AsCoded)] {
        let gated = radial_depth(&scene.inputs(), form);
        check_map(c, &format!("out.cgdc_v2_ratio{suffix}"), &gated.errors);
        check_mean(&format!("cgdc_v2{suffix}"), &gated);
    }
    check_mean("cgdc_v1_corrected", &triangulated_depth(&scene.inputs(), TriangulatedForm::Corrected));
}

fn check<T: Scalar>() {
    let c = Compared::<T>::open("competitors");
    check_cross_task(&c);
    check_depth_consistency(&c);
    c.finish();
}

#[test]
fn every_loss_matches_in_both_precisions() {
    check::<f64>();
    check::<f32>();
}

/// The reference has only this figure of the triangulation as the public code does it.
#[test]
fn the_public_triangulation_is_as_wrong_as_reported() {
    let c = Compared::<f64>::open("competitors");
    let tape = Tape::new();
    let loss = triangulated_depth(&Scene::new(&c, &tape).inputs(), TriangulatedForm::AsCoded).mean.value().item();
    assert!((loss - 0.975).abs() < 5e-4, "{loss}");
}

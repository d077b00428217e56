//! The pair terms of both SC-Depth programs.

use dimode::losses::view_pair::{View, ViewPair};
use dimode::losses::{sc_depth_pair, sc_sfm_pair};
use dimode_autodiff::{Scalar, Shape, Tape, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::so3_exp::rotation_matrix;
use dimode_geometry::taped::{Pose, RotationForm, SampleGrid};

use crate::compared::Compared;
use crate::warp::normalised;

/// Variables of the stored scene: target image, reference image, their depths and the pose, translation first.
struct Scene<'t, T: Scalar> {
    target: View<'t, T>,
    reference: View<'t, T>,
    pose: Var<'t, T>,
}

impl<'t, T: Scalar> Scene<'t, T> {
    fn new(tape: &'t Tape<T>, golden: &Compared<T>) -> Self {
        let view = |who: &str| View {
            image: tape.leaf(golden.map(&format!("in.{who}_img"))),
            depth: tape.leaf(golden.map(&format!("in.{who}_depth"))),
        };
        let pose = tape.leaf(golden.golden().tensor("in.pose", Shape::new(2, 6, 1, 1)));
        Scene { target: view("tgt"), reference: view("ref"), pose }
    }

    fn pair<'a>(&self, intrinsics: &'a [Intrinsics]) -> ViewPair<'a, 't, T> {
        let rotation = rotation_matrix(self.pose.slice(1, 3, 3), RotationForm::Euler);
        let motion = Pose { rotation, translation: self.pose.slice(1, 0, 3) };
        ViewPair { target: self.target, reference: self.reference, motion, intrinsics }
    }

    fn compare(&self, golden: &Compared<T>, name: &str, loss: Var<'t, T>) {
        golden.matches(&format!("out.{name}"), &loss.value());
        let grads = self.pose.tape().backward(loss);
        let (target, reference) = (self.target.depth, self.reference.depth);
        let inputs = [("tgt_depth", target), ("ref_depth", reference), ("pose", self.pose), ("ref_img", self.reference.image)];
        golden.gradients_match(&format!("grad_{name}"), &grads, &inputs);
    }
}

fn later_program<T: Scalar>(golden: &Compared<T>) {
    let tape = Tape::new();
    let scene = Scene::new(&tape, golden);
    let maps = sc_depth_pair::pair_maps(&scene.pair(&golden.cameras()), SampleGrid::HalfPixelAsCoded);
    for (name, map) in [
        ("pix", maps.pixels),
        ("warped", maps.warped.image),
        ("computed", maps.computed_depth),
        ("projected", maps.warped.depth),
        ("diff_depth", maps.depth_difference),
        ("diff_color", maps.colour_difference),
        ("diff_img", maps.image_difference),
    ] {
        golden.matches(&format!("out.pl_{name}"), &map.value());
    }
    golden.mask_matches("out.pl_auto", &maps.auto_mask);
    golden.mask_matches("out.pl_valid", &maps.valid);
    let loss = sc_depth_pair::pair_loss(&[maps], sc_depth_pair::MIN_PIXELS);
    scene.compare(golden, "pl_photo", loss.photo);
    scene.compare(golden, "pl_geometry", loss.geometry);
}

fn first_program<T: Scalar>(golden: &Compared<T>) {
    let tape = Tape::new();
    let scene = Scene::new(&tape, golden);
    let maps = sc_sfm_pair::pair_maps(&scene.pair(&golden.cameras()), SampleGrid::HalfPixelAsCoded);
    golden.numbers_match("out.rel_grid", &normalised(&maps.pixels.value()));
    for (name, map) in [
        ("warped", maps.warped.image),
        ("computed", maps.computed_depth),
        ("projected", maps.warped.depth),
        ("diff_depth", maps.depth_difference),
        ("diff_img", maps.image_difference),
    ] {
        golden.matches(&format!("out.rel_{name}"), &map.value());
    }
    golden.mask_matches("out.rel_valid", &maps.in_view);
    golden.mask_matches("out.rel_mask", &maps.valid);
    let loss = sc_sfm_pair::pair_loss(&[maps], 0);
    scene.compare(golden, "rel_photo", loss.photo);
    scene.compare(golden, "rel_geometry", loss.geometry);
}

fn pairs_in<T: Scalar>() {
    let golden = Compared::<T>::open("sc_geometry");
    later_program(&golden);
    first_program(&golden);
    golden.finish();
}

#[test]
fn pair_terms_of_both_programs() {
    pairs_in::<f64>();
    pairs_in::<f32>();
}

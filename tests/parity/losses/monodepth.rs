//! Disparity to depth, and the total over several scales.

use dimode::losses::multi_scale::{MultiScale, Reprojection, SMOOTHNESS, multi_scale};
use dimode::losses::photometric::photometric_value;
use dimode::model::DepthRange;
use dimode_autodiff::{Scalar, Tape};
use dimode_geometry::taped::{RotationForm, source_from_target};

use crate::compared::Compared;

fn depth_in<T: Scalar>() {
    let golden = Compared::<T>::open("disp_depth");
    let tape = Tape::new();
    let disp = tape.leaf(golden.map("in.disp"));
    golden.matches("out.scaled_disp", &DepthRange::MONODEPTH.inverse_depth(disp).value());
    let depth = DepthRange::MONODEPTH.depth(disp);
    golden.matches("out.depth", &depth.value());
    let grads = tape.backward(depth.mul(tape.constant(golden.map("in.w"))).sum());
    golden.gradients_match("grad", &grads, &[("disp", disp)]);
    golden.finish();
}

#[test]
fn depth_of_disparities() {
    depth_in::<f64>();
    depth_in::<f32>();
}

fn total_in<T: Scalar>() {
    let golden = Compared::<T>::open("monodepth_total");
    let tape = Tape::new();
    let disparities = [0, 1, 2, 3].map(|s| tape.leaf(golden.map(&format!("in.disp_{s}"))));
    let targets = [0, 1, 2, 3].map(|s| golden.map(&format!("in.color_{s}")));
    let sources = ["in.src_prev", "in.src_next"].map(|name| golden.map(name));
    let vectors = |name: &str| ["prev", "next"].map(|s| tape.leaf(golden.vectors(&format!("in.{name}_{s}"))));
    let (turns, shifts) = (vectors("axisangle"), vectors("translation"));
    let motions = [0, 1].map(|k| source_from_target(turns[k], shifts[k], k == 0, RotationForm::Guarded));
    let identities = sources.each_ref().map(|source| photometric_value(source, &targets[0]));
    let loss = multi_scale(&MultiScale {
        disparities: &disparities,
        range: DepthRange::MONODEPTH,
        targets: &targets,
        sources: &sources,
        motions: &motions,
        intrinsics: &golden.cameras(),
        identities: &identities,
        smoothness: SMOOTHNESS,
        reprojection: Reprojection::AsCoded,
    });
    for (s, scale) in loss.scales.iter().enumerate() {
        golden.matches(&format!("out.photo_{s}"), &scale.photo.value());
        golden.matches(&format!("out.smooth_{s}"), &scale.smooth.value());
    }
    golden.matches("out.total", &loss.total.value());
    let grads = tape.backward(loss.total);
    for (s, disparity) in disparities.into_iter().enumerate() {
        golden.gradients_match("grad", &grads, &[(&format!("disp_{s}"), disparity)]);
    }
    for (k, source) in ["prev", "next"].into_iter().enumerate() {
        let names = ["axisangle", "translation"].map(|name| format!("{name}_{source}"));
        golden.gradients_match("grad", &grads, &[(&names[0], turns[k]), (&names[1], shifts[k])]);
    }
    golden.finish();
}

#[test]
fn total_over_four_scales() {
    total_in::<f64>();
    total_in::<f32>();
}

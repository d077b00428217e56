//! Photometric error, minimum reprojection, smoothness, normals and pseudo-depth.

use dimode::losses::guided_filter::self_guided_with;
use dimode::losses::local_structure::normals;
use dimode::losses::min_reprojection::min_reprojection;
use dimode::losses::photometric::{photometric, photometric_value};
use dimode::losses::smoothness::smoothness;
use dimode_autodiff::{Tape, Tensor, Var};
use dimode_tests::Golden;

use crate::support::{cameras, close_to_scale, open};

/// Compares with the stored tensor `name`, within a share of its largest value.
#[track_caller]
fn matches(golden: &Golden, name: &str, found: &Tensor<f64>, share: f64) {
    close_to_scale(name, found.data(), golden.numbers(name), share);
}

#[test]
fn photometric_error_and_both_gradients() {
    let golden = open("photometric");
    let tape = Tape::new();
    let (pred, target) = (tape.leaf(golden.map("in.pred")), tape.leaf(golden.map("in.target")));
    let error = photometric(pred, target);
    matches(&golden, "out.photo", &error.value(), 1e-10);
    let loss = error.mean();
    matches(&golden, "out.loss", &loss.value(), 1e-10);
    let grads = tape.backward(loss);
    matches(&golden, "grad.pred", &grads.wrt(pred), 1e-8);
    matches(&golden, "grad.target", &grads.wrt(target), 1e-8);
}

#[test]
fn minimum_reprojection_with_and_without_auto_mask() {
    let golden = open("min_reproj");
    let target = golden.map("in.target");
    let identities: Vec<_> = ["in.src_prev", "in.src_next"].iter().map(|s| photometric_value(&golden.map(s), &target)).collect();
    for (identities, value, prefix) in [(identities, "out.loss", "grad"), (vec![], "out.loss_no_automask", "grad_no_automask")] {
        let tape = Tape::new();
        let warped = ["prev", "next"].map(|s| tape.leaf(golden.map(&format!("in.warped_{s}"))));
        let t = tape.constant(target.clone());
        let errors: Vec<Var<'_, f64>> = warped.iter().map(|w| photometric(*w, t)).collect();
        let best = min_reprojection(&errors, &identities);
        if !identities.is_empty() {
            matches(&golden, "out.min", &best.error.value(), 1e-10);
        }
        let loss = best.error.mean();
        matches(&golden, value, &loss.value(), 1e-10);
        let grads = tape.backward(loss);
        for (w, s) in warped.iter().zip(["prev", "next"]) {
            matches(&golden, &format!("{prefix}.warped_{s}"), &grads.wrt(*w), 1e-8);
        }
    }
}

#[test]
fn smoothness_of_the_normalised_disparity() {
    let golden = open("smoothness");
    let tape = Tape::new();
    let disp = tape.leaf(golden.map("in.disp"));
    let loss = smoothness(disp, &golden.map("in.image"));
    matches(&golden, "out.normalised", &loss.value(), 1e-10);
    matches(&golden, "grad_normalised.disp", &tape.backward(loss).wrt(disp), 1e-8);
}

#[test]
fn normals_of_a_depth_map() {
    let golden = open("normals");
    let tape = Tape::new();
    let depth = tape.leaf(golden.map("in.depth"));
    let found = normals(depth, &cameras(&golden));
    matches(&golden, "out.normals", &found.value(), 1e-10);
    let loss = found.mul(tape.constant(golden.map("in.w"))).sum();
    matches(&golden, "grad.depth", &tape.backward(loss).wrt(depth), 1e-8);
}

#[test]
fn self_guided_pseudo_depth() {
    let golden = open("pseudo_guided");
    let found = self_guided_with(&golden.map("in.depth"), &golden.map("in.image"), 4);
    matches(&golden, "out.pseudo_depth", &found, 1e-10);
}

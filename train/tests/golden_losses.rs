//! Photometric, minimum-reprojection, smoothness, normal and pseudo-depth numbers of the reference implementations.
//!
//! Where the files come from is told in `tests/golden/losses/README.md` of the workspace.

use std::path::PathBuf;

use dimode::losses::guided_filter::self_guided_with;
use dimode::losses::local_structure::normals;
use dimode::losses::min_reprojection::min_reprojection;
use dimode::losses::photometric::{photometric, photometric_value};
use dimode::losses::smoothness::smoothness;
use dimode_autodiff::{Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use safetensors::SafeTensors;

struct Golden(Vec<u8>);

impl Golden {
    fn open(name: &str) -> Self {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/losses").join(name);
        Golden(std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
    }

    fn get(&self, name: &str) -> Tensor<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let view = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let values: Vec<f64> = view.data().chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
        let mut dims = [1; 4];
        let rank = view.shape().len();
        dims[4 - rank..].copy_from_slice(view.shape());
        Tensor::from_vec(Shape(dims), values)
    }
}

#[track_caller]
fn assert_close(what: &str, got: &Tensor<f64>, want: &Tensor<f64>, tolerance: f64) {
    assert_eq!(got.shape().len(), want.shape().len(), "{what}");
    let scale = want.data().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    for (i, (g, w)) in got.data().iter().zip(want.data()).enumerate() {
        assert!((g - w).abs() <= tolerance * scale.max(1e-300), "{what}[{i}]: {g} against {w} (largest {scale})");
    }
}

fn cameras(k: &Tensor<f64>, width: usize, height: usize) -> Vec<Intrinsics> {
    // [n, 3, 3] is read as [1, n, 3, 3]
    (0..k.shape().c())
        .map(|n| Intrinsics::new(k.at(0, n, 0, 0), k.at(0, n, 1, 1), k.at(0, n, 0, 2), k.at(0, n, 1, 2), width, height).unwrap())
        .collect()
}

#[test]
fn photometric_error_and_both_gradients() {
    let golden = Golden::open("photometric.f64.safetensors");
    let tape = Tape::new();
    let (pred, target) = (tape.leaf(golden.get("in.pred")), tape.leaf(golden.get("in.target")));
    let error = photometric(pred, target);
    assert_close("photo", &error.value(), &golden.get("out.photo"), 1e-10);
    let loss = error.mean();
    assert_close("loss", &loss.value(), &golden.get("out.loss"), 1e-10);
    let grads = tape.backward(loss);
    assert_close("grad.pred", &grads.wrt(pred), &golden.get("grad.pred"), 1e-8);
    assert_close("grad.target", &grads.wrt(target), &golden.get("grad.target"), 1e-8);
}

#[test]
fn minimum_reprojection_with_and_without_auto_mask() {
    let golden = Golden::open("min_reproj.f64.safetensors");
    let target = golden.get("in.target");
    let identities: Vec<_> = ["in.src_prev", "in.src_next"].iter().map(|s| photometric_value(&golden.get(s), &target)).collect();
    for (identities, value, prefix) in [(identities, "out.loss", "grad"), (vec![], "out.loss_no_automask", "grad_no_automask")] {
        let tape = Tape::new();
        let warped = ["prev", "next"].map(|s| tape.leaf(golden.get(&format!("in.warped_{s}"))));
        let t = tape.constant(target.clone());
        let errors: Vec<Var<'_, f64>> = warped.iter().map(|w| photometric(*w, t)).collect();
        let best = min_reprojection(&errors, &identities);
        if !identities.is_empty() {
            assert_close("min", &best.error.value(), &golden.get("out.min"), 1e-10);
        }
        let loss = best.error.mean();
        assert_close(value, &loss.value(), &golden.get(value), 1e-10);
        let grads = tape.backward(loss);
        for (w, s) in warped.iter().zip(["prev", "next"]) {
            assert_close(s, &grads.wrt(*w), &golden.get(&format!("{prefix}.warped_{s}")), 1e-8);
        }
    }
}

#[test]
fn smoothness_of_the_normalised_disparity() {
    let golden = Golden::open("smoothness.f64.safetensors");
    let tape = Tape::new();
    let disp = tape.leaf(golden.get("in.disp"));
    let loss = smoothness(disp, &golden.get("in.image"));
    assert_close("normalised", &loss.value(), &golden.get("out.normalised"), 1e-10);
    assert_close("grad", &tape.backward(loss).wrt(disp), &golden.get("grad_normalised.disp"), 1e-8);
}

#[test]
fn normals_of_a_depth_map() {
    let golden = Golden::open("normals.f64.safetensors");
    let tape = Tape::new();
    let depth = tape.leaf(golden.get("in.depth"));
    let shape = depth.shape();
    let found = normals(depth, &cameras(&golden.get("in.K"), shape.w(), shape.h()));
    assert_close("normals", &found.value(), &golden.get("out.normals"), 1e-10);
    let loss = found.mul(tape.constant(golden.get("in.w"))).sum();
    assert_close("grad", &tape.backward(loss).wrt(depth), &golden.get("grad.depth"), 1e-8);
}

#[test]
fn self_guided_pseudo_depth() {
    let golden = Golden::open("pseudo_guided.f64.safetensors");
    let found = self_guided_with(&golden.get("in.depth"), &golden.get("in.image"), 4);
    assert_close("pseudo depth", &found, &golden.get("out.pseudo_depth"), 1e-10);
}

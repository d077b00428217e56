//! Dissimilarity, photometric error, minimum reprojection and smoothness.

use dimode::losses::min_reprojection::{average_reprojection, min_reprojection};
use dimode::losses::photometric::{absolute_difference, photometric, photometric_value};
use dimode::losses::smoothness::{edge_aware, edge_aware_of_both, mean_normalised, smoothness};
use dimode::losses::ssim::{Border, dissimilarity};
use dimode_autodiff::{Scalar, Tape, Tensor, Var};

use crate::compared::Compared;

fn ssim_in<T: Scalar>() {
    let golden = Compared::<T>::open("ssim");
    for (name, window, border) in
        [("dissim3", 3, Border::Mirrored), ("dissim7", 7, Border::Mirrored), ("dissim3_valid", 3, Border::LeftOut)]
    {
        let tape = Tape::new();
        let (x, y) = (tape.leaf(golden.map("in.x")), tape.leaf(golden.map("in.y")));
        let map = dissimilarity(x, y, window, border);
        golden.matches(&format!("out.{name}"), &map.value());
        let loss = map.mul(tape.constant(golden.map(&format!("in.w_{name}")))).sum();
        golden.gradients_match(&format!("grad_{name}"), &tape.backward(loss), &[("x", x), ("y", y)]);
    }
    golden.finish();
}

#[test]
fn dissimilarity_in_windows_of_three_and_seven() {
    ssim_in::<f64>();
    ssim_in::<f32>();
}

fn photometric_in<T: Scalar>() {
    let golden = Compared::<T>::open("photometric");
    let tape = Tape::new();
    let (pred, target) = (tape.leaf(golden.map("in.pred")), tape.leaf(golden.map("in.target")));
    golden.matches("out.l1", &absolute_difference(pred, target).value());
    let error = photometric(pred, target);
    golden.matches("out.photo", &error.value());
    let loss = error.mean();
    golden.matches("out.loss", &loss.value());
    golden.gradients_match("grad", &tape.backward(loss), &[("pred", pred), ("target", target)]);
    golden.finish();
}

#[test]
fn photometric_error_and_both_gradients() {
    photometric_in::<f64>();
    photometric_in::<f32>();
}

/// The values of maps of one channel, sample by sample, one map after the other.
fn stacked<T: Scalar>(maps: &[Tensor<T>]) -> Vec<f64> {
    let samples = 0..maps[0].shape().n();
    samples.flat_map(|n| maps.iter().flat_map(move |m| m.plane(n, 0)).map(|x| x.to_f64())).collect()
}

fn min_reprojection_in<T: Scalar>() {
    let golden = Compared::<T>::open("min_reproj");
    let target = golden.map("in.target");
    let identities = ["in.src_prev", "in.src_next"].map(|s| photometric_value(&golden.map(s), &target));
    golden.numbers_match("out.identity", &stacked(&identities));
    for (identities, value, prefix) in [(&identities[..], "out.loss", "grad"), (&[], "out.loss_no_automask", "grad_no_automask")]
    {
        let tape = Tape::new();
        let warped = ["prev", "next"].map(|s| tape.leaf(golden.map(&format!("in.warped_{s}"))));
        let t = tape.constant(target.clone());
        let errors: Vec<Var<'_, T>> = warped.iter().map(|w| photometric(*w, t)).collect();
        let best = min_reprojection(&errors, identities);
        if !identities.is_empty() {
            golden.numbers_match("out.reprojection", &stacked(&errors.iter().map(|e| e.value()).collect::<Vec<_>>()));
            golden.matches("out.min", &best.error.value());
            golden.labels_match("out.argmin", best.winners.iter().map(|&w| f64::from(w)));
            golden.mask_matches("out.automask", &best.mask);
        }
        let loss = best.error.mean();
        golden.matches(value, &loss.value());
        let inputs = [("warped_prev", warped[0]), ("warped_next", warped[1])];
        golden.gradients_match(prefix, &tape.backward(loss), &inputs);
        golden.matches("out.loss_avg", &average_reprojection(&errors, &[]).error.mean().value());
    }
    golden.finish();
}

#[test]
fn minimum_reprojection_with_and_without_auto_mask_and_on_average() {
    min_reprojection_in::<f64>();
    min_reprojection_in::<f32>();
}

fn smoothness_in<T: Scalar>() {
    let golden = Compared::<T>::open("smoothness");
    let image = golden.map("in.image");
    for name in ["raw", "normalised"] {
        let tape = Tape::new();
        let (disp, images) = (tape.leaf(golden.map("in.disp")), tape.leaf(image.clone()));
        let (map, fixed) = match name {
            "raw" => (disp, edge_aware(disp, &image, 1.0)),
            _ => (mean_normalised(disp), smoothness(disp, &image)),
        };
        golden.matches(&format!("out.{name}"), &fixed.value());
        golden.gradients_match(&format!("grad_{name}"), &tape.backward(fixed), &[("disp", disp)]);
        let both = edge_aware_of_both(map, images, 1.0);
        golden.matches(&format!("out.{name}"), &both.value());
        golden.gradients_match(&format!("grad_{name}"), &tape.backward(both), &[("disp", disp), ("image", images)]);
    }
    golden.finish();
}

#[test]
fn smoothness_of_the_disparity_as_it_is_and_divided_by_its_mean() {
    smoothness_in::<f64>();
    smoothness_in::<f32>();
}

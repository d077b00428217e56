//! Losses of optical flow: census, smoothness, supervised sequence.

use dimode::losses::census::{CensusForm, census, census_distance, framed, grey};
use dimode::losses::flow_smoothness::{FlowSmoothness, flow_smoothness};
use dimode::losses::raft_sequence::raft_sequence;
use dimode_autodiff::{Scalar, Tape, Tensor};

use crate::compared::Compared;

fn check_census<T: Scalar>(c: &Compared<T>) {
    let tape = Tape::new();
    let (a, b) = (c.leaf(&tape, "in.image_a"), c.leaf(&tape, "in.image_b"));
    let mask: Tensor<T> = c.map("in.mask");
    let all = Tensor::full(mask.shape(), T::ONE);

    let frame = tape.constant(framed(&all, 1));
    let map = census_distance(grey(a), grey(b), 1).scale(1.0 / 9.0).mul(frame);
    c.matches("out.census3_map", &map.value());
    let loss = census(a, b, &all, CensusForm::ArFlow);
    c.matches("out.census3", &loss.value());
    c.gradients_match("grad_census3", &tape.backward(loss), &[("image_b", b)]);

    c.matches("out.census7_hamming", &census_distance(grey(a), grey(b), 3).value());
    let loss = census(a, b, &mask, CensusForm::Smurf);
    c.matches("out.census7", &loss.value());
    c.gradients_match("grad_census7", &tape.backward(loss), &[("image_b", b)]);

    c.matches("out.ternary_unflow_r3", &census(a, b, &mask, CensusForm::UnFlow { radius: 3 }).value());
}

fn check_smoothness<T: Scalar>(c: &Compared<T>) {
    let image = c.map("in.image_a");
    for (name, form) in [
        ("smooth2_arflow", FlowSmoothness::Second { edge: 10.0 }),
        ("smooth2_smurf", FlowSmoothness::SecondWide { edge: 150.0 }),
        ("smooth1_dfvo", FlowSmoothness::Length),
    ] {
        let tape = Tape::new();
        let flow = c.leaf(&tape, "in.flow");
        let loss = flow_smoothness(flow, &image, form);
        c.matches(&format!("out.{name}"), &loss.value());
        c.gradients_match(&format!("grad_{name}"), &tape.backward(loss), &[("flow", flow)]);
    }
}

fn check_sequence<T: Scalar>(c: &Compared<T>) {
    let tape = Tape::new();
    let predictions = [0, 1, 2].map(|i| c.leaf(&tape, &format!("in.pred_{i}")));
    let loss = raft_sequence(&predictions, &c.map("in.flow_gt"), &c.map("in.valid"));
    c.matches("out.raft_sequence", &loss.value());
    let leaves = ["pred_0", "pred_1", "pred_2"].into_iter().zip(predictions).collect::<Vec<_>>();
    c.gradients_match("grad_raft", &tape.backward(loss), &leaves);
}

fn check<T: Scalar>() {
    let c = Compared::<T>::open("flow_losses");
    check_census(&c);
    check_smoothness(&c);
    check_sequence(&c);
    c.finish();
}

#[test]
fn every_loss_matches_in_both_precisions() {
    check::<f64>();
    check::<f32>();
}

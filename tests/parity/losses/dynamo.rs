//! The terms of Dynamo-Depth.

use dimode::losses::dynamo::{consistency, mask_smoothness, sparsity};
use dimode_autodiff::{Scalar, Shape, Tape, Tensor};
use dimode_geometry::taped::masks;

use crate::compared::Compared;

/// Positions in pixels of a stored sampling grid, whose units run from -1 to 1 and whose components come last.
fn positions<T: Scalar>(c: &Compared<T>, name: &str) -> Tensor<T> {
    let grid = c.golden().tensor::<T>(name, Shape::new(2, 24, 32, 2));
    Tensor::from_fn(Shape::new(2, 2, 24, 32), |n, k, h, w| {
        let size = T::from_usize([32, 24][k] - 1);
        (grid.at(n, h, w, k) + T::ONE) * T::from_f64(0.5) * size
    })
}

fn check<T: Scalar>() {
    let c = Compared::<T>::open("dynamo");
    let tape = Tape::new();
    let (logit, residual) = (c.leaf(&tape, "in.logit"), c.leaf(&tape, "in.residual_flow"));
    let mask = logit.sigmoid();
    c.matches("out.mask", &mask.value());

    let loss = consistency(residual, &mask.value(), &c.map("in.disp"));
    c.matches("out.c_consistency", &loss.value());
    c.gradients_match("grad_c_consistency", &tape.backward(loss), &[("residual_flow", residual), ("logit", logit)]);

    let still = masks::static_on_grid(&positions(&c, "in.grid_ego"), &positions(&c, "in.grid_complete"));
    c.mask_matches("out.static", &still);
    let loss = sparsity(logit, &still);
    c.matches("out.m_sparsity", &loss.value());
    c.gradients_match("grad_m_sparsity", &tape.backward(loss), &[("logit", logit)]);

    let loss = mask_smoothness(mask, &c.map("in.image"));
    c.matches("out.m_smooth", &loss.value());
    c.gradients_match("grad_m_smooth", &tape.backward(loss), &[("logit", logit)]);
    c.finish();
}

#[test]
fn every_term_matches_in_both_precisions() {
    check::<f64>();
    check::<f32>();
}

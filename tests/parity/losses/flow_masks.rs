//! Visibility and static masks from optical flow.

use dimode_autodiff::{Scalar, Tensor};
use dimode_geometry::taped::{masks, visibility};

use crate::compared::Compared;

/// The mask's complement.
fn other<T: Scalar>(mask: &Tensor<T>) -> Tensor<T> {
    Tensor::from_vec(mask.shape(), mask.data().iter().map(|&m| T::ONE - m).collect())
}

fn check<T: Scalar>() {
    let c = Compared::<T>::open("flow_masks");
    let (forward, backward, rigid) = (c.map("in.flow_fw"), c.map("in.flow_bw"), c.map("in.rigid_flow"));
    c.matches("out.bw_warped", &masks::backward_at_forward(&forward, &backward));
    let test = visibility::forward_backward(&forward, &backward);
    c.matches("out.fb_sq", &test.deviation);
    c.matches("out.fb_threshold", &test.allowed);
    c.mask_matches("out.occluded_fb", &other(&masks::not_occluded(&forward, &backward)));
    c.matches("out.dfvo_norm", &visibility::consistency_score(&forward, &backward));
    c.mask_matches("out.in_view", &masks::in_view(&forward));
    c.matches("out.range_map", &visibility::range_map(&backward));
    c.mask_matches("out.occluded_range_020", &other(&visibility::reached(&backward, 0.2)));
    c.matches("out.dynamo_mag", &masks::squared_grid_distance(&rigid, &forward));
    c.mask_matches("out.dynamo_static", &masks::static_on_grid(&rigid, &forward));
    c.mask_matches("out.static_px_per_image", &masks::static_pixels(&rigid, &forward, None));
    c.finish();
}

#[test]
fn every_mask_and_map_matches_in_both_precisions() {
    check::<f64>();
    check::<f32>();
}

//! One claim, one file.

use super::claim::Claim;

mod l01_intrinsics;
mod l02_direction_of_t;
mod l03_rigid_flow;
mod l04_warp;
mod l05_photometric;
mod l06_decomposition;
mod l07_rot_homography;
mod l08_rot_flow;
mod l09_rot_flow_inline;
mod l10_rot_flow_nonlinear;
mod l11_rot_depth_free;
mod l12_rot_flow_first_order;
mod l13_footnote_order;
mod l14_tan_flow;
mod l15_rad_flow;
mod l16_scale_change;
mod l17_combined_flow;
mod l18_grad_z;
mod l19_grad_tx_ty;
mod l20_grad_tz;
mod l21_grad_z_claim;
mod l22_cross_influence;
mod l23_ideal_decomposition;
mod l24_residual_rows;
mod l25_residual_remark;
mod l26_axis_plane_equivalence;
mod l27_backprojection;
mod l28_align_printed;
mod l29_align_target_frame;
mod l30_align_source_to_target;
mod l31_align_rotated_target;
mod l32_align_residual;
mod l33_align_kitti;
mod l34_residual_target_frame;
mod l35_align_jacobian;
mod l36_direction_claims;
mod l37_lpla_zero_set;
mod l38_lpla_gradient;
mod l39_lpla_variants;
mod l40_lpla_noise;
mod l41_laxi_sign;
mod l42_laxi_snippet;
mod l43_laxi_repeller;
mod l44_laxi_variants;
mod l45_laxi_noise;
mod l46_independence;
mod l47_sensitivity;
mod l48_axi_confusion;
mod l49_observability;
mod l50_principal_point;
mod l51_rho_xy;
mod l52_rho_z;
mod l53_recovery;
mod l54_cycle;
mod l55_tx_to_zero;
mod l56_scale_invariance;
mod l57_ratio_bias;
mod l58_recovery_bias;
mod l59_pixel_term_gradient;
mod l60_rho_z_noise;
mod l61_rotation_leak;
mod l62_loss_gradients;
mod l63_percentages;
mod l64_counts;

static ALL: &[&Claim] = &[
    &l01_intrinsics::CLAIM,
    &l02_direction_of_t::CLAIM,
    &l03_rigid_flow::CLAIM,
    &l04_warp::CLAIM,
    &l05_photometric::CLAIM,
    &l06_decomposition::CLAIM,
    &l07_rot_homography::CLAIM,
    &l08_rot_flow::CLAIM,
    &l09_rot_flow_inline::CLAIM,
    &l10_rot_flow_nonlinear::CLAIM,
    &l11_rot_depth_free::CLAIM,
    &l12_rot_flow_first_order::CLAIM,
    &l13_footnote_order::CLAIM,
    &l14_tan_flow::CLAIM,
    &l15_rad_flow::CLAIM,
    &l16_scale_change::CLAIM,
    &l17_combined_flow::CLAIM,
    &l18_grad_z::CLAIM,
    &l19_grad_tx_ty::CLAIM,
    &l20_grad_tz::CLAIM,
    &l21_grad_z_claim::CLAIM,
    &l22_cross_influence::CLAIM,
    &l23_ideal_decomposition::CLAIM,
    &l24_residual_rows::CLAIM,
    &l25_residual_remark::CLAIM,
    &l26_axis_plane_equivalence::CLAIM,
    &l27_backprojection::CLAIM,
    &l28_align_printed::CLAIM,
    &l29_align_target_frame::CLAIM,
    &l30_align_source_to_target::CLAIM,
    &l31_align_rotated_target::CLAIM,
    &l32_align_residual::CLAIM,
    &l33_align_kitti::CLAIM,
    &l34_residual_target_frame::CLAIM,
    &l35_align_jacobian::CLAIM,
    &l36_direction_claims::CLAIM,
    &l37_lpla_zero_set::CLAIM,
    &l38_lpla_gradient::CLAIM,
    &l39_lpla_variants::CLAIM,
    &l40_lpla_noise::CLAIM,
    &l41_laxi_sign::CLAIM,
    &l42_laxi_snippet::CLAIM,
    &l43_laxi_repeller::CLAIM,
    &l44_laxi_variants::CLAIM,
    &l45_laxi_noise::CLAIM,
    &l46_independence::CLAIM,
    &l47_sensitivity::CLAIM,
    &l48_axi_confusion::CLAIM,
    &l49_observability::CLAIM,
    &l50_principal_point::CLAIM,
    &l51_rho_xy::CLAIM,
    &l52_rho_z::CLAIM,
    &l53_recovery::CLAIM,
    &l54_cycle::CLAIM,
    &l55_tx_to_zero::CLAIM,
    &l56_scale_invariance::CLAIM,
    &l57_ratio_bias::CLAIM,
    &l58_recovery_bias::CLAIM,
    &l59_pixel_term_gradient::CLAIM,
    &l60_rho_z_noise::CLAIM,
    &l61_rotation_leak::CLAIM,
    &l62_loss_gradients::CLAIM,
    &l63_percentages::CLAIM,
    &l64_counts::CLAIM,
];

/// All claims, by number.
#[must_use]
pub fn all() -> &'static [&'static Claim] {
    ALL
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn claims_are_in_order_and_named_once() {
        for pair in ALL.windows(2) {
            assert!(pair[0].id < pair[1].id, "{} {}", pair[0].id, pair[1].id);
        }
        let slugs: std::collections::BTreeSet<_> = ALL.iter().map(|c| c.slug).collect();
        assert_eq!(slugs.len(), ALL.len());
    }
}

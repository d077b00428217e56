//! One claim, one file.

use super::claim::Claim;

mod flow_gradients;

macro_rules! index {
    ($($file:ident,)*) => {
        $(mod $file;)*
        static ALL: &[&Claim] = &[$(&$file::CLAIM),*];
    };
}

index! {
    l01_intrinsics,
    l02_direction_of_t,
    l03_rigid_flow,
    l04_warp,
    l05_photometric,
    l06_decomposition,
    l07_rot_homography,
    l08_rot_flow,
    l09_rot_flow_inline,
    l10_rot_flow_nonlinear,
    l11_rot_depth_free,
    l12_rot_flow_first_order,
    l13_footnote_order,
    l14_tan_flow,
    l15_rad_flow,
    l16_scale_change,
    l17_combined_flow,
    l18_grad_z,
    l19_grad_tx_ty,
    l20_grad_tz,
    l21_grad_z_claim,
    l22_cross_influence,
    l23_ideal_decomposition,
    l24_residual_rows,
    l25_residual_remark,
    l26_axis_plane_equivalence,
    l27_backprojection,
    l28_align_printed,
    l29_align_target_frame,
    l30_align_source_to_target,
    l31_align_rotated_target,
    l32_align_residual,
    l33_align_kitti,
    l34_residual_target_frame,
    l35_align_jacobian,
    l36_direction_claims,
    l37_lpla_zero_set,
    l38_lpla_gradient,
    l39_lpla_variants,
    l40_lpla_noise,
    l41_laxi_sign,
    l42_laxi_snippet,
    l43_laxi_repeller,
    l44_laxi_variants,
    l45_laxi_noise,
    l46_independence,
    l47_sensitivity,
    l48_axi_confusion,
    l49_observability,
    l50_principal_point,
    l51_rho_xy,
    l52_rho_z,
    l53_recovery,
    l54_cycle,
    l55_tx_to_zero,
    l56_scale_invariance,
    l57_ratio_bias,
    l58_recovery_bias,
    l59_pixel_term_gradient,
    l60_rho_z_noise,
    l61_rotation_leak,
    l62_loss_gradients,
    l63_percentages,
    l64_counts,
}

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

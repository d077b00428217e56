//! One claim, one file.

use super::claim::Claim;

macro_rules! index {
    ($($file:ident,)*) => {
        $(mod $file;)*
        static ALL: &[&Claim] = &[$(&$file::CLAIM),*];
    };
}

index! {
    l01_intrinsics,
    l09_rot_flow_inline,
    l15_rad_flow,
    l20_grad_tz,
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

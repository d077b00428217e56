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
    l20_grad_tz,
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

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

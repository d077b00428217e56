//! Parallelism of planar flows (eq. `lp`).

pub mod gradients;

use nalgebra::Vector2;

use super::mean;

/// Eq. `lp` as printed: population variance of the angle to the horizontal axis, rad^2.
///
/// **Reading**: `arccos(f_x / |f|)` equals `|atan2(f_y, f_x)|`, so flows mirrored about the horizontal
/// axis count as parallel. Evaluated by `atan2`, which stays accurate near 0 and pi.
#[must_use]
pub fn printed(flows: &[Vector2<f64>]) -> f64 {
    let angle = |f: &Vector2<f64>| f.y.abs().atan2(f.x);
    let centre = mean(flows.iter().map(angle));
    mean(flows.iter().map(|f| (angle(f) - centre).powi(2)))
}

/// Population variance of the signed angle `atan2(f_v, f_u)`, rad^2: no folding, but a jump of `2 pi` for leftward flows (L39).
#[must_use]
pub fn unfolded(flows: &[Vector2<f64>]) -> f64 {
    let angle = |f: &Vector2<f64>| f.y.atan2(f.x);
    let centre = mean(flows.iter().map(angle));
    mean(flows.iter().map(|f| (angle(f) - centre).powi(2)))
}

/// Population variance of the angles measured from the mean direction, each in `(-pi, pi]`, rad^2: neither folds nor jumps
/// while the flows stay within half a turn of their mean (L39).
#[must_use]
pub fn wrapped(flows: &[Vector2<f64>]) -> f64 {
    let direction: Vector2<f64> = flows.iter().map(|f| f / f.norm()).sum();
    let angle = |f: &Vector2<f64>| direction.perp(f).atan2(direction.dot(f));
    let centre = mean(flows.iter().map(angle));
    mean(flows.iter().map(|f| (angle(f) - centre).powi(2)))
}

/// Circular variance `2 (1 - |E[f / |f|]|)`: zero exactly when all flows are parallel and alike oriented.
#[must_use]
pub fn circular(flows: &[Vector2<f64>]) -> f64 {
    let sum: Vector2<f64> = flows.iter().map(|f| f / f.norm()).sum();
    2.0 * (1.0 - sum.norm() / flows.len() as f64)
}

/// Magnitude-weighted circular variance `2 (1 - |sum f| / sum |f|)`.
#[must_use]
pub fn weighted(flows: &[Vector2<f64>]) -> f64 {
    let sum: Vector2<f64> = flows.iter().sum();
    let total: f64 = flows.iter().map(|f| f.norm()).sum();
    2.0 * (1.0 - sum.norm() / total)
}

/// Mean distance of the flows from the line along `direction`, pixels: `E[|f x n|]`.
#[must_use]
pub fn perpendicular(flows: &[Vector2<f64>], direction: &Vector2<f64>) -> f64 {
    let n = direction / direction.norm();
    mean(flows.iter().map(|f| f.perp(&n).abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn list(xy: &[[f64; 2]]) -> Vec<Vector2<f64>> {
        xy.iter().map(|&f| Vector2::from(f)).collect()
    }

    #[test]
    fn reference_values() {
        let check = |xy: &[[f64; 2]], p: f64, c: f64, w: f64| {
            let f = list(xy);
            for (value, expected) in [(printed(&f), p), (circular(&f), c), (weighted(&f), w)] {
                assert!((value - expected).abs() < 1e-10, "{value} {expected}");
            }
        };
        check(&[[1.0, 0.5], [1.0, -0.5], [2.0, 1.0], [0.4, -0.2]], 0.0, 0.211145618, 0.181818181818);
        check(&[[0.0, 1.0], [0.0, -2.0], [0.0, 0.5], [0.0, -1.5]], 0.0, 2.0, 1.2);
        check(&[[1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-1.0, 0.0]], 1.85055082520, 1.0, 0.8);
        check(&[[1.0, 0.3], [0.8, -0.2], [1.5, 0.1], [0.9, 0.4]], 0.01589447169, 0.0628604790196, 0.0524351566505);
    }

    #[test]
    fn parallel_flows_across_the_negative_axis_have_no_wrapped_variance() {
        let leftward = list(&[[-1.0, 0.01], [-1.0, -0.01], [-2.0, 0.02], [-2.0, -0.02]]);
        assert!((wrapped(&leftward) - 0.01f64.atan().powi(2)).abs() < 1e-15);
        let mirrored = list(&[[1.0, 0.5], [1.0, -0.5]]);
        assert!((wrapped(&mirrored) - 0.5f64.atan().powi(2)).abs() < 1e-15);
    }

    #[test]
    fn distance_from_a_line() {
        let f = list(&[[3.0, 4.0], [-1.0, 1.0]]);
        assert!((perpendicular(&f, &Vector2::new(2.0, 0.0)) - 2.5).abs() < 1e-15);
        assert!(perpendicular(&list(&[[2.0, 1.0], [-4.0, -2.0]]), &Vector2::new(2.0, 1.0)) < 1e-15);
    }

    proptest! {
        #[test]
        fn only_the_circular_forms_survive_a_rotation(xy in prop::collection::vec(prop::array::uniform2(-1.0f64..1.0), 5), angle in 0.0f64..6.0) {
            let flows = list(&xy);
            prop_assume!(flows.iter().all(|f| f.norm() > 1e-3));
            let turned: Vec<_> = flows.iter().map(|f| nalgebra::Rotation2::new(angle) * f).collect();
            prop_assert!((circular(&flows) - circular(&turned)).abs() < 1e-12);
            prop_assert!((weighted(&flows) - weighted(&turned)).abs() < 1e-12);
            let mut mirrored = flows.clone();
            mirrored[0].y = -mirrored[0].y;
            prop_assert!((printed(&flows) - printed(&mirrored)).abs() < 1e-13);
        }
    }
}

//! Nothing is seen below the ground: what would be is pulled up to it (YihongSun/Dynamo-Depth, `Trainer.py`).
//!
//! **Formula**: `L = mean max(g - d, 0)` over all pixels of the batch, `d` the sigmoid disparity and `g` the one at which the pixel's
//! ray meets the [`GroundPlane`] of its sample, lowered by the tolerance with which that was found; `g = 0` where the ray meets it
//! behind the camera or beyond the largest depth. A distance in disparities, as points far away are uncertain.
//!
//! The public code adds it with weight 0.1, divided by `2^scale` and averaged over scales, in the phase that trains all networks;
//! each scale has a plane of its own, estimated from that scale's disparities. The weight is not ramped.

use dimode_autodiff::{Scalar, Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::back_project;

use super::ground_plane::{GroundPlane, GroundSearch, ground_planes};
use crate::model::DepthRange;

/// Weight of the term in Dynamo-Depth.
pub const WEIGHT: f64 = 0.1;

/// `mean max(g - d, 0)`.
///
/// **Shapes**: `disparity` (sigmoid) and `ground` `[n, 1, h, w]`; `ground` is 0 where none is seen, from [`ground_disparity`].
/// **Gradient**: `-1 / (n h w)` below the ground, exactly 0 elsewhere; where no ground is seen the disparity may hold anything.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn below_ground<'t, T: Scalar>(disparity: Var<'t, T>, ground: &Tensor<T>) -> Var<'t, T> {
    let (s, g, tape) = (disparity.shape(), ground.shape(), disparity.tape());
    assert!(s == g, "below_ground: disparity {s} and ground {g} differ");
    let ground_or_zero = tape.constant(ground.clone());
    ground_or_zero.sub(disparity.select(ground, ground_or_zero)).relu().mean()
}

/// The same with the ground that the disparities themselves show: [`ground_planes`] of their points, without gradient.
///
/// **Shapes**: `disparity` (sigmoid) `[n, 1, h, w]`, one camera a sample. The same `seed` gives the same planes.
///
/// # Panics
/// When a camera is not of the size of the map, or there is not one for each sample.
#[track_caller]
pub fn below_own_ground<'t, T: Scalar>(
    disparity: Var<'t, T>,
    intrinsics: &[Intrinsics],
    range: DepthRange,
    search: GroundSearch,
    seed: u64,
) -> Var<'t, T> {
    let apart = Tape::new();
    let depth = range.depth(apart.constant(disparity.value()));
    let planes = ground_planes(&back_project(depth, intrinsics).value(), search, seed);
    let lowered: Vec<_> = planes.into_iter().map(|plane| plane.map(|plane| plane.lowered(search.tolerance))).collect();
    below_ground(disparity, &ground_disparity(&lowered, intrinsics, range))
}

/// The sigmoid disparity of the ground at every pixel, `[n, 1, h, w]`; 0 where none is seen up to the largest depth, above 1 where
/// it is nearer than the smallest.
///
/// # Panics
/// When there is not one camera for each plane, or the cameras differ in size.
#[must_use]
#[track_caller]
pub fn ground_disparity<T: Scalar>(planes: &[Option<GroundPlane>], intrinsics: &[Intrinsics], range: DepthRange) -> Tensor<T> {
    let size = |camera: &Intrinsics| (camera.height, camera.width);
    let (height, width) = intrinsics.first().map_or((0, 0), size);
    let fits = planes.len() == intrinsics.len() && intrinsics.iter().all(|camera| size(camera) == (height, width));
    assert!(fits, "ground_disparity: {} planes for cameras {intrinsics:?}", planes.len());
    Tensor::from_fn(Shape::new(planes.len(), 1, height, width), |n, _, v, u| {
        let depth = planes[n].and_then(|plane| plane.depth_along(&intrinsics[n].ray(u as f64, v as f64)));
        T::from_f64(depth.filter(|&depth| depth <= range.max).map_or(0.0, |depth| range.disparity(depth)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, gradcheck};

    const RANGE: DepthRange = DepthRange { min: 0.5, max: 10.0 };
    const LEVEL: GroundPlane = GroundPlane { slopes: [0.0, 0.0], below: 1.0 };

    fn camera(height: usize, width: usize) -> Intrinsics {
        Intrinsics::new(2.0, 2.0, 0.0, 1.0, width, height).unwrap()
    }

    #[test]
    fn worked_disparities_of_the_ground() {
        let camera = camera(7, 1);
        // Rays go up, ahead, and down by 1/2 more in every row: depths none, none, 2, 1, 2/3, 1/2, 2/5.
        let found = ground_disparity::<f64>(&[Some(LEVEL)], &[camera], RANGE);
        let expected = [0.0, 0.0, 0.4 / 1.9, 0.9 / 1.9, 1.4 / 1.9, 1.0, 2.4 / 1.9];
        assert!(found.data().iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{found:?}");
        assert_eq!(found.data()[..2], [0.0; 2]);
        // At the largest depth it is still seen, with disparity 0, and not beyond.
        let far = GroundPlane { below: 5.5, ..LEVEL };
        assert_eq!(ground_disparity::<f64>(&[Some(far)], &[camera], RANGE).data()[2], 0.0);
        let above = GroundPlane { below: -1.0, ..LEVEL };
        let none = ground_disparity::<f64>(&[None, Some(above)], &[camera, camera], RANGE);
        // A plane above the camera is met by the ray that goes up.
        assert_eq!(none.data().iter().filter(|&&g| g != 0.0).count(), 1);
        assert!(none.at(1, 0, 0, 0) > 0.0);
    }

    #[test]
    fn only_pixels_below_the_ground_count_and_others_may_hold_anything() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(2, 1, 1, 3);
        let disparity = tape.leaf(Tensor::from_vec(shape, vec![0.25, 0.75, f64::NAN, 0.5, 0.0, f64::INFINITY]));
        let ground = Tensor::from_vec(shape, vec![0.5, 0.5, 0.0, 0.5, 0.75, 0.0]);
        let loss = below_ground(disparity, &ground);
        assert_eq!(loss.value().item(), (0.25 + 0.75) / 6.0);
        let share = -1.0 / 6.0;
        assert_eq!(tape.backward(loss).wrt(disparity).data(), [share, 0.0, 0.0, 0.0, share, 0.0]);
        let none = below_ground(disparity, &Tensor::zeros(shape));
        assert_eq!(none.value().item(), 0.0);
        assert!(tape.backward(none).wrt(disparity).data().iter().all(|&g| g == 0.0));
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(2, 1, 5, 6);
        let ground = random(1, shape, 0.2, 0.8);
        let check = GradCheck { step: 1e-6, rtol: 1e-6, ..GradCheck::default() };
        gradcheck(&[random(2, shape, 0.0, 1.0)], |_, v| below_ground(v[0], &ground), check).assert_ok();
    }

    /// Disparities of level ground one unit below a camera, a wall four units ahead, and a hole in the ground.
    fn street(camera: &Intrinsics, hole: impl Fn(usize, usize) -> bool) -> Tensor<f64> {
        Tensor::from_fn(Shape::new(1, 1, camera.height, camera.width), |_, _, v, u| {
            let ground = LEVEL.depth_along(&camera.ray(u as f64, v as f64)).unwrap_or(f64::INFINITY).min(4.0);
            RANGE.disparity(if hole(v, u) { 2.0 * ground } else { ground })
        })
    }

    #[test]
    fn a_hole_in_the_ground_is_filled_and_nothing_else_changes() {
        let camera = Intrinsics::new(12.0, 12.0, 11.5, 7.5, 24, 20).unwrap();
        let hole = |v: usize, u: usize| v > 16 && (4..9).contains(&u);
        let tape = Tape::new();
        let disparity = tape.leaf(street(&camera, hole));
        let search = GroundSearch::default();
        let loss = below_own_ground(disparity, &[camera], RANGE, search, 1);
        let lowered = ground_disparity::<f64>(&[Some(LEVEL.lowered(search.tolerance))], &[camera], RANGE);
        let missing: f64 = (17..20)
            .flat_map(|v| (4..9).map(move |u| (v, u)))
            .map(|(v, u)| lowered.at(0, 0, v, u) - disparity.value().at(0, 0, v, u))
            .sum();
        assert!((loss.value().item() - missing / 480.0).abs() < 1e-9 && missing > 1.0);
        let grad = tape.backward(loss).wrt(disparity);
        let expected = Tensor::from_fn(grad.shape(), |_, _, v, u| if hole(v, u) { -1.0 / 480.0 } else { 0.0 });
        assert_eq!(grad, expected);
    }

    #[test]
    fn whole_ground_costs_nothing_and_neither_does_a_map_without_plane() {
        let camera = Intrinsics::new(12.0, 12.0, 11.5, 7.5, 24, 20).unwrap();
        let dot = Intrinsics::new(1.0, 1.0, 0.0, 0.0, 1, 1).unwrap();
        for (camera, map) in [(camera, street(&camera, |_, _| false)), (dot, Tensor::full(Shape::new(1, 1, 1, 1), 0.5))] {
            let tape = Tape::new();
            let disparity = tape.leaf(map);
            let loss = below_own_ground(disparity, &[camera], RANGE, GroundSearch::default(), 1);
            assert_eq!(loss.value().item(), 0.0);
            assert!(tape.backward(loss).wrt(disparity).data().iter().all(|&g| g == 0.0));
        }
    }
}

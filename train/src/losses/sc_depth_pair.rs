//! Photometric and geometric consistency of two views as in the Lightning version of SC-Depth (JiawangBian/sc_depth_pl,
//! `losses/loss_functions.py` and `losses/inverse_warp.py`; V1 to V3).
//!
//! **Formula**, for one target and one reference, with `X' = R X + t` the target's points in the reference camera and `pix` their
//! pixels there:
//! 1. `computed = X'_z`, `projected = D_ref(pix)`, `d = |computed - projected| / (computed + projected)`;
//! 2. `colour = mean_c |I - I_ref(pix)|`; a pixel is valid when it is seen (`mean_c |I_ref(pix)| > 1e-3`, likewise the target) and
//!    the warped reference explains it better than the unmoved one (`colour < mean_c |I - I_ref|`);
//! 3. `image = mean_c (0.15 min(|I - I_ref(pix)|, 1) + 0.85 dissimilarity_7x7) (1 - sg(d))`;
//! 4. over all candidates of a pixel (both directions, every reference) the one with the least `colour` is kept, and `photo` and
//!    `geometry` are the means of `image` and `d` over the valid pixels of the batch, or 0 when there are 100 or fewer.
//!
//! **Gradient**: `photo` reaches the target's depth, the motion and the images, not the reference's depth, as the weight is
//! stopped; `geometry` reaches both depths and the motion. Which candidate and which pixels count is decided without gradient.
//!
//! **Reading**: points at or behind the camera are never valid, where the public code divides by what it finds.

use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::taped::{Divisor, MIN_DEPTH, SampleGrid, masks};

use super::masked::batch_mean;
use super::photometric::absolute_difference;
use super::ssim::{Border, dissimilarity};
use super::view_pair::{ViewPair, Warped};

/// Weights of the absolute difference and of the dissimilarity.
const WEIGHTS: [f64; 2] = [0.15, 0.85];
/// Side of the windows of the dissimilarity.
const WINDOW: usize = 7;
/// Mean absolute colour at or below which a pixel counts as not seen.
const BLACK: f64 = 1e-3;

/// Number of valid pixels that the public code demands to be exceeded.
pub const MIN_PIXELS: usize = 100;

/// The maps of one target and one reference, all in the target's frame.
#[derive(Clone, Debug)]
pub struct PairMaps<'t, T: Scalar> {
    /// Where the target's pixels appear in the reference, `[n, 2, h, w]`.
    pub pixels: Var<'t, T>,
    /// Reference read there.
    pub warped: Warped<'t, T>,
    /// Depth of the target's points in the reference camera, `[n, 1, h, w]`.
    pub computed_depth: Var<'t, T>,
    /// Relative difference of computed and read depth, `[n, 1, h, w]`, 1 outside of the reference.
    pub depth_difference: Var<'t, T>,
    /// Mean absolute colour difference, `[n, 1, h, w]`.
    pub colour_difference: Var<'t, T>,
    /// Weighted photometric error, `[n, 1, h, w]`.
    pub image_difference: Var<'t, T>,
    /// 1 where warping explains the pixel better than not moving, `[n, 1, h, w]`.
    pub auto_mask: Tensor<T>,
    /// The auto-mask within what is seen, `[n, 1, h, w]`.
    pub valid: Tensor<T>,
}

/// Photometric and geometric loss.
#[derive(Clone, Debug)]
pub struct PairLoss<'t, T: Scalar> {
    /// Photometric loss, one number.
    pub photo: Var<'t, T>,
    /// Depth consistency, one number.
    pub geometry: Var<'t, T>,
    /// Number of valid pixels.
    pub pixels: usize,
}

/// The maps of one direction of a pair. `grid` is [`SampleGrid::HalfPixelAsCoded`] in the public code.
///
/// # Panics
/// When shapes differ or a side is shorter than four pixels.
#[track_caller]
pub fn pair_maps<'t, T: Scalar>(pair: &ViewPair<'_, 't, T>, grid: SampleGrid) -> PairMaps<'t, T> {
    let seen = pair.projection(Divisor::PlusGuard);
    let warped = pair.read(seen.pixels, grid);
    let ahead = masks::above(&seen.depth.value(), 0, MIN_DEPTH);
    let depth_difference = relative_difference(seen.depth, warped.depth, &ahead);
    let image = pair.target.image;
    let colour_difference = absolute_difference(image, warped.image);
    let still = absolute_difference(image.detach(), pair.reference.image.detach()).value();
    let auto_mask = smaller(&colour_difference.value(), &still);
    let [warped_seen, target_seen] = [warped.image, image].map(seen_pixels);
    let valid = masks::all_of(&[&auto_mask, &ahead, &warped_seen, &target_seen]);
    let clipped = image.sub(warped.image).abs().clamp(0.0, 1.0).scale(WEIGHTS[0]);
    let structure = dissimilarity(image, warped.image, WINDOW, Border::Mirrored).scale(WEIGHTS[1]);
    let weight = depth_difference.detach().scale(-1.0).add_scalar(1.0);
    let image_difference = clipped.add(structure).mean_channels().mul(weight);
    PairMaps {
        pixels: seen.pixels,
        warped,
        computed_depth: seen.depth,
        depth_difference,
        colour_difference,
        image_difference,
        auto_mask,
        valid,
    }
}

/// Loss of the candidates of a batch: per pixel the one with the least colour difference, the first one at a tie.
///
/// The public code stacks the maps of both directions though they live in different frames: the pixel `(u, v)` of the target
/// competes with that of the reference. That is what the numbers of its papers were made with, so it is kept.
///
/// # Panics
/// When there is no candidate or shapes differ.
#[track_caller]
pub fn pair_loss<'t, T: Scalar>(candidates: &[PairMaps<'t, T>], min_pixels: usize) -> PairLoss<'t, T> {
    let tape = candidates.first().expect("pair_loss: at least one candidate").depth_difference.tape();
    let stacked = |map: &dyn Fn(&PairMaps<'t, T>) -> Var<'t, T>| {
        let maps: Vec<_> = candidates.iter().map(map).collect();
        Var::concat(&maps, 1)
    };
    let chosen = stacked(&|c| c.colour_difference.detach()).min_axis(1).index;
    let valid = stacked(&|c| tape.constant(c.valid.clone())).gather(1, &chosen).value();
    let photo = stacked(&|c| c.image_difference).gather(1, &chosen);
    let geometry = stacked(&|c| c.depth_difference).gather(1, &chosen);
    PairLoss {
        photo: batch_mean(photo, &valid, min_pixels),
        geometry: batch_mean(geometry, &valid, min_pixels),
        pixels: valid.data().iter().filter(|&&v| v != T::ZERO).count(),
    }
}

/// How well pixels of the target agree with a static scene, in [0, 1], `[n, 1, h, w]`: `mean (1 - d)` over the references, `d`
/// counted where valid (V3). Confident depth ranking takes the lowest for dynamic.
///
/// # Panics
/// When there is no pair or shapes differ.
#[must_use]
#[track_caller]
pub fn static_weight<T: Scalar>(target_to_references: &[PairMaps<'_, T>]) -> Tensor<T> {
    let count = T::from_usize(target_to_references.len());
    let weights = target_to_references.iter().map(|pair| {
        let difference = pair.depth_difference.value();
        difference.data().iter().zip(pair.valid.data()).map(|(&d, &v)| (T::ONE - d * v) / count).collect::<Vec<_>>()
    });
    let sum = weights.reduce(|a, b| a.into_iter().zip(b).map(|(a, b)| a + b).collect());
    let shape = target_to_references[0].valid.shape();
    Tensor::from_vec(shape, sum.expect("static_weight: at least one pair"))
}

/// `|a - b| / (a + b)` of depths; 1 without gradient where `ahead` is 0.
fn relative_difference<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>, ahead: &Tensor<T>) -> Var<'t, T> {
    let one = a.tape().constant(Tensor::full(ahead.shape(), T::ONE));
    a.sub(b).abs().select(ahead, one).div(a.add(b).select(ahead, one))
}

/// 1 where `a < b`.
fn smaller<T: Scalar>(a: &Tensor<T>, b: &Tensor<T>) -> Tensor<T> {
    let pairs = a.data().iter().zip(b.data());
    Tensor::from_vec(a.shape(), pairs.map(|(a, b)| if a < b { T::ONE } else { T::ZERO }).collect())
}

/// 1 where an image is not black.
fn seen_pixels<T: Scalar>(image: Var<'_, T>) -> Tensor<T> {
    masks::above(&image.detach().abs().mean_channels().value(), 0, BLACK)
}

#[cfg(test)]
mod tests {
    use super::super::view_pair::tests::{cameras, leaves, pair, scene};
    use super::*;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    const CHECK: GradCheck = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };

    fn loss<'t>(v: &[Var<'t, f64>], min_pixels: usize) -> PairLoss<'t, f64> {
        let cameras = cameras(v[0].shape().n());
        let maps = pair_maps(&pair(v, &cameras), SampleGrid::Pixels);
        pair_loss(&[maps], min_pixels)
    }

    #[test]
    fn worked_depth_difference_and_mask() {
        // A still camera, constant depths 3 and 1: d = 2 / 4.
        let tape = Tape::new();
        let mut scene = scene(1);
        let shape = scene[1].shape();
        scene[1] = Tensor::full(shape, 3.0);
        scene[3] = Tensor::full(shape, 1.0);
        scene[4] = Tensor::zeros(Shape::new(1, 3, 1, 1));
        scene[5] = scene[4].clone();
        let v = leaves(&tape, scene);
        let cameras = cameras(1);
        let maps = pair_maps(&pair(&v, &cameras), SampleGrid::Pixels);
        // Interior pixels: the guard of the division draws border pixels in or out by 1e-7.
        assert!((maps.depth_difference.value().at(0, 0, 3, 4) - 0.5).abs() < 1e-6);
        let weights = static_weight(&[maps.clone(), maps.clone()]);
        let valid = maps.valid.at(0, 0, 3, 4);
        assert!((weights.at(0, 0, 3, 4) - (1.0 - 0.5 * valid)).abs() < 1e-6);
    }

    #[test]
    fn gradient_of_geometry_matches_finite_differences() {
        gradcheck(&scene(2), |_, v| loss(v, 0).geometry, CHECK).assert_ok();
    }

    /// Differences do not see that the weight is stopped, so it is exchanged for the one of the unmoved scene.
    #[test]
    fn gradient_of_the_photometric_map_matches_finite_differences_at_equal_weight() {
        let cameras = cameras(1);
        let fixed = scene(1);
        let tape = Tape::new();
        let at = pair_maps(&pair(&leaves(&tape, fixed.clone()), &cameras), SampleGrid::Pixels);
        let (weight, valid) = (at.depth_difference.value(), at.valid.clone());
        let report = gradcheck(
            &fixed,
            |tape, v| {
                let maps = pair_maps(&pair(v, &cameras), SampleGrid::Pixels);
                let left = |d: &Tensor<f64>| Tensor::from_vec(d.shape(), d.data().iter().map(|d| 1.0 - d).collect());
                let (now, then) = (left(&maps.depth_difference.value()), tape.constant(left(&weight)));
                let one = tape.constant(Tensor::full(weight.shape(), 1.0));
                let image = maps.image_difference.select(&valid, one);
                batch_mean(image.div(tape.constant(now).select(&valid, one)).mul(then), &valid, 0)
            },
            CHECK,
        );
        report.assert_ok();
    }

    #[test]
    fn the_weight_stops_the_gradient_to_the_reference_depth_and_colours_that_to_geometry() {
        let tape = Tape::new();
        let v = leaves(&tape, scene(1));
        let loss = loss(&v, 0);
        assert!(loss.pixels > 5, "{}", loss.pixels);
        let zero = |var: Var<'_, f64>, of| tape.backward(of).wrt(var).data().iter().all(|&g| g == 0.0);
        assert!(zero(v[3], loss.photo) && zero(v[0], loss.geometry) && zero(v[2], loss.geometry));
        assert!(!zero(v[1], loss.photo) && !zero(v[3], loss.geometry));
    }

    #[test]
    fn masked_pixels_pull_on_no_depth() {
        let tape = Tape::new();
        let v = leaves(&tape, scene(1));
        let cameras = cameras(1);
        let maps = pair_maps(&pair(&v, &cameras), SampleGrid::Pixels);
        let valid = maps.valid.clone();
        let grads = tape.backward(pair_loss(&[maps], 0).geometry).wrt(v[1]);
        for (g, m) in grads.data().iter().zip(valid.data()) {
            assert!(*m != 0.0 || *g == 0.0);
        }
    }

    #[test]
    fn a_scene_behind_the_camera_and_too_few_pixels_give_zero_without_gradient() {
        let mut behind = scene(1);
        behind[5] = Tensor::from_vec(Shape::new(1, 3, 1, 1), vec![0.0, 0.0, -9.0]);
        for (scene, min_pixels) in [(behind, 0), (scene(1), 10_000)] {
            let tape = Tape::new();
            let v = leaves(&tape, scene);
            let loss = loss(&v, min_pixels);
            for of in [loss.photo, loss.geometry] {
                assert_eq!(of.value().item(), 0.0);
                assert!(v.iter().all(|&x| tape.backward(of).wrt(x).data().iter().all(|&g| g == 0.0)));
            }
        }
    }

    #[test]
    fn a_common_scale_changes_nothing() {
        let value = |k: f64| {
            let mut scene = scene(1);
            for i in [1, 3, 5] {
                scene[i] = Tensor::from_vec(scene[i].shape(), scene[i].data().iter().map(|x| k * x).collect());
            }
            let tape = Tape::new();
            let loss = loss(&leaves(&tape, scene), 0);
            (loss.photo.value().item(), loss.geometry.value().item())
        };
        let (a, b) = (value(1.0), value(10.0));
        assert!((a.0 - b.0).abs() < 1e-6 && (a.1 - b.1).abs() < 1e-6, "{a:?} {b:?}");
    }

    #[test]
    fn the_better_candidate_is_kept() {
        let tape = Tape::new();
        let v = leaves(&tape, scene(1));
        let cameras = cameras(1);
        let maps = pair_maps(&pair(&v, &cameras), SampleGrid::Pixels);
        let mut perfect = maps.clone();
        perfect.colour_difference = tape.constant(Tensor::zeros(maps.valid.shape()));
        perfect.image_difference = tape.constant(Tensor::full(maps.valid.shape(), 0.25));
        perfect.valid = Tensor::full(maps.valid.shape(), 1.0);
        let loss = pair_loss(&[maps, perfect], 0);
        assert_eq!(loss.photo.value().item(), 0.25);
        assert_eq!(loss.pixels, 72);
    }
}

//! Photometric and geometric consistency of two views as in the first SC-Depth program (JiawangBian/SC-SfMLearner-Release,
//! `loss_functions.py` and `inverse_warp.py`).
//!
//! **Formula**, for one target and one reference: depths in the reference camera are held at 1e-3; a pixel is in view when it
//! falls within the reference; `d = min(|computed - projected| / (computed + projected), 1)`; with `a_c = min(|I - I_ref(pix)|, 1)`
//! a pixel counts when it is in view and `mean_c a < mean_c |I - I_ref|`;
//! `image_c = (0.15 a_c + 0.85 dissimilarity_3x3,c)(1 - d)`; `photo` is the mean over the channels and the counting pixels of the
//! batch, `geometry` that of `d`. A mean of 10,000 entries or fewer is replaced by 0. The losses of all pairs and both directions
//! are added up, without a minimum over views.
//!
//! **Gradient**: both losses reach both depths and the motion: unlike in the later program ([`super::sc_depth_pair`]) the weight
//! `1 - d` is not stopped, so the photometric loss asks for more disagreement of the depths where colours differ. Coordinates out
//! of view are replaced by a constant before the image is read.
//!
//! Depths of coarser scales are brought to full size by [`resize_nearest`](Var::resize_nearest) first, as the public code does.

use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::taped::{Divisor, SampleGrid};

use super::masked::batch_mean;
use super::sc_depth_pair::PairLoss;
use super::ssim::{Border, dissimilarity};
use super::view_pair::{ViewPair, Warped};

/// Weights of the absolute difference and of the dissimilarity.
const WEIGHTS: [f64; 2] = [0.15, 0.85];
/// Number of entries that the public code demands to be exceeded in a mean; of colours all three count.
pub const MIN_ENTRIES: usize = 10_000;

/// The maps of one direction of a pair, in the target's frame.
#[derive(Clone, Debug)]
pub struct PairMaps<'t, T: Scalar> {
    /// Where the target's pixels appear in the reference, `[n, 2, h, w]`; components out of view lie outside by half a size.
    pub pixels: Var<'t, T>,
    /// Reference read there.
    pub warped: Warped<'t, T>,
    /// Depth of the target's points in the reference camera, at least 1e-3, `[n, 1, h, w]`.
    pub computed_depth: Var<'t, T>,
    /// Relative difference of computed and read depth, `[n, 1, h, w]`.
    pub depth_difference: Var<'t, T>,
    /// Weighted photometric error, `[n, c, h, w]`.
    pub image_difference: Var<'t, T>,
    /// 1 where the pixel is in view, `[n, 1, h, w]`.
    pub in_view: Tensor<T>,
    /// 1 where the pixel counts, `[n, 1, h, w]`.
    pub valid: Tensor<T>,
}

/// The maps of one direction of a pair. `grid` is [`SampleGrid::HalfPixelAsCoded`] in the public code.
///
/// # Panics
/// When shapes differ or a side is shorter than three pixels.
#[track_caller]
pub fn pair_maps<'t, T: Scalar>(pair: &ViewPair<'_, 't, T>, grid: SampleGrid) -> PairMaps<'t, T> {
    let seen = pair.projection(Divisor::AtLeast);
    let (pixels, in_view) = out_of_view_replaced(seen.pixels);
    let warped = pair.read(pixels, grid);
    let sum = seen.depth.add(warped.depth);
    let depth_difference = seen.depth.sub(warped.depth).abs().div(sum).clamp(0.0, 1.0);
    let image = pair.target.image;
    let colour = image.sub(warped.image).abs().clamp(0.0, 1.0);
    let valid = explained(&colour.detach().mean_channels().value(), &still(pair), &in_view);
    let structure = dissimilarity(image, warped.image, 3, Border::Mirrored);
    let weight = depth_difference.scale(-1.0).add_scalar(1.0).broadcast_to(image.shape());
    let image_difference = colour.scale(WEIGHTS[0]).add(structure.scale(WEIGHTS[1])).mul(weight);
    PairMaps { pixels, warped, computed_depth: seen.depth, depth_difference, image_difference, in_view, valid }
}

/// Sum of the losses of all pairs and directions; `min_entries` is [`MIN_ENTRIES`] in the public code.
///
/// # Panics
/// When there is no pair.
#[track_caller]
pub fn pair_loss<'t, T: Scalar>(pairs: &[PairMaps<'t, T>], min_entries: usize) -> PairLoss<'t, T> {
    let losses = pairs.iter().map(|pair| {
        let colours = pair.image_difference.shape();
        let every_channel = Tensor::from_fn(colours, |n, _, h, w| pair.valid.at(n, 0, h, w));
        PairLoss {
            photo: batch_mean(pair.image_difference, &every_channel, min_entries),
            geometry: batch_mean(pair.depth_difference, &pair.valid, min_entries),
            pixels: pair.valid.data().iter().filter(|&&v| v != T::ZERO).count(),
        }
    });
    let sum = losses.reduce(|a, b| PairLoss {
        photo: a.photo.add(b.photo),
        geometry: a.geometry.add(b.geometry),
        pixels: a.pixels + b.pixels,
    });
    sum.expect("pair_loss: at least one pair")
}

/// Replaces each coordinate that lies outside of the image by one and a half times the largest, and masks such pixels.
fn out_of_view_replaced<T: Scalar>(pixels: Var<'_, T>) -> (Var<'_, T>, Tensor<T>) {
    let (shape, value) = (pixels.shape(), pixels.value());
    let largest = [shape.w() - 1, shape.h() - 1].map(T::from_usize);
    let within = |n, c: usize, h, w| value.at(n, c, h, w) >= T::ZERO && value.at(n, c, h, w) <= largest[c];
    let one = |yes| if yes { T::ONE } else { T::ZERO };
    let components = Tensor::from_fn(shape, |n, c, h, w| one(within(n, c, h, w)));
    let in_view = Tensor::from_fn(shape.with_c(1), |n, _, h, w| one(within(n, 0, h, w) && within(n, 1, h, w)));
    let outside = Tensor::from_fn(shape, |_, c, _, _| T::from_f64(1.5) * largest[c]);
    (pixels.select(&components, pixels.tape().constant(outside)), in_view)
}

/// Colour difference of the unmoved reference.
fn still<T: Scalar>(pair: &ViewPair<'_, '_, T>) -> Tensor<T> {
    pair.target.image.detach().sub(pair.reference.image.detach()).abs().mean_channels().value()
}

/// 1 where the warped reference differs less than the unmoved one, in view.
fn explained<T: Scalar>(warped: &Tensor<T>, still: &Tensor<T>, in_view: &Tensor<T>) -> Tensor<T> {
    let triples = warped.data().iter().zip(still.data()).zip(in_view.data());
    Tensor::from_vec(in_view.shape(), triples.map(|((a, b), &seen)| if a < b { seen } else { T::ZERO }).collect())
}

#[cfg(test)]
mod tests {
    use super::super::view_pair::tests::{cameras, leaves, pair, scene};
    use super::*;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    fn loss<'t>(v: &[Var<'t, f64>], min_entries: usize) -> PairLoss<'t, f64> {
        let cameras = cameras(v[0].shape().n());
        pair_loss(&[pair_maps(&pair(v, &cameras), SampleGrid::Pixels)], min_entries)
    }

    #[test]
    fn gradients_match_finite_differences() {
        let check = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, ..GradCheck::default() };
        gradcheck(&scene(2), |_, v| loss(v, 0).geometry, check).assert_ok();
        gradcheck(&scene(2), |_, v| loss(v, 0).photo, check).assert_ok();
    }

    #[test]
    fn a_pixel_out_of_view_is_black_and_does_not_count() {
        let tape = Tape::new();
        let mut far = scene(1);
        far[5] = Tensor::from_vec(Shape::new(1, 3, 1, 1), vec![100.0, 0.0, 0.0]);
        let v = leaves(&tape, far);
        let cameras = cameras(1);
        let maps = pair_maps(&pair(&v, &cameras), SampleGrid::HalfPixelAsCoded);
        assert!(maps.in_view.data().iter().chain(maps.warped.image.value().data()).all(|&x| x == 0.0));
        assert!(maps.depth_difference.value().data().iter().all(|&d| d == 1.0));
        let loss = pair_loss(&[maps], 0);
        assert_eq!((loss.pixels, loss.photo.value().item(), loss.geometry.value().item()), (0, 0.0, 0.0));
        for of in [loss.photo, loss.geometry] {
            assert!(v.iter().all(|&x| tape.backward(of).wrt(x).data().iter().all(|&g| g == 0.0)));
        }
    }

    #[test]
    fn pairs_add_up_and_the_number_of_entries_decides() {
        let tape = Tape::new();
        let v = leaves(&tape, scene(1));
        let cameras = cameras(1);
        let maps = pair_maps(&pair(&v, &cameras), SampleGrid::Pixels);
        let one = pair_loss(std::slice::from_ref(&maps), 0);
        let two = pair_loss(&[maps.clone(), maps.clone()], 0);
        assert_eq!(two.photo.value().item(), 2.0 * one.photo.value().item());
        assert_eq!(two.geometry.value().item(), 2.0 * one.geometry.value().item());
        // Colours have three entries a pixel, depths one.
        let guarded = pair_loss(&[maps], one.pixels);
        assert_eq!((guarded.photo.value(), guarded.geometry.value().item()), (one.photo.value(), 0.0));
    }

    #[test]
    fn masked_pixels_pull_on_no_depth() {
        let tape = Tape::new();
        let v = leaves(&tape, scene(1));
        let cameras = cameras(1);
        let maps = pair_maps(&pair(&v, &cameras), SampleGrid::Pixels);
        let valid = maps.valid.clone();
        let grads = tape.backward(pair_loss(&[maps], 0).geometry).wrt(v[1]);
        assert!(grads.data().iter().zip(valid.data()).all(|(g, m)| *m != 0.0 || *g == 0.0));
        assert!(grads.data().iter().any(|&g| g != 0.0));
    }
}

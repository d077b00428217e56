//! Mean photometric error of the best source along the rigid flow, as one operation.
//!
//! **Formula**: `mean_p min(still(p), e_1(p), .., e_k(p))`, where `e_i` is the [photometric](super::photometric) error of source
//! `i`, read bilinearly (border: nearest pixel) at `p +` [`rigid_flow`](crate::taped::rigid_flow()), and `still` is the least
//! error of the sources that did not move, or with [`Combine::Average`] of the mean errors. What it is, composed of operations:
//!
//! ```text
//! errors = photometric(warp(source, rigid_flow(depth, rotation, translation), Border), target)     for each source
//! mean   = min_reprojection(errors, identities).error.mean()             (or average_reprojection)
//! ```
//!
//! The gradient of a mean is known up to a factor before the mean is: value and gradient are computed together, band by band of
//! rows, and nothing of image size is stored but the gradient of the depth. The backward pass multiplies.
//!
//! vjp: from the errors of the winner through the transposed windows to the colours (see `similarity.rs`), `g`; with the slopes
//! of the image, `g_u = sum_c g dI/du` and `g_v`, 0 where the border holds a coordinate; from there to depth and motion as of
//! [`rigid_flow`](crate::taped::rigid_flow()).

mod band;
mod warp_rows;

#[cfg(test)]
mod tests;

use dimode_autodiff::{GradSink, Scalar, Shape, Tape, Tensor, Var, par};
use pulp::Arch;

use super::rows::band_rows;
use crate::camera::Intrinsics;
use crate::taped::Pose;
use crate::taped::bands::Motion;
use crate::taped::rigid_flow::check_motion;
use band::{Band, BandSums, Sizes};

/// Rows that are packed together.
const PACKED_ROWS: usize = 16;
/// Colours of an image.
const CHANNELS: usize = 3;
/// Colours of a pixel and the first one of the next, so that a pixel is one small register.
const PIXEL: usize = CHANNELS + 1;

/// What counts at a pixel that several sources show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Combine {
    /// The source that explains it best, [`min_reprojection`](super::min_reprojection::min_reprojection()).
    #[default]
    Minimum,
    /// The mean over the sources, [`average_reprojection`](super::min_reprojection::average_reprojection()).
    Average,
}

/// The images of a batch, prepared once for any number of depths.
#[derive(Clone, Debug)]
pub struct Frames<T: Scalar> {
    target: Tensor<T>,
    /// Pixel by pixel, `[k n, h, w, 3]` in a row, and one number that the last pixel reads beyond its own.
    sources: Tensor<T>,
    /// Errors of sources that did not move, `[n, 1, h, w]`.
    identities: Vec<Tensor<T>>,
    combine: Combine,
}

impl<T: Scalar> Frames<T> {
    /// Prepares images; the buffers come from the pool of `tape`.
    ///
    /// **Shapes**: `target` and each of the k `sources` (N,3,H,W), colours in [0, 1]; `identities`, errors of sources that did not
    /// move, (N,1,H,W), empty: no auto-mask. Images are data and get no gradient.
    /// **Panics** when there is no source, shapes do not fit or a side is shorter than 2 pixels.
    #[track_caller]
    pub fn new(tape: &Tape<T>, target: &Tensor<T>, sources: &[Tensor<T>], identities: &[Tensor<T>], combine: Combine) -> Self {
        let s = target.shape();
        assert!(s.c() == CHANNELS && !sources.is_empty(), "Frames: a target (N, 3, H, W) and sources are needed, got {s}");
        for source in sources {
            assert!(source.shape() == s, "Frames: target {s} and source {} must have equal shapes", source.shape());
        }
        assert!(s.h() >= 2 && s.w() >= 2, "Frames: mirrored borders need at least 2 x 2 pixels, got {s}");
        for map in identities {
            assert!(map.shape() == s.with_c(1), "Frames: errors have shape {}, got {}", s.with_c(1), map.shape());
        }
        let (h, w) = (s.h(), s.w());
        let len = sources.len() * s.n() * s.plane() * CHANNELS;
        let mut packed = tape.scratch(len + 1);
        packed[len] = T::ZERO;
        par::for_each_chunk(&mut packed[..len], PACKED_ROWS * w * CHANNELS, |i, out| {
            for (row, out) in (i * PACKED_ROWS..).zip(out.chunks_exact_mut(w * CHANNELS)) {
                let (image, v) = (row / h, row % h);
                let (k, n) = (image / s.n(), image % s.n());
                pack(std::array::from_fn(|c| &sources[k].plane(n, c)[v * w..][..w]), out);
            }
        });
        let sources = tape.tensor(Shape::new(1, 1, 1, len + 1), packed);
        Frames { target: target.clone(), sources, identities: identities.to_vec(), combine }
    }

    /// Number of sources of a sample.
    pub fn sources(&self) -> usize {
        self.sources.shape().len() / self.target.shape().len()
    }
}

/// Puts the colours of a row side by side.
fn pack<T: Scalar>([r, g, b]: [&[T]; CHANNELS], out: &mut [T]) {
    for (pixel, ((&r, &g), &b)) in out.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(r.iter().zip(g).zip(b)) {
        *pixel = [r, g, b];
    }
}

/// The mean error and who won.
#[derive(Clone, Copy, Debug)]
pub struct FusedReprojection<'t, T: Scalar> {
    /// Mean over all pixels and samples, one number.
    pub mean: Var<'t, T>,
    /// Share of the pixels won by a warped source.
    pub share: f64,
}

/// Mean photometric error of the best source along the rigid flow.
///
/// **Shapes**: `depth` (N,1,H,W), along the optical axis of the target; `motion` and `cameras`: kN motions `source_from_target` and
/// cameras in the order of the sources of `frames`, rotations (kN,1,3,3), translations (kN,3,1,1) in the unit of depth; a camera
/// serves both of its views.
/// **Gradient**: to depth, rotation and translation; 0 where an identity wins, where the point lies behind the source
/// ([`MIN_DEPTH`](crate::taped::MIN_DEPTH)) and, by one coordinate, where it lies beyond the border.
/// **Domain**: where depth or flow is not finite the error is NaN and wins, so that it is seen; no gradient passes there, and the
/// gradients of other pixels are what they would be.
/// **Panics** when a shape does not fit.
#[track_caller]
pub fn fused_reprojection<'t, T: Scalar>(
    depth: Var<'t, T>,
    motion: Pose<'t, T>,
    cameras: &[Intrinsics],
    frames: &Frames<T>,
) -> FusedReprojection<'t, T> {
    let (shape, k) = (depth.shape(), frames.sources());
    let target = frames.target.shape();
    assert!(shape == target.with_c(1), "fused_reprojection: depth has shape {}, got {shape}", target.with_c(1));
    let Pose { rotation, translation } = motion;
    let pairs = Shape::new(k * shape.n(), 1, shape.h(), shape.w());
    check_motion("fused_reprojection", pairs, rotation.shape(), translation.shape(), cameras);
    let (r, t) = (rotation.value(), translation.value());
    let motions: Vec<Motion<T>> =
        cameras.iter().enumerate().map(|(n, camera)| Motion::new(camera, r.data(), t.data(), n, false)).collect();
    let tape = depth.tape();
    let wanted = [depth, rotation, translation].iter().any(|v| v.requires_grad());
    let mut slope = tape.scratch(if wanted { shape.len() } else { 0 });
    let sums = run(frames, &depth.value(), &motions, tape, wanted, &mut slope);
    let pixels = shape.len() as f64;
    let total = |of: fn(&BandSums) -> f64| sums.iter().map(of).sum::<f64>() / pixels;
    let (mean, share) = (T::from_f64(total(|s| s.error)), total(|s| s.won));
    let of_motions = motion_sums(&sums, shape, k);
    let slope = wanted.then(|| tape.tensor(shape, slope));
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let factor = g.item().to_f64() / pixels;
        if let (Some(mut slot), Some(slope)) = (grads.slot(0), &slope) {
            let factor = T::from_f64(factor);
            slot.write(|out| {
                par::for_each_chunk(out, par::CHUNK, |i, out| {
                    let slope = &slope.data()[i * par::CHUNK..][..out.len()];
                    out.iter_mut().zip(slope).for_each(|(o, &s)| *o = factor * s);
                });
            });
        }
        for (parent, range) in [(1, 0..9), (2, 9..12)] {
            if let Some(mut slot) = grads.slot(parent) {
                let values = of_motions.iter().flat_map(|s| &s[range.clone()]);
                slot.as_mut_slice().iter_mut().zip(values).for_each(|(o, &s)| *o += T::from_f64(factor * s));
            }
        }
    };
    let mean = tape.push("fused_reprojection", Tensor::scalar(mean), &[depth, rotation, translation], record);
    FusedReprojection { mean, share }
}

/// Runs all bands; `slope` receives the gradient of the depth of the sum of errors, if it is wanted.
fn run<T: Scalar>(
    frames: &Frames<T>,
    depth: &Tensor<T>,
    motions: &[Motion<T>],
    tape: &Tape<T>,
    wanted: bool,
    slope: &mut [T],
) -> Vec<BandSums> {
    let shape = depth.shape();
    let (n, h, w, k) = (shape.n(), shape.h(), shape.w(), frames.sources());
    let sizes = Sizes { h, w, k };
    let columns: Vec<T> = (0..sizes.columns()).map(T::from_usize).collect();
    let rays: Vec<Vec<T>> = motions.iter().map(|m| m.ray_columns(sizes.columns())).collect();
    let band = band_rows(h);
    let per_sample = h.div_ceil(band);
    let mut sums = vec![BandSums::new(k); n * per_sample];
    // Without gradient every band gets an empty piece.
    let mut pieces = slope.chunks_mut(h * w).flat_map(|sample| sample.chunks_mut(band * w));
    let items: Vec<_> = sums.iter_mut().map(|sums| (sums, pieces.next().unwrap_or_default())).collect();
    let pool = tape.pool();
    par::for_each_item(items, |i, (sums, slope)| {
        let (sample, first) = (i / per_sample, i % per_sample * band);
        let mut work = pool.take(sizes.work());
        let of_sources = |j: usize| j * n + sample;
        Arch::new().dispatch(Band {
            sizes,
            rows: first..(first + band).min(h),
            wanted,
            combine: frames.combine,
            motions: &(0..k).map(|j| motions[of_sources(j)]).collect::<Vec<_>>(),
            columns: &columns,
            rays: &(0..k).map(|j| &rays[of_sources(j)][..]).collect::<Vec<_>>(),
            depth: depth.plane(sample, 0),
            target: std::array::from_fn(|c| frames.target.plane(sample, c)),
            sources: &(0..k).map(|j| packed(&frames.sources, h * w, of_sources(j))).collect::<Vec<_>>(),
            identities: &frames.identities.iter().map(|map| map.plane(sample, 0)).collect::<Vec<_>>(),
            work: &mut work,
            slope,
            sums,
        });
        pool.give(work);
    });
    sums
}

/// Packed image `n` of `plane` pixels, and one number beyond.
fn packed<T: Scalar>(sources: &Tensor<T>, plane: usize, n: usize) -> &[T] {
    &sources.data()[n * plane * CHANNELS..][..plane * CHANNELS + 1]
}

/// Sums over the bands of each motion, in order; for rotation (9) and translation (3).
fn motion_sums(sums: &[BandSums], shape: Shape, k: usize) -> Vec<[f64; 12]> {
    let bands: Vec<_> = sums.chunks(shape.h().div_ceil(band_rows(shape.h()))).collect();
    (0..k * shape.n())
        .map(|i| {
            let (source, sample) = (i / shape.n(), i % shape.n());
            std::array::from_fn(|j| bands[sample].iter().map(|band| band.motions[source][j]).sum())
        })
        .collect()
}

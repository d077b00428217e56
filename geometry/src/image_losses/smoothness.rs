//! Edge-aware smoothness of the mean-normalised disparity.
//!
//! `d* = d / (mean_hw d + 1e-7)`, `L = mean(|d*_x| exp(-mean_c |I_x|)) + mean(|d*_y| exp(-mean_c |I_y|))`, forward differences.
//! The mean is not detached. Subgradient of the absolute value at 0 is 0.
//!
//! The SC-Depth programs apply the same to depth instead of disparity: [`smoothness`] of a depth map.
//!
//! One fused operation where the images are data: value and gradient are computed together in one pass, since the gradient of a
//! mean is known up to a factor beforehand. With `E` the sum of the weighted differences of a sample and `M` its mean, the
//! normalised form is `E / |M|` and its gradient `dE / |M| - E sign(M) / (M^2 h w)`.

mod band;

use dimode_autodiff::{GradSink, Pool, Scalar, Tensor, Var, par};
use pulp::Arch;

use super::rows::band_rows;
use band::{Band, BandSums};

/// Smoothness of disparities `[n, 1, h, w]` under images `[n, c, h, w]`; one number.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn smoothness<'t, T: Scalar>(disparity: Var<'t, T>, images: &Tensor<T>) -> Var<'t, T> {
    normalised_edge_aware(disparity, images, 1.0)
}

/// First-order smoothness of a map `[n, k, h, w]`, each difference weighted by `exp(-edge mean_c |image difference|)`.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn edge_aware<'t, T: Scalar>(map: Var<'t, T>, images: &Tensor<T>, edge: f64) -> Var<'t, T> {
    fused(map, images, edge, false)
}

/// [`edge_aware`] of a map `[n, 1, h, w]` divided by its mean plus 1e-7, sample by sample; the mean is not detached.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn normalised_edge_aware<'t, T: Scalar>(map: Var<'t, T>, images: &Tensor<T>, edge: f64) -> Var<'t, T> {
    assert!(map.shape().c() == 1, "smoothness: a map of one channel is normalised, got {}", map.shape());
    fused(map, images, edge, true)
}

#[track_caller]
fn fused<'t, T: Scalar>(map: Var<'t, T>, images: &Tensor<T>, edge: f64, normalise: bool) -> Var<'t, T> {
    let (s, i) = (map.shape(), images.shape());
    assert!(
        s.n() == i.n() && s.h() == i.h() && s.w() == i.w() && s.h() > 1 && s.w() > 1,
        "smoothness: map {s} and images {i} must have equal sizes of at least 2 x 2"
    );
    let tape = map.tape();
    let plane = s.plane();
    let mut slope = tape.scratch(s.len());
    let sums = run(&map.value(), images, edge, tape.pool(), &mut slope);
    let slope = tape.tensor(s, slope);
    let per_plane = s.h().div_ceil(band_rows(s.h()));
    // Of every plane: the factor of the slope, and what is taken off.
    let mut factors = vec![[1.0, 0.0]; s.n() * s.c()];
    let mut value = 0.0;
    for (bands, factor) in sums.chunks(per_plane).zip(&mut factors) {
        let edges: f64 = bands.iter().map(|band| band.edges).sum();
        if normalise {
            let mean = bands.iter().map(|band| band.total).sum::<f64>() / plane as f64 + GUARD;
            *factor = [1.0 / mean.abs(), edges * mean.signum() / (mean * mean * plane as f64)];
        }
        value += edges * factor[0];
    }
    tape.push("smoothness", Tensor::scalar(T::from_f64(value)), &[map], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let g = g.item().to_f64();
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| {
                par::for_each_chunk(out, par::CHUNK, |i, mut out| {
                    let mut at = i * par::CHUNK;
                    while !out.is_empty() {
                        let [factor, off] = factors[at / plane].map(|x| T::from_f64(g * x));
                        let len = (plane - at % plane).min(out.len());
                        let part = out.split_off_mut(..len).expect("no more than there is");
                        part.iter_mut().zip(&slope.data()[at..]).for_each(|(o, &s)| *o = factor * s - off);
                        at += len;
                    }
                });
            });
        }
    })
}

/// Added to the mean of a map.
const GUARD: f64 = 1e-7;

/// Runs all bands; `slope` receives the gradient of the weighted mean of differences.
fn run<T: Scalar>(map: &Tensor<T>, images: &Tensor<T>, edge: f64, pool: &Pool<T>, slope: &mut [T]) -> Vec<BandSums> {
    let (s, colours) = (map.shape(), images.shape().c());
    let (h, w) = (s.h(), s.w());
    let planes = (s.n() * s.c()) as f64;
    let band = band_rows(h);
    let per_plane = h.div_ceil(band);
    let mut sums = vec![BandSums::default(); s.n() * s.c() * per_plane];
    let pieces = slope.chunks_mut(h * w).enumerate().flat_map(|(i, plane)| plane.chunks_mut(band * w).map(move |band| (i, band)));
    let items: Vec<_> = pieces.zip(&mut sums).collect();
    par::for_each_item(items, |i, ((plane, slope), sums)| {
        let first = i % per_plane * band;
        let mut work = pool.take(Band::<T>::work(w));
        Arch::new().dispatch(Band {
            h,
            w,
            rows: first..(first + band).min(h),
            map: map.plane(plane / s.c(), plane % s.c()),
            image: &images.data()[plane / s.c() * colours * h * w..][..colours * h * w],
            edge: -edge / colours as f64,
            // One over the number of differences along rows and columns.
            shares: [1.0 / (planes * ((h - 1) * w) as f64), 1.0 / (planes * (h * (w - 1)) as f64)],
            work: &mut work,
            slope,
            sums,
        });
        pool.give(work);
    });
    sums
}

/// As [`edge_aware`] with gradients to the images too, for images that are themselves computed, as rectified ones are.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn edge_aware_of_both<'t, T: Scalar>(map: Var<'t, T>, images: Var<'t, T>, edge: f64) -> Var<'t, T> {
    let terms = [2, 3].map(|axis| {
        let weight = steps(images, axis).abs().mean_channels().scale(-edge).exp();
        weighted(steps(map, axis).abs(), weight)
    });
    terms[0].add(terms[1])
}

/// `d / (mean_hw d + 1e-7)` of maps `[n, 1, h, w]`; the mean is not detached.
pub fn mean_normalised<'t, T: Scalar>(map: Var<'t, T>) -> Var<'t, T> {
    let mean = map.mean_hw().add_scalar(GUARD);
    map.div(mean.broadcast_to(map.shape()))
}

/// `x(i + 1) - x(i)` along rows (2) or columns (3).
pub fn steps<T: Scalar>(x: Var<'_, T>, axis: usize) -> Var<'_, T> {
    let len = x.shape().0[axis] - 1;
    x.slice(axis, 1, len).sub(x.slice(axis, 0, len))
}

/// Mean of penalties times one weight for all channels.
pub fn weighted<'t, T: Scalar>(penalty: Var<'t, T>, weight: Var<'t, T>) -> Var<'t, T> {
    penalty.mul(weight.broadcast_to(penalty.shape())).mean()
}

/// `exp(-edge mean_c |I(i + to) - I(i + from)|)` along rows (2) or columns (3), one channel, `to` entries fewer.
pub fn edge_weights<T: Scalar>(images: &Tensor<T>, axis: usize, [from, to]: [usize; 2], edge: f64) -> Tensor<T> {
    let mut shape = images.shape().with_c(1);
    shape.0[axis] -= to;
    let channels = images.shape().c();
    let scale = T::from_f64(-edge / channels as f64);
    Tensor::from_fn(shape, |n, _, h, w| {
        let at = |c: usize, by: usize| if axis == 2 { images.at(n, c, h + by, w) } else { images.at(n, c, h, w + by) };
        let sum = (0..channels).map(|c| (at(c, to) - at(c, from)).abs()).fold(T::ZERO, |a, b| a + b);
        (scale * sum).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    #[test]
    fn a_ramp_on_a_flat_image_has_its_slope() {
        let tape = Tape::<f64>::new();
        let d = tape.constant(Tensor::from_fn(Shape::new(1, 1, 3, 4), |_, _, _, w| 1.0 + w as f64));
        let l = smoothness(d, &Tensor::full(Shape::new(1, 3, 3, 4), 0.3)).value().item();
        assert!((l - 1.0 / 2.5).abs() < 1e-7, "{l}");
    }

    #[test]
    fn an_edge_of_the_image_excuses_a_step() {
        let tape = Tape::<f64>::new();
        let step = Tensor::from_fn(Shape::new(1, 1, 2, 4), |_, _, _, w| if w < 2 { 1.0 } else { 2.0 });
        let d = tape.constant(step.clone());
        let flat = smoothness(d, &Tensor::full(Shape::new(1, 1, 2, 4), 0.0)).value().item();
        assert!(smoothness(d, &step).value().item() < 0.5 * flat);
    }

    /// Map, image and seed of a size.
    fn pair(seed: u64, shape: Shape) -> (Tensor<f64>, Tensor<f64>) {
        (random(seed, shape, 0.1, 0.9), random(seed + 1, shape.with_c(3), 0.0, 1.0))
    }

    #[test]
    fn equals_the_composed_form_at_any_size() {
        for (i, [h, w]) in [[2, 2], [2, 5], [5, 2], [33, 17], [32, 16], [65, 33], [31, 70]].into_iter().enumerate() {
            for (channels, normalise) in [(1, true), (1, false), (2, false)] {
                let (map, image) = pair(10 * i as u64, Shape::new(2, channels, h, w));
                let tape = Tape::new();
                let v = [tape.leaf(map.clone()), tape.leaf(map)];
                let fast = if normalise { normalised_edge_aware(v[0], &image, 1.5) } else { edge_aware(v[0], &image, 1.5) };
                let whole = if normalise { mean_normalised(v[1]) } else { v[1] };
                let slow = edge_aware_of_both(whole, tape.constant(image), 1.5);
                assert!((fast.value().item() - slow.value().item()).abs() < 1e-13);
                let grads = tape.backward(fast.add(slow).scale(3.0));
                let [a, b] = v.map(|v| grads.wrt(v));
                let off = a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(off < 1e-12, "{h} x {w}, {channels} channels: {off:e}");
            }
        }
    }

    #[test]
    fn single_precision_is_near_and_any_number_of_threads_gives_the_same_bits() {
        let (map, image) = pair(3, Shape::new(2, 1, 67, 45));
        let tape = Tape::new();
        let exact = smoothness(tape.constant(map.clone()), &image).value().item();
        let single = |x: &Tensor<f64>| Tensor::from_vec(x.shape(), x.data().iter().map(|&x| x as f32).collect());
        let (map, image) = (single(&map), single(&image));
        let run = |threads| {
            par::with_threads(threads, || {
                let tape = Tape::new();
                let v = tape.leaf(map.clone());
                let loss = smoothness(v, &image);
                let gradient = tape.backward(loss).wrt(v);
                (loss.value().item(), gradient.data().iter().map(|x| x.to_bits()).collect::<Vec<_>>())
            })
        };
        let one = run(1);
        assert!((f64::from(one.0) / exact - 1.0).abs() < 1e-6);
        assert!((2..=4).all(|threads| run(threads) == one));
    }

    #[test]
    fn steps_of_nothing_have_no_gradient() {
        let tape = Tape::<f64>::new();
        let flat = tape.leaf(Tensor::full(Shape::new(1, 1, 5, 9), 0.4));
        let image = random(2, Shape::new(1, 3, 5, 9), 0.0, 1.0);
        assert!(tape.backward(edge_aware(flat, &image, 1.0)).wrt(flat).data().iter().all(|&g| g == 0.0));
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let d = random(1, Shape::new(2, 1, 4, 5), 0.1, 0.9);
        let image = random::<f64>(2, Shape::new(2, 3, 4, 5), 0.0, 1.0);
        gradcheck(&[d], |_, v| smoothness(v[0], &image), GradCheck { step: 1e-6, ..GradCheck::default() }).assert_ok();
    }

    #[test]
    fn scale_does_not_matter_and_images_may_carry_gradients() {
        let d = random::<f64>(1, Shape::new(2, 1, 4, 5), 0.1, 0.9);
        let image = random::<f64>(2, Shape::new(2, 3, 4, 5), 0.0, 1.0);
        let tape = Tape::new();
        let leaf = tape.leaf(d.clone());
        let fixed = smoothness(leaf, &image).value().item();
        let scaled = smoothness(leaf.scale(7.0), &image).value().item();
        let both = edge_aware_of_both(mean_normalised(leaf), tape.leaf(image.clone()), 1.0).value().item();
        assert!((fixed - scaled).abs() < 1e-6 && (fixed - both).abs() < 1e-14, "{fixed} {scaled} {both}");
        let check = GradCheck { step: 1e-6, ..GradCheck::default() };
        gradcheck(&[d, image], |_, v| edge_aware_of_both(v[0], v[1], 1.5), check).assert_ok();
    }
}

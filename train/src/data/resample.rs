//! New sizes for rasters: antialiased for colours, nearest for depth.

use super::{Image, Map};

/// What one output sample takes from the input: `weights` for the inputs from `first` on; they sum to 1.
struct Tap {
    first: usize,
    weights: Vec<f32>,
}

/// Triangle-filter taps for `output` samples from `input` samples, both with half-pixel borders.
///
/// The centre of output i lies at (i + 1/2) s - 1/2 of the input, s = input / output. The triangle is max(s, 1) wide to each
/// side: shrinking averages over what an output pixel covers, growing interpolates linearly.
fn taps(input: usize, output: usize) -> Vec<Tap> {
    let scale = input as f64 / output as f64;
    let radius = scale.max(1.0);
    let last = input as f64 - 1.0;
    (0..output)
        .map(|i| {
            let centre = (i as f64 + 0.5) * scale - 0.5;
            let first = (centre - radius).ceil().clamp(0.0, last) as usize;
            let end = (centre + radius).floor().clamp(0.0, last) as usize;
            let inside = centre >= radius && centre + radius <= last;
            let weights = (first..=end).map(|x| (1.0 - (x as f64 - centre).abs() / radius).max(0.0)).collect();
            Tap { first, weights: normalised(weights, centre - first as f64, inside) }
        })
        .collect()
}

/// Weights that sum to 1 and, if `centred`, have their centre of mass exactly at `centre` (counted from the first weight): a
/// triangle sampled at whole pixels is off by some hundredths of a pixel, which would move the picture against the
/// intrinsics. The correction is the smallest linear factor that removes it.
fn normalised(mut weights: Vec<f64>, centre: f64, centred: bool) -> Vec<f32> {
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    let moment = |f: &dyn Fn(f64) -> f64| weights.iter().enumerate().map(|(k, w)| w * f(k as f64)).sum::<f64>();
    let mean = moment(&|k| k);
    let variance = moment(&|k| (k - mean) * (k - mean));
    let slope = if centred && variance > 0.0 { (centre - mean) / variance } else { 0.0 };
    weights.iter().enumerate().map(|(k, w)| (w * (1.0 + slope * (k as f64 - mean))) as f32).collect()
}

/// An image at a new size, antialiased by a separable triangle filter; equal sizes give the same image. A linear ramp stays exactly where its pixels are (away from the border).
///
/// **Panics** when the new size is empty.
#[track_caller]
pub fn resize_image(image: &Image, width: usize, height: usize) -> Image {
    assert!(width > 0 && height > 0, "resize_image: {}x{} to {width}x{height}", image.width, image.height);
    if (width, height) == (image.width, image.height) {
        return image.clone();
    }
    let (columns, rows) = (taps(image.width, width), taps(image.height, height));
    let mut data = Vec::with_capacity(image.channels * width * height);
    for channel in 0..image.channels {
        let narrow = resize_rows(image.plane(channel), image.width, &columns);
        data.extend(resize_columns(&narrow, width, &rows));
    }
    Image::from_vec(image.channels, height, width, data)
}

/// Every row filtered along u.
fn resize_rows(plane: &[f32], width: usize, taps: &[Tap]) -> Vec<f32> {
    let mut out = Vec::with_capacity(plane.len() / width * taps.len());
    for row in plane.chunks_exact(width) {
        out.extend(taps.iter().map(|tap| {
            let inputs = &row[tap.first..tap.first + tap.weights.len()];
            inputs.iter().zip(&tap.weights).map(|(x, w)| x * w).sum::<f32>()
        }));
    }
    out
}

/// Every column filtered along v.
fn resize_columns(plane: &[f32], width: usize, taps: &[Tap]) -> Vec<f32> {
    let mut out = vec![0.0; taps.len() * width];
    for (tap, target) in taps.iter().zip(out.chunks_exact_mut(width)) {
        for (k, weight) in tap.weights.iter().enumerate() {
            let row = &plane[(tap.first + k) * width..][..width];
            target.iter_mut().zip(row).for_each(|(t, x)| *t += weight * x);
        }
    }
    out
}

/// A map at a new size, each pixel the nearest of the old ones: values (and 0, unknown) are never mixed.
///
/// **Panics** when the new size is empty.
#[track_caller]
pub fn resize_map_nearest(map: &Map, width: usize, height: usize) -> Map {
    assert!(width > 0 && height > 0, "resize_map_nearest: {}x{} to {width}x{height}", map.width, map.height);
    let nearest = |i: usize, from: usize, to: usize| ((2 * i + 1) * from / (2 * to)).min(from - 1);
    let mut data = Vec::with_capacity(width * height);
    for v in 0..height {
        let row = &map.data[nearest(v, map.height, height) * map.width..][..map.width];
        data.extend((0..width).map(|u| row[nearest(u, map.width, width)]));
    }
    Map::from_vec(height, width, data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn halving_weighs_four_neighbours() {
        let image = Image::from_vec(1, 1, 4, vec![0.0, 0.0, 0.8, 0.8]);
        let half = resize_image(&image, 2, 1);
        // Weights 3/4 and 1/4 at distances 1/2 and 3/2 of a radius of 2; at the border they are normalised.
        assert!((half.data[0] - 0.8 / 7.0).abs() < 1e-6, "{half:?}");
        assert!((half.data[1] - 0.8 * 6.0 / 7.0).abs() < 1e-6, "{half:?}");
    }

    #[test]
    fn a_ramp_stays_where_its_pixels_are() {
        for (width, height) in [(37, 21), (64, 48), (160, 99), (50, 20)] {
            let (old_w, old_h) = (131, 77);
            let image = Image::from_fn(1, old_h, old_w, |_, v, u| 0.5 * u as f32 - 0.25 * v as f32);
            let new = resize_image(&image, width, height);
            let at = |i: usize, from: usize, to: usize| (i as f32 + 0.5) * from as f32 / to as f32 - 0.5;
            for (v, u) in [(height / 2, width / 2), (5, 6), (height - 6, width - 6)] {
                let expected = 0.5 * at(u, old_w, width) - 0.25 * at(v, old_h, height);
                assert!((new.at(0, v, u) - expected).abs() < 1e-4, "{width}x{height} ({u}, {v})");
            }
        }
    }

    #[test]
    fn fine_stripes_become_grey_instead_of_aliasing() {
        let image = Image::from_fn(3, 8, 64, |_, _, u| (u % 2) as f32);
        let small = resize_image(&image, 16, 2);
        assert!(small.data.iter().all(|x| (x - 0.5).abs() < 0.1), "{small:?}");
    }

    #[test]
    fn nearest_takes_values_and_never_mixes() {
        let map = Map::from_vec(2, 4, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
        assert_eq!(resize_map_nearest(&map, 2, 1).data, vec![6.0, 8.0]);
        assert_eq!(resize_map_nearest(&map, 4, 2), map);
        assert_eq!(resize_map_nearest(&map, 8, 2).data[..8], [1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0]);
    }

    proptest! {
        #[test]
        fn constant_images_stay_constant(w in 1usize..40, h in 1usize..40, nw in 1usize..60, nh in 1usize..60) {
            let image = Image::from_vec(1, h, w, vec![0.7; w * h]);
            let new = resize_image(&image, nw, nh);
            prop_assert_eq!((new.width, new.height), (nw, nh));
            prop_assert!(new.data.iter().all(|x| (x - 0.7).abs() < 1e-5));
        }
    }
}

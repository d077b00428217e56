//! A pseudo-depth without a teacher: the network's own inverse depth, smoothed by a guided filter with the image as guide
//! (He, Sun and Tang 2013).
//!
//! With box means `m` over windows of radius `r`, clipped at the border: `a = (m(g y) - m(g) m(y)) / (m(g g) - m(g)^2 + eps)`,
//! `b = m(y) - a m(g)`, `q = m(a) g + m(b)`, guide `g` the luminance, `y` the mean-normalised inverse depth.

use dimode_autodiff::{Scalar, Tensor, par};

/// Regularisation of the filter.
const EPSILON: f64 = 1e-3;
/// Smallest filtered inverse depth.
const SMALLEST: f64 = 1e-3;

/// `1 / guided(1 / depth)` for maps `[n, 1, h, w]` under images `[n, 3, h, w]`; carries no gradient.
///
/// # Panics
/// When sizes differ or images do not have three channels.
#[track_caller]
pub fn self_guided<T: Scalar>(depth: &Tensor<T>, images: &Tensor<T>) -> Tensor<T> {
    self_guided_with(depth, images, (depth.shape().h() / 48).max(2))
}

/// As [`self_guided`] with a window of `2 radius + 1` pixels.
#[track_caller]
pub fn self_guided_with<T: Scalar>(depth: &Tensor<T>, images: &Tensor<T>, radius: usize) -> Tensor<T> {
    let filtered = filtered_inverse(depth, images, radius);
    Tensor::from_vec(depth.shape(), filtered.iter().map(|q| T::from_f64(1.0 / q.max(SMALLEST))).collect())
}

/// The filtered, mean-normalised inverse depth `q` of [`self_guided_with`], in the order of the depth's buffer.
#[track_caller]
pub fn filtered_inverse<T: Scalar>(depth: &Tensor<T>, images: &Tensor<T>, radius: usize) -> Vec<f64> {
    let (s, i) = (depth.shape(), images.shape());
    assert!(s.n() == i.n() && i.c() == 3 && s.h() == i.h() && s.w() == i.w(), "self_guided: depth {s} under images {i}");
    let maps = par::map_indices(s.n(), |n| {
        let inverse: Vec<f64> = depth.plane(n, 0).iter().map(|d| 1.0 / d.to_f64()).collect();
        let mean = inverse.iter().sum::<f64>() / inverse.len() as f64 + 1e-7;
        let input: Vec<f64> = inverse.iter().map(|y| y / mean).collect();
        guided_filter(&luminance(images, n), &input, s.h(), s.w(), radius)
    });
    maps.concat()
}

/// `0.2989 R + 0.5870 G + 0.1140 B` of one sample of images `[n, 3, h, w]`: the guide.
pub fn luminance<T: Scalar>(images: &Tensor<T>, sample: usize) -> Vec<f64> {
    let colour = |c| images.plane(sample, c).iter().map(|x| x.to_f64());
    colour(0).zip(colour(1)).zip(colour(2)).map(|((r, g), b)| 0.2989 * r + 0.5870 * g + 0.1140 * b).collect()
}

/// The filter on one map of `h x w`.
pub fn guided_filter(guide: &[f64], input: &[f64], h: usize, w: usize, radius: usize) -> Vec<f64> {
    let mean = |x: &[f64]| box_mean(x, h, w, radius);
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<_>>();
    let (mg, my) = (mean(guide), mean(input));
    let (mgy, mgg) = (mean(&product(guide, input)), mean(&product(guide, guide)));
    let a: Vec<f64> = (0..guide.len()).map(|i| (mgy[i] - mg[i] * my[i]) / (mgg[i] - mg[i] * mg[i] + EPSILON)).collect();
    let b: Vec<f64> = (0..guide.len()).map(|i| my[i] - a[i] * mg[i]).collect();
    let (ma, mb) = (mean(&a), mean(&b));
    (0..guide.len()).map(|i| ma[i] * guide[i] + mb[i]).collect()
}

/// Mean over a window of `2 radius + 1` clipped at the border, by running sums.
fn box_mean(x: &[f64], h: usize, w: usize, radius: usize) -> Vec<f64> {
    let mut rows = vec![0.0; x.len()];
    for (row, out) in x.chunks_exact(w).zip(rows.chunks_exact_mut(w)) {
        for (u, o) in out.iter_mut().enumerate() {
            let (from, to) = (u.saturating_sub(radius), (u + radius + 1).min(w));
            *o = row[from..to].iter().sum::<f64>() / (to - from) as f64;
        }
    }
    let mut out = vec![0.0; x.len()];
    for v in 0..h {
        let (from, to) = (v.saturating_sub(radius), (v + radius + 1).min(h));
        for u in 0..w {
            out[v * w + u] = (from..to).map(|v| rows[v * w + u]).sum::<f64>() / (to - from) as f64;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_guide_gives_twice_the_box_mean() {
        let input: Vec<f64> = (0..30).map(|i| f64::from(i * 7 % 11)).collect();
        let got = guided_filter(&[0.4; 30], &input, 5, 6, 2);
        let want = box_mean(&box_mean(&input, 5, 6, 2), 5, 6, 2);
        assert!(got.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn an_input_equal_to_the_guide_is_nearly_kept_where_it_varies() {
        let guide: Vec<f64> = (0..60).map(|i| if i % 10 < 5 { 0.0 } else { 1.0 }).collect();
        let got = guided_filter(&guide, &guide, 6, 10, 2);
        assert!(got[4] < 0.02 && got[5] > 0.98, "{} {}", got[4], got[5]);
    }

    #[test]
    fn box_mean_clips_its_window() {
        assert_eq!(box_mean(&[1.0, 2.0, 6.0], 1, 3, 1), [1.5, 3.0, 4.0]);
    }
}

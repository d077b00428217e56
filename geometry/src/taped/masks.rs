//! Which pixels a loss may use. Masks are tensors (N,1,H,W) of 0 and 1, or of weights in between; none carries a gradient.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Shape, Tape, Tensor, par};

use super::visibility::{ForwardBackward, forward_backward};
use super::warp;

/// One channel of the size of `map`.
pub(super) fn like(map: Shape) -> Shape {
    Shape::new(map.n(), 1, map.h(), map.w())
}

/// Mask, of the size of `map`, of the pixels for which `keep(sample)(flat pixel index)` holds; samples in parallel.
fn from_fn<T: Scalar, K: Fn(usize) -> bool>(map: &Tensor<T>, keep: impl Fn(usize) -> K + Sync + Send) -> Tensor<T> {
    weights_from_fn(map, |n| {
        let keep = keep(n);
        move |i| if keep(i) { T::ONE } else { T::ZERO }
    })
}

/// Weights `weight(sample)(flat pixel index)` beside `map` and of its size; samples in parallel.
fn weights_from_fn<T: Scalar, W: Fn(usize) -> T>(map: &Tensor<T>, weight: impl Fn(usize) -> W + Sync + Send) -> Tensor<T> {
    let shape = like(map.shape());
    map.beside(shape, |data| {
        par::for_each_chunk(data, shape.plane(), |n, chunk| {
            let weight = weight(n);
            for (i, out) in chunk.iter_mut().enumerate() {
                *out = weight(i);
            }
        });
    })
}

/// All pixels.
#[must_use]
pub fn everywhere<T: Scalar>(map: Shape) -> Tensor<T> {
    Tensor::full(like(map), T::ONE)
}

/// Pixels whose flow ends inside the image: `0 <= u + f_u <= W - 1`, `0 <= v + f_v <= H - 1`.
///
/// `flow` is (N,C,H,W) with the flow in the first two channels. Flows that are not finite are out of view.
#[must_use]
pub fn in_view<T: Scalar>(flow: &Tensor<T>) -> Tensor<T> {
    let s = flow.shape();
    let (right, bottom) = (T::from_usize(s.w() - 1), T::from_usize(s.h() - 1));
    from_fn(flow, |n| {
        let (flow_u, flow_v) = (flow.plane(n, 0), flow.plane(n, 1));
        move |i| {
            let u = T::from_usize(i % s.w()) + flow_u[i];
            let v = T::from_usize(i / s.w()) + flow_v[i];
            u >= T::ZERO && u <= right && v >= T::ZERO && v <= bottom
        }
    })
}

/// Pixels of channel `channel` above a threshold (NaN is not).
#[must_use]
pub fn above<T: Scalar>(map: &Tensor<T>, channel: usize, threshold: f64) -> Tensor<T> {
    let threshold = T::from_f64(threshold);
    from_fn(map, |n| {
        let map = map.plane(n, channel);
        move |i| map[i] > threshold
    })
}

/// Pixels of a one-channel map that are `least` or more (NaN is not).
#[must_use]
pub fn at_least<T: Scalar>(map: &Tensor<T>, least: f64) -> Tensor<T> {
    from_fn(map, |n| {
        let map = map.plane(n, 0);
        move |i| map[i].to_f64() >= least
    })
}

/// Static pixels: squared distance of rigid and optical flow below its mean over the image.
///
/// Both maps are (N,C,H,W) with the flow in the first two channels, pixels. The mean runs over `within`
/// (all pixels when `None`), image by image; pixels outside `within` are not static.
///
/// **Panics** when the sizes differ.
#[must_use]
#[track_caller]
pub fn static_pixels<T: Scalar>(rigid: &Tensor<T>, optical: &Tensor<T>, within: Option<&Tensor<T>>) -> Tensor<T> {
    below_mean(rigid, optical, within, 1.0, |distance, _| distance)
}

/// [`static_pixels`] by the distance relative to the flow, `|f_rig - f_opt|^2 / (1 + |f_opt|^2)`, below four times its mean.
///
/// The plain test leaves out the pixels that are furthest off, and those are the near ones as long as depth or motion is
/// wrong: what moves most can never be corrected. Here only pixels stay out that disagree far more than the rest.
#[must_use]
#[track_caller]
pub fn relatively_static<T: Scalar>(rigid: &Tensor<T>, optical: &Tensor<T>, within: Option<&Tensor<T>>) -> Tensor<T> {
    below_mean(rigid, optical, within, 4.0, |distance, flow| distance / (1.0 + flow))
}

/// Pixels where `measure(|f_rig - f_opt|^2, |f_opt|^2)` is below `factor` times its mean.
#[track_caller]
fn below_mean<T: Scalar>(
    rigid: &Tensor<T>,
    optical: &Tensor<T>,
    within: Option<&Tensor<T>>,
    factor: f64,
    measure: impl Fn(f64, f64) -> f64 + Sync,
) -> Tensor<T> {
    let s = rigid.shape();
    assert!(like(s) == like(optical.shape()), "static pixels: {s} and {} differ", optical.shape());
    let measure = &measure;
    from_fn(rigid, |n| {
        let (ru, rv) = (rigid.plane(n, 0), rigid.plane(n, 1));
        let (ou, ov) = (optical.plane(n, 0), optical.plane(n, 1));
        let inside = within.map(|m| m.plane(n, 0));
        let square = |x: T, y: T| x.to_f64() * x.to_f64() + y.to_f64() * y.to_f64();
        let measured = move |i: usize| {
            let counts = inside.is_none_or(|m| m[i] != T::ZERO);
            counts.then(|| measure(square(ru[i] - ou[i], rv[i] - ov[i]), square(ou[i], ov[i])))
        };
        let (sum, count) = (0..s.plane()).filter_map(measured).fold((0.0, 0), |(s, c), d| (s + d, c + 1));
        let limit = factor * sum / f64::from(count.max(1));
        move |i| measured(i).is_some_and(|d| d < limit)
    })
}

/// Backward flow read where the forward flow ends (bilinear, 0 outside), (N,2,H,W).
#[must_use]
#[track_caller]
pub fn backward_at_forward<T: Scalar>(forward: &Tensor<T>, backward: &Tensor<T>) -> Tensor<T> {
    let tape = Tape::new();
    warp(tape.constant(backward.clone()), tape.constant(forward.clone()), SamplePadding::Zeros).value()
}

/// Pixels that pass the forward-backward test: `|F + B|^2 <= 0.01 (|F|^2 + |B|^2) + 0.5`, with the
/// backward flow `B` read where `F` ends.
///
/// Both flows are (N,2,H,W), pixels; `forward` leads from target to source.
#[must_use]
#[track_caller]
pub fn not_occluded<T: Scalar>(forward: &Tensor<T>, backward: &Tensor<T>) -> Tensor<T> {
    let ForwardBackward { deviation, allowed } = forward_backward(forward, backward);
    from_fn(forward, |n| {
        let (deviation, allowed) = (deviation.plane(n, 0), allowed.plane(n, 0));
        move |i| deviation[i] <= allowed[i]
    })
}

/// Pixels where rigid and optical flow differ by less than `pixels`: the test of matches by which DF-VO tells moving things
/// (5 pixels) [Huangying-Zhan/DF-VO, `libs/tracker/E_tracker.py`].
///
/// Both maps are (N,C,H,W) with the flow in the first two channels, pixels.
///
/// **Panics** when the sizes differ.
#[must_use]
#[track_caller]
pub fn agreeing<T: Scalar>(rigid: &Tensor<T>, optical: &Tensor<T>, pixels: f64) -> Tensor<T> {
    let s = rigid.shape();
    let squares = grid_distance(rigid, optical, [1.0, 1.0]);
    from_fn(rigid, |n| {
        let squares = &squares[n * s.plane()..][..s.plane()];
        move |i| squares[i] < pixels * pixels
    })
}

/// Static pixels by the test of Dynamo-Depth as it is coded: squared distance of the two sampling positions below its mean
/// over the whole batch, in the units of a sampling grid from -1 to 1 (`2 / (W - 1)` and `2 / (H - 1)` for a pixel).
///
/// Both maps are (N,C,H,W) with the flow in the first two channels, pixels. [`static_pixels`] is the form to use: it weighs
/// both axes alike and lets no image decide for another.
///
/// **Panics** when the sizes differ or a side is one pixel long.
#[must_use]
#[track_caller]
pub fn static_on_grid<T: Scalar>(ego: &Tensor<T>, complete: &Tensor<T>) -> Tensor<T> {
    let squares = squared_grid_distance(ego, complete);
    let mean = squares.data().iter().map(|d| d.to_f64()).sum::<f64>() / squares.shape().len() as f64;
    from_fn(&squares, |n| {
        let squares = squares.plane(n, 0);
        move |i| squares[i].to_f64() < mean
    })
}

/// The squared distances that [`static_on_grid`] compares, (N,1,H,W).
///
/// **Panics** when the sizes differ or a side is one pixel long.
#[must_use]
#[track_caller]
pub fn squared_grid_distance<T: Scalar>(ego: &Tensor<T>, complete: &Tensor<T>) -> Tensor<T> {
    let s = ego.shape();
    assert!(s.h() > 1 && s.w() > 1, "static_on_grid: a grid needs at least 2 x 2 pixels, got {s}");
    let units = [2.0 / (s.w() - 1) as f64, 2.0 / (s.h() - 1) as f64];
    let squares = grid_distance(ego, complete, units);
    Tensor::from_vec(like(s), squares.into_iter().map(T::from_f64).collect())
}

/// Squared distances of two flows whose components are multiplied by `units`.
#[track_caller]
fn grid_distance<T: Scalar>(a: &Tensor<T>, b: &Tensor<T>, units: [f64; 2]) -> Vec<f64> {
    let s = a.shape();
    assert!(like(s) == like(b.shape()), "distance of flows: {s} and {} differ", b.shape());
    let planes = par::map_indices(s.n(), |n| {
        let part = |c: usize, i: usize| (a.plane(n, c)[i].to_f64() - b.plane(n, c)[i].to_f64()) * units[c];
        (0..s.plane()).map(|i| part(0, i).powi(2) + part(1, i).powi(2)).collect::<Vec<f64>>()
    });
    planes.concat()
}

/// Pixels of all masks. Of weights it is the product.
///
/// **Panics** for an empty list or different shapes.
#[must_use]
#[track_caller]
pub fn all_of<T: Scalar>(masks: &[&Tensor<T>]) -> Tensor<T> {
    let first = masks.first().expect("all_of: no mask given");
    assert!(masks.iter().all(|m| m.shape() == first.shape()), "all_of: masks of different shapes");
    weights_from_fn(first, |n| {
        let planes: Vec<&[T]> = masks.iter().map(|m| m.plane(n, 0)).collect();
        move |i| planes.iter().fold(T::ONE, |product, plane| product * plane[i])
    })
}

/// Pixels of a mask that also satisfy `keep(sample)(flat pixel index)`, with the weights that they have.
pub(crate) fn and_where<T: Scalar, K: Fn(usize) -> bool>(mask: &Tensor<T>, keep: impl Fn(usize) -> K + Sync + Send) -> Tensor<T> {
    weights_from_fn(mask, |n| {
        let (mask, keep) = (mask.plane(n, 0), keep(n));
        move |i| if mask[i] != T::ZERO && keep(i) { mask[i] } else { T::ZERO }
    })
}

/// Number of pixels of a mask, image by image.
#[must_use]
pub fn counts<T: Scalar>(mask: &Tensor<T>) -> Vec<usize> {
    (0..mask.shape().n()).map(|n| mask.plane(n, 0).iter().filter(|&&m| m != T::ZERO).count()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flow(u: [f64; 4], v: [f64; 4]) -> Tensor<f64> {
        Tensor::from_vec(Shape::new(1, 2, 2, 2), [u, v].concat())
    }

    #[test]
    fn borders_belong_to_the_view() {
        let mask = in_view(&flow([1.0, 0.0, 1.001, f64::NAN], [0.0, 1.0, 0.0, 0.0]));
        assert_eq!(mask.to_vec(), [1.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn a_large_error_on_a_large_flow_is_relatively_static() {
        let shape = Shape::new(1, 2, 1, 6);
        let optical = Tensor::from_vec(shape, [vec![1.0, 1.0, 1.0, 1.0, 1.0, 20.0], vec![0.0; 6]].concat());
        let rigid = Tensor::from_vec(shape, [vec![0.5, 0.5, 0.5, 4.0, 7.0, 10.0], vec![0.0; 6]].concat());
        // Squared distances 0.25 (three times), 9, 36, 100; their mean is 24.3.
        assert_eq!(static_pixels(&rigid, &optical, None).to_vec(), [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
        // Relative to 1 + |f|^2: 0.125 (three times), 4.5, 18, 0.249. 4.5 is above their mean of 3.9, below four times it.
        assert_eq!(relatively_static::<f64>(&rigid, &optical, None).to_vec(), [1.0, 1.0, 1.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn one_outlier_is_not_static() {
        let (zero, moved) = (flow([0.0; 4], [0.0; 4]), flow([0.1, 0.2, 3.0, 0.1], [0.0; 4]));
        assert_eq!(static_pixels(&zero, &moved, None).to_vec(), [1.0, 1.0, 0.0, 1.0]);
        let within = Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![1.0, 1.0, 0.0, 1.0]);
        assert_eq!(static_pixels(&zero, &moved, Some(&within)).to_vec(), [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn the_grid_test_weighs_axes_by_their_lengths_and_pools_the_batch() {
        let shape = Shape::new(2, 2, 2, 3);
        let optical = Tensor::from_fn(shape, |n, c, h, w| match (n, c, h, w) {
            (0, 0, 0, 0) => 1.0, // 1 in grid units
            (0, 1, 0, 1) => 1.0, // 2 in grid units
            (1, 0, 1, 2) => 3.0, // 3 in grid units
            _ => 0.0,
        });
        let zero = Tensor::zeros(shape);
        let squares = squared_grid_distance(&zero, &optical);
        assert_eq!((squares.at(0, 0, 0, 0), squares.at(0, 0, 0, 1), squares.at(1, 0, 1, 2)), (1.0, 4.0, 9.0));
        // Mean 14/12: the first one is static here, and would not be against the mean 5/6 of its own image.
        let still = static_on_grid(&zero, &optical);
        assert_eq!((still.at(0, 0, 0, 0), still.at(0, 0, 0, 1), still.at(1, 0, 1, 2)), (1.0, 0.0, 0.0));
        assert_eq!(counts(&still), [5, 5]);
    }

    #[test]
    fn flows_agree_within_a_distance_in_pixels() {
        let (zero, moved) = (flow([0.0; 4], [0.0; 4]), flow([3.0, 5.0, 4.9, f64::NAN], [4.0, 0.0, 0.0, 0.0]));
        assert_eq!(agreeing(&zero, &moved, 5.0).to_vec(), [0.0, 0.0, 1.0, 0.0]);
        assert_eq!(at_least(&zero, 0.0).to_vec(), [1.0; 4]);
    }

    #[test]
    fn opposite_flows_agree_and_equal_ones_do_not() {
        let forward = flow([1.0, 0.0, 0.0, 0.0], [0.0; 4]);
        let good = flow([0.0, -1.0, 0.0, 0.0], [0.0; 4]);
        assert_eq!(not_occluded(&forward, &good).to_vec(), [1.0, 0.0, 1.0, 1.0]);
    }

    #[test]
    fn combinations() {
        let m = |v: [f64; 4]| Tensor::from_vec(Shape::new(1, 1, 2, 2), v.to_vec());
        let both = all_of(&[&m([1.0, 1.0, 0.0, 1.0]), &m([0.0, 1.0, 1.0, 1.0])]);
        assert_eq!((both.to_vec(), counts(&both)), (vec![0.0, 1.0, 0.0, 1.0], vec![2]));
        assert_eq!(above(&m([0.1, 0.2, f64::NAN, -1.0]), 0, 0.1).to_vec(), [0.0, 1.0, 0.0, 0.0]);
        assert_eq!(and_where(&both, |_| |i| i > 2).to_vec(), [0.0, 0.0, 0.0, 1.0]);
        let soft = all_of(&[&both, &m([0.5, 0.25, 0.5, 0.75])]);
        assert_eq!((soft.to_vec(), counts(&soft)), (vec![0.0, 0.25, 0.0, 0.75], vec![2]));
        assert_eq!(and_where(&soft, |_| |i| i > 2).to_vec(), [0.0, 0.0, 0.0, 0.75]);
        assert_eq!(everywhere::<f32>(Shape::new(1, 2, 1, 3)).to_vec(), [1.0; 3]);
    }
}

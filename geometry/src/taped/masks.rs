//! Which pixels a loss may use. Masks are tensors (N,1,H,W) of 0 and 1; none carries a gradient.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Shape, Tape, Tensor, par};

use super::warp;

/// Share of the squared flow lengths allowed as forward-backward deviation.
const OCCLUSION_SLOPE: f64 = 0.01;
/// Squared pixels allowed as forward-backward deviation on top of that share.
const OCCLUSION_OFFSET: f64 = 0.5;

fn like(map: Shape) -> Shape {
    Shape::new(map.n(), 1, map.h(), map.w())
}

/// Mask of the pixels for which `keep(sample)(flat pixel index)` holds; samples in parallel.
fn from_fn<T: Scalar, K: Fn(usize) -> bool>(map: Shape, keep: impl Fn(usize) -> K + Sync + Send) -> Tensor<T> {
    let plane = map.plane();
    let mut data = vec![T::ZERO; map.n() * plane];
    par::for_each_chunk(&mut data, plane.max(1), |n, chunk| {
        let keep = keep(n);
        for (i, kept) in chunk.iter_mut().enumerate() {
            *kept = if keep(i) { T::ONE } else { T::ZERO };
        }
    });
    Tensor::from_vec(like(map), data)
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
    from_fn(s, |n| {
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
    from_fn(map.shape(), |n| {
        let map = map.plane(n, channel);
        move |i| map[i] > threshold
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
    let masks = par::map_indices(s.n(), |n| {
        let (ru, rv) = (rigid.plane(n, 0), rigid.plane(n, 1));
        let (ou, ov) = (optical.plane(n, 0), optical.plane(n, 1));
        let inside = within.map(|m| m.plane(n, 0));
        let square = |x: T, y: T| x.to_f64() * x.to_f64() + y.to_f64() * y.to_f64();
        let measured: Vec<Option<f64>> = (0..s.plane())
            .map(|i| {
                let counts = inside.is_none_or(|m| m[i] != T::ZERO);
                counts.then(|| measure(square(ru[i] - ou[i], rv[i] - ov[i]), square(ou[i], ov[i])))
            })
            .collect();
        let (sum, count) = measured.iter().flatten().fold((0.0, 0), |(s, c), d| (s + d, c + 1));
        let limit = factor * sum / f64::from(count.max(1));
        measured.into_iter().map(|d| if d.is_some_and(|d| d < limit) { T::ONE } else { T::ZERO }).collect::<Vec<T>>()
    });
    Tensor::from_vec(like(s), masks.concat())
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
    let back = backward_at_forward(forward, backward);
    from_fn(forward.shape(), |n| {
        let (f, b) = ([0, 1].map(|c| forward.plane(n, c)), [0, 1].map(|c| back.plane(n, c)));
        move |i| {
            let [f_u, f_v, b_u, b_v] = [f[0], f[1], b[0], b[1]].map(|plane| plane[i].to_f64());
            let deviation = (f_u + b_u).powi(2) + (f_v + b_v).powi(2);
            let sizes = f_u.powi(2) + f_v.powi(2) + b_u.powi(2) + b_v.powi(2);
            deviation <= OCCLUSION_SLOPE * sizes + OCCLUSION_OFFSET
        }
    })
}

/// Pixels of all masks.
///
/// **Panics** for an empty list or different shapes.
#[must_use]
#[track_caller]
pub fn all_of<T: Scalar>(masks: &[&Tensor<T>]) -> Tensor<T> {
    let shape = masks.first().expect("all_of: no mask given").shape();
    assert!(masks.iter().all(|m| m.shape() == shape), "all_of: masks of different shapes");
    from_fn(shape, |n| {
        let planes: Vec<&[T]> = masks.iter().map(|m| m.plane(n, 0)).collect();
        move |i| planes.iter().all(|plane| plane[i] != T::ZERO)
    })
}

/// Pixels of a mask that also satisfy `keep(sample)(flat pixel index)`.
pub(crate) fn and_where<T: Scalar, K: Fn(usize) -> bool>(mask: &Tensor<T>, keep: impl Fn(usize) -> K + Sync + Send) -> Tensor<T> {
    from_fn(mask.shape(), |n| {
        let (mask, keep) = (mask.plane(n, 0), keep(n));
        move |i| mask[i] != T::ZERO && keep(i)
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
        assert_eq!(everywhere::<f32>(Shape::new(1, 2, 1, 3)).to_vec(), [1.0; 3]);
    }
}

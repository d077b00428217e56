//! Which target pixels the source sees, judged from optical flow in both directions. Maps are (N,1,H,W), without gradient.
//!
//! - Forward-backward: following the flow there and back must end near the start.
//! - Range map: how many source pixels flow to a target pixel; where nearly none does, something hides it.

use dimode_autodiff::{Scalar, Tensor, par};

use super::masks::{self, like};

/// Share of the squared flow lengths allowed as forward-backward deviation.
const SLOPE: f64 = 0.01;
/// Squared pixels allowed as forward-backward deviation on top of that share.
const OFFSET: f64 = 0.5;

/// Both sides of the forward-backward test, in square pixels.
#[derive(Clone, Debug)]
pub struct ForwardBackward<T: Scalar> {
    /// `|F + B|^2` with the backward flow `B` read where the forward flow `F` ends, (N,1,H,W).
    pub deviation: Tensor<T>,
    /// `0.01 (|F|^2 + |B|^2) + 0.5`, (N,1,H,W).
    pub allowed: Tensor<T>,
}

/// Deviation and allowance of the forward-backward test.
///
/// **Shapes**: both flows (N,2,H,W), pixels; `forward` leads from target to source, `backward` back.
/// **Source**: lliuz/ARFlow, `utils/warp_utils.py`; vt-vl-lab/DF-Net, `core/BaseLearner.py`.
/// **Panics** when the shapes differ.
#[must_use]
#[track_caller]
pub fn forward_backward<T: Scalar>(forward: &Tensor<T>, backward: &Tensor<T>) -> ForwardBackward<T> {
    let back = masks::backward_at_forward(forward, backward);
    let map = |f: fn([f64; 4]) -> f64| pixelwise(forward, &back, f);
    ForwardBackward {
        deviation: map(|[f_u, f_v, b_u, b_v]| (f_u + b_u).powi(2) + (f_v + b_v).powi(2)),
        allowed: map(|[f_u, f_v, b_u, b_v]| SLOPE * (f_u.powi(2) + f_v.powi(2) + b_u.powi(2) + b_v.powi(2)) + OFFSET),
    }
}

/// `|F + B|`, pixels, with the backward flow read where the forward flow ends: the score by which DF-VO ranks matches; which
/// it keeps is [`best_matches`](super::matches::best_matches()).
///
/// **Shapes**: flows (N,2,H,W), pixels; result (N,1,H,W).
/// **Source**: Huangying-Zhan/DF-VO, `libs/deep_models/flow/deep_flow.py`.
/// **Panics** when the shapes differ.
#[must_use]
#[track_caller]
pub fn consistency_score<T: Scalar>(forward: &Tensor<T>, backward: &Tensor<T>) -> Tensor<T> {
    let back = masks::backward_at_forward(forward, backward);
    pixelwise(forward, &back, |[f_u, f_v, b_u, b_v]| (f_u + b_u).hypot(f_v + b_v))
}

/// A map of the four components of two flows at every pixel.
fn pixelwise<T: Scalar>(first: &Tensor<T>, second: &Tensor<T>, f: impl Fn([f64; 4]) -> f64) -> Tensor<T> {
    Tensor::from_fn(like(first.shape()), |n, _, h, w| {
        let [a, b] = [first, second].map(|flow| [0, 1].map(|c| flow.at(n, c, h, w).to_f64()));
        T::from_f64(f([a[0], a[1], b[0], b[1]]))
    })
}

/// How many source pixels flow to each target pixel: ones moved along the backward flow and shared bilinearly among four pixels.
///
/// **Shapes**: `backward` (N,2,H,W), pixels, from source to target; result (N,1,H,W), 1 where the flow is a translation.
/// **Domain**: shares that fall outside the image are lost; flows that are not finite move nothing.
/// **Source**: lliuz/ARFlow, `utils/warp_utils.py`; google-research/google-research, `smurf/`.
/// **Panics** unless the flow has two channels.
#[must_use]
#[track_caller]
pub fn range_map<T: Scalar>(backward: &Tensor<T>) -> Tensor<T> {
    let s = backward.shape();
    assert!(s.c() == 2, "range_map: flow has shape (N, 2, H, W), got {s}");
    let counts = par::map_indices(s.n(), |n| splat(backward.plane(n, 0), backward.plane(n, 1), s.h(), s.w()));
    Tensor::from_vec(like(s), counts.concat())
}

fn splat<T: Scalar>(flow_u: &[T], flow_v: &[T], h: usize, w: usize) -> Vec<T> {
    let mut counts = vec![0.0; h * w];
    for (i, (u, v)) in flow_u.iter().zip(flow_v).enumerate() {
        let (x, y) = ((i % w) as f64 + u.to_f64(), (i / w) as f64 + v.to_f64());
        if !(x > -1.0 && x < w as f64 && y > -1.0 && y < h as f64) {
            continue;
        }
        for (row, share_y) in corners(y, h) {
            for (column, share_x) in corners(x, w) {
                counts[row * w + column] += share_x * share_y;
            }
        }
    }
    counts.into_iter().map(T::from_f64).collect()
}

/// The neighbours of a position along an axis of `size` pixels that lie inside, with their shares.
fn corners(position: f64, size: usize) -> impl Iterator<Item = (usize, f64)> {
    let low = position.floor();
    [(low, 1.0 - (position - low)), (low + 1.0, position - low)]
        .into_iter()
        .filter(move |&(at, _)| at >= 0.0 && at < size as f64)
        .map(|(at, share)| (at as usize, share))
}

/// Pixels to which at least `least` source pixels flow: 0.2 in ARFlow, 0.75 in other code. Not occluded by [`range_map`].
///
/// **Panics** unless the flow has two channels.
#[must_use]
#[track_caller]
pub fn reached<T: Scalar>(backward: &Tensor<T>, least: f64) -> Tensor<T> {
    masks::at_least(&range_map(backward), least)
}

/// The soft form of [`reached`]: `min(count, 1)`, a weight in `[0, 1]` (one minus the occlusion of Wang et al. and SMURF).
///
/// **Panics** unless the flow has two channels.
#[must_use]
#[track_caller]
pub fn reached_softly<T: Scalar>(backward: &Tensor<T>) -> Tensor<T> {
    let counts = range_map(backward);
    Tensor::from_vec(counts.shape(), counts.data().iter().map(|c| c.min(T::ONE)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;
    use dimode_autodiff::gradcheck::random;

    fn row(u: [f64; 4], v: [f64; 4]) -> Tensor<f64> {
        Tensor::from_vec(Shape::new(1, 2, 1, 4), [u, v].concat())
    }

    #[test]
    fn worked_deviations() {
        let (forward, backward) = (row([1.0, 0.0, 0.0, 9.0], [0.0; 4]), row([5.0, -0.4, 3.0, 0.0], [0.0, 0.3, 4.0, 0.0]));
        let test = forward_backward(&forward, &backward);
        let expected = [0.36 + 0.09, 0.4_f64.powi(2) + 0.09, 25.0, 81.0];
        let allowed = [0.01 * 1.25 + 0.5, 0.01 * 0.25 + 0.5, 0.75, 0.81 + 0.5];
        for i in 0..4 {
            assert!((test.deviation.data()[i] - expected[i]).abs() < 1e-15, "{i}");
            assert!((test.allowed.data()[i] - allowed[i]).abs() < 1e-15, "{i}");
            assert!((consistency_score(&forward, &backward).data()[i] - expected[i].sqrt()).abs() < 1e-15, "{i}");
        }
    }

    #[test]
    fn ones_are_shared_among_neighbours_and_lost_outside() {
        // To 0.25, 1 (with the one from the right), -0.5 (half is lost), and far away.
        let counts = range_map(&row([0.25, 0.0, -2.5, 100.0], [0.0; 4]));
        assert_eq!(counts.to_vec(), [0.75 + 0.5, 0.25 + 1.0, 0.0, 0.0]);
        let below = range_map(&row([0.0, 0.0, f64::NAN, 0.0], [0.25, -0.5, 0.0, 1.0]));
        assert_eq!(below.to_vec(), [0.75, 0.5, 0.0, 0.0]);
    }

    #[test]
    fn thresholds_and_soft_weights() {
        let backward = row([0.85, 0.0, -0.5, 0.0], [0.0; 4]);
        // Counts 0.15, 2.35, 0.5, 1.
        assert_eq!(reached(&backward, 0.2).to_vec(), [0.0, 1.0, 1.0, 1.0]);
        assert_eq!(reached(&backward, 0.75).to_vec(), [0.0, 1.0, 0.0, 1.0]);
        let weights = reached_softly(&backward);
        assert!((weights.data()[0] - 0.15).abs() < 1e-15);
        assert_eq!(weights.data()[1..], [1.0, 0.5, 1.0]);
    }

    #[test]
    fn no_flow_keeps_every_one_and_small_flows_lose_none_inside() {
        let shape = Shape::new(2, 2, 6, 7);
        assert_eq!(range_map(&Tensor::<f32>::zeros(shape)).to_vec(), vec![1.0; 84]);
        let inward = Tensor::from_fn(shape, |n, c, h, w| {
            let (size, at) = if c == 0 { (7, w) } else { (6, h) };
            random::<f64>(n as u64, shape, 0.0, 0.9).at(n, c, h, w) * if 2 * at < size { 1.0 } else { -1.0 }
        });
        let total: f64 = range_map(&inward).data().iter().sum();
        assert!((total - 84.0).abs() < 1e-12, "{total}");
    }
}

//! Sums over axes and their transpose, repetition along axes: the shared kernels of the reductions and of broadcasting.
//!
//! A "small" shape goes with a "large" one when every axis of it is equal or has size 1. Sums are taken in `f64`, in eight
//! lanes that are added in a fixed order, so that they have the same bits on any number of threads.

use std::ops::Range;

use crate::{GradSink, Scalar, Shape, Tensor, Var, par};

const LANES: usize = 8;

/// Panics, naming the operation and both shapes, unless `small` goes with `large`.
#[track_caller]
pub(crate) fn assert_goes_with(op: &str, small: Shape, large: Shape) {
    let fits = small.0.iter().zip(large.0).all(|(&s, l)| s == l || s == 1);
    assert!(fits, "{op}: {small} does not go with {large}; the rule: every axis of {small} is equal or has size 1");
}

/// Records the sum of `x` over the axes where `small` has size 1, divided by `divisor`.
#[track_caller]
pub(crate) fn record<'t, T: Scalar>(op: &'static str, x: Var<'t, T>, small: Shape, divisor: f64) -> Var<'t, T> {
    let large = x.shape();
    assert_goes_with(op, small, large);
    let mut y = x.tape().scratch(small.len());
    reduce(x.value().data(), large, &mut y, small, divisor);
    let y = x.tape().tensor(small, y);
    x.tape().push(op, y, &[x], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| expand(g.data(), small, out, large, divisor));
        }
    })
}

/// `out = (sum of x over the axes where small has size 1) / divisor`.
pub(crate) fn reduce<T: Scalar>(x: &[T], large: Shape, out: &mut [T], small: Shape, divisor: f64) {
    if small.len() == 1 {
        out[0] = T::from_f64(par::sum(x.len(), |piece| lane_sum(&x[piece])) / divisor);
    } else if small.w() == 1 {
        par::for_each_chunk(out, 1, |row, out| {
            let total: f64 = source_rows(row, small, large).map(|r| lane_sum(&x[r])).sum();
            out[0] = T::from_f64(total / divisor);
        });
    } else {
        par::for_each_chunk(out, small.w(), |row, out| {
            let mut totals = vec![0.0; out.len()];
            for source in source_rows(row, small, large) {
                totals.iter_mut().zip(&x[source]).for_each(|(total, x)| *total += x.to_f64());
            }
            out.iter_mut().zip(totals).for_each(|(out, total)| *out = T::from_f64(total / divisor));
        });
    }
}

/// The pieces of the large array that are summed into one row of the small one, in order: rows, or whole planes.
fn source_rows(row: usize, small: Shape, large: Shape) -> impl Iterator<Item = Range<usize>> {
    let whole_planes = small.plane() == 1;
    let (h, c, n) = (row % small.h(), row / small.h() % small.c(), row / small.h() / small.c());
    let rows = if whole_planes { 0..1 } else { span(h, small.h(), large.h()) };
    let len = if whole_planes { large.plane() } else { large.w() };
    let channels = span(c, small.c(), large.c());
    span(n, small.n(), large.n()).flat_map(move |n| {
        let rows = rows.clone();
        channels.clone().flat_map(move |c| {
            rows.clone().map(move |h| {
                let start = large.index(n, c, h, 0);
                start..start + len
            })
        })
    })
}

/// The indices of the large axis that belong to index `i` of the small one.
pub(crate) fn span(i: usize, small: usize, large: usize) -> Range<usize> {
    if small == large { i..i + 1 } else { 0..large }
}

/// `out = x / divisor`, repeated along the axes where `small` has size 1.
pub(crate) fn expand<T: Scalar>(x: &[T], small: Shape, out: &mut [T], large: Shape, divisor: f64) {
    let share = |x: T| {
        if divisor == 1.0 { x } else { T::from_f64(x.to_f64() / divisor) }
    };
    if small.len() == 1 {
        let value = share(x[0]);
        return par::for_each_chunk(out, par::CHUNK, |_, out| out.fill(value));
    }
    let width = large.w().max(1);
    let rows_per_chunk = (par::CHUNK / width).max(1);
    let pin = |i: usize, size: usize| if size == 1 { 0 } else { i };
    par::for_each_chunk(out, rows_per_chunk * width, |chunk, out| {
        for (i, out) in out.chunks_exact_mut(width).enumerate() {
            let row = chunk * rows_per_chunk + i;
            let (h, c, n) = (row % large.h(), row / large.h() % large.c(), row / large.h() / large.c());
            let at = small.index(pin(n, small.n()), pin(c, small.c()), pin(h, small.h()), 0);
            if small.w() == 1 {
                out.fill(share(x[at]));
            } else {
                out.iter_mut().zip(&x[at..at + width]).for_each(|(out, &x)| *out = share(x));
            }
        }
    });
}

/// Sum in `f64`: eight interleaved partial sums, the tail last.
pub(crate) fn lane_sum<T: Scalar>(x: &[T]) -> f64 {
    let (body, tail) = x.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for chunk in body {
        lanes.iter_mut().zip(chunk).for_each(|(lane, x)| *lane += x.to_f64());
    }
    fold_lanes(lanes) + tail.iter().map(|x| x.to_f64()).sum::<f64>()
}

/// As [`lane_sum`], over the entries whose mask is not 0.
pub(crate) fn masked_lane_sum<T: Scalar>(x: &[T], mask: &[T]) -> f64 {
    let chosen = |x: &T, m: &T| if *m == T::ZERO { 0.0 } else { x.to_f64() };
    let ((body, tail), (mask_body, mask_tail)) = (x.as_chunks::<LANES>(), mask.as_chunks::<LANES>());
    let mut lanes = [0.0; LANES];
    for (chunk, mask) in body.iter().zip(mask_body) {
        for ((lane, x), m) in lanes.iter_mut().zip(chunk).zip(mask) {
            *lane += chosen(x, m);
        }
    }
    fold_lanes(lanes) + tail.iter().zip(mask_tail).map(|(x, m)| chosen(x, m)).sum::<f64>()
}

fn fold_lanes(l: [f64; LANES]) -> f64 {
    ((l[0] + l[4]) + (l[1] + l[5])) + ((l[2] + l[6]) + (l[3] + l[7]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::{self, random};
    use proptest::prelude::*;

    #[test]
    fn lane_sums_count_every_entry_once() {
        let x: Vec<f64> = (1..=21).map(f64::from).collect();
        assert_eq!(lane_sum(&x), 231.0);
        let mask: Vec<f64> = (1..=21).map(|i| f64::from(i % 2)).collect();
        assert_eq!(masked_lane_sum(&x, &mask), 121.0);
        assert_eq!(lane_sum::<f32>(&[]), 0.0);
    }

    #[test]
    fn small_terms_survive_a_long_sum_in_f32() {
        let x = vec![0.1_f32; 1_000_001];
        let exact = f64::from(0.1_f32) * 1_000_001.0;
        assert!((lane_sum(&x) - exact).abs() < 1e-6);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn sums_over_any_axes_equal_the_plain_loop(large in testing::shapes(), keep in any::<[bool; 4]>(), seed in any::<u64>()) {
            let small = Shape(std::array::from_fn(|i| if keep[i] { large.0[i] } else { 1 }));
            let x: Tensor<f64> = random(seed, large, -1.0, 1.0);
            let mut want = vec![0.0; small.len()];
            let pin = |i: usize, axis: usize| if small.0[axis] == 1 { 0 } else { i };
            Tensor::from_fn(large, |n, c, h, w| {
                want[small.index(pin(n, 0), pin(c, 1), pin(h, 2), pin(w, 3))] += x.at(n, c, h, w) / 3.0;
                0.0
            });
            let mut got = vec![0.0; small.len()];
            reduce(x.data(), large, &mut got, small, 3.0);
            testing::close(&got, &want);
        }
    }
}

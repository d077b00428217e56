//! The frame of `max_axis` and `min_axis`: the first extreme entry of every line, found by comparison and then picked by
//! `gather`, which carries the gradient.

use super::axis::Lines;
use super::blocks::assert_axis;
use super::gather;
use crate::{Scalar, Tensor, Var};

/// What [`Var::max_axis`] and [`Var::min_axis`] return.
#[derive(Clone, Debug)]
pub struct Extremum<'t, T: Scalar> {
    /// The extreme entries; the axis has size 1.
    pub values: Var<'t, T>,
    /// Their positions along the axis, for [`Var::gather`] on another tensor; of the same shape.
    pub index: Tensor<T>,
}

/// Records the first entry of every line that no other beats; `worst` is beaten by every number but itself. NaN beats all numbers.
#[track_caller]
pub(crate) fn record<'t, T: Scalar>(
    op: &'static str,
    x: Var<'t, T>,
    axis: usize,
    worst: T,
    beats: impl Fn(T, T) -> bool + Sync + Send,
) -> Extremum<'t, T> {
    let shape = x.shape();
    assert_axis(op, axis, shape);
    let lines = Lines::along(shape, axis);
    let mut best = vec![(worst, 0); lines.count()];
    lines.fold(
        &mut best,
        [x.value().data()],
        |(best, at), k, [x]| {
            if beats(x, best) || (x.is_nan() && !best.is_nan()) { (x, k) } else { (best, at) }
        },
    );
    let index = best.into_iter().map(|(_, at)| T::from_usize(at)).collect();
    let index = Tensor::from_vec(shape.with_axis(axis, 1), index);
    Extremum { values: gather::record(op, x, axis, &index), index }
}

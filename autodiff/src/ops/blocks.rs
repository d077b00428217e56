//! Copies of a band of indices along one axis: the shared kernel of `concat` and `slice`.

use std::ops::Range;

use super::axis::Lines;
use crate::Shape;

/// The positions in a row-major buffer of `shape` of the indices `start..start + len` of `axis`: one contiguous range for
/// each combination of the axes before it, in order.
pub(crate) fn band(shape: Shape, axis: usize, start: usize, len: usize) -> impl Iterator<Item = Range<usize>> {
    let lines = Lines::along(shape, axis);
    (0..lines.outer).map(move |i| {
        let at = i * lines.block() + start * lines.inner;
        at..at + len * lines.inner
    })
}

/// Panics unless `axis` is one of the four.
#[track_caller]
pub(crate) fn assert_axis(op: &str, axis: usize, shape: Shape) {
    assert!(axis < 4, "{op}: axis {axis} of shape {shape}; the rule: 0 (n), 1 (c), 2 (h) or 3 (w)");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn band_of_channels_is_one_range_for_each_sample() {
        let ranges: Vec<_> = band(Shape::new(2, 5, 2, 3), 1, 1, 2).collect();
        assert_eq!(ranges, [6..18, 36..48]);
    }
}

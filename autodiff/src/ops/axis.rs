//! Lines along one axis: folds over each line, and loops that combine the entries of a line with numbers of that line.
//!
//! Seen along an axis, a row-major buffer has `outer` blocks of `len` runs of `inner` adjacent entries. A line is one of the
//! `outer * inner` sequences of `len` entries along the axis; lines are numbered in row-major order of the other axes. Each line
//! is folded from its first entry to its last by one thread, so the bits do not depend on the number of threads.

use crate::{Scalar, Shape, par};

/// Lines that one task should fold at least, where they lie side by side.
const SIDE_BY_SIDE: usize = 64;

/// The lines of a shape along one axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lines {
    /// Blocks: all indices of the axes before.
    pub(crate) outer: usize,
    /// Entries of a line.
    pub(crate) len: usize,
    /// Distance of neighbours in a line: all indices of the axes after.
    pub(crate) inner: usize,
}

impl Lines {
    /// The lines of `shape` along `axis`.
    pub(crate) fn along(shape: Shape, axis: usize) -> Self {
        let (before, after) = (&shape.0[..axis], &shape.0[axis + 1..]);
        Lines { outer: before.iter().product(), len: shape.0[axis], inner: after.iter().product() }
    }

    /// Number of lines.
    pub(crate) fn count(self) -> usize {
        self.outer * self.inner
    }

    /// Elements of one block.
    pub(crate) fn block(self) -> usize {
        self.len * self.inner
    }

    /// `totals[line] = step(totals[line], k, operands[line, k])` for every line and `k` in `0..len`, in this order.
    pub(crate) fn fold<T: Scalar, A: Copy + Send, const K: usize>(
        self,
        totals: &mut [A],
        operands: [&[T]; K],
        step: impl Fn(A, usize, [T; K]) -> A + Sync + Send,
    ) {
        let chunk_len = (par::CHUNK / self.len.max(1)).max(SIDE_BY_SIDE.min(self.inner)).max(1);
        par::for_each_chunk(totals, chunk_len, |chunk, mut totals| {
            let mut line = chunk * chunk_len;
            while !totals.is_empty() {
                let (block, first) = (line / self.inner, line % self.inner);
                let (run, rest) = totals.split_at_mut((self.inner - first).min(totals.len()));
                line += run.len();
                self.fold_run(run, block * self.block() + first, operands, &step);
                totals = rest;
            }
        });
    }

    /// Folds adjacent lines of one block; the first entry of the first line is at `start`.
    #[inline(always)]
    fn fold_run<T: Scalar, A: Copy, const K: usize>(
        self,
        totals: &mut [A],
        start: usize,
        operands: [&[T]; K],
        step: &impl Fn(A, usize, [T; K]) -> A,
    ) {
        if let [total] = totals {
            let entries = |k| operands.map(|x| x[start + k * self.inner]);
            *total = (0..self.len).fold(*total, |total, k| step(total, k, entries(k)));
            return;
        }
        for k in 0..self.len {
            let rows = operands.map(|x| &x[start + k * self.inner..][..totals.len()]);
            for (j, total) in totals.iter_mut().enumerate() {
                *total = step(*total, k, rows.map(|row| row[j]));
            }
        }
    }

    /// The sum of `term(operands)` over every line.
    pub(crate) fn sums<T: Scalar, const K: usize>(
        self,
        operands: [&[T]; K],
        term: impl Fn([T; K]) -> f64 + Sync + Send,
    ) -> Vec<f64> {
        let mut totals = vec![0.0; self.count()];
        self.fold(&mut totals, operands, |total, _, entries| total + term(entries));
        totals
    }

    /// `out[line, k] = f(k, out[line, k], operands[line, k], numbers[line])` for every entry.
    pub(crate) fn update<T: Scalar, const K: usize, const L: usize>(
        self,
        out: &mut [T],
        operands: [&[T]; K],
        numbers: [&[T]; L],
        f: impl Fn(usize, T, [T; K], [T; L]) -> T + Sync + Send,
    ) {
        let run = if self.inner == 1 { self.len } else { self.inner };
        let runs = (par::CHUNK / run).max(1);
        par::for_each_chunk(out, runs * run, |chunk, out| {
            for (i, out) in out.chunks_exact_mut(run).enumerate() {
                let at = chunk * runs + i;
                let operands = operands.map(|x| &x[at * run..][..run]);
                if self.inner == 1 {
                    let numbers = numbers.map(|x| x[at]);
                    for (k, o) in out.iter_mut().enumerate() {
                        *o = f(k, *o, operands.map(|x| x[k]), numbers);
                    }
                } else {
                    let (block, k) = (at / self.len, at % self.len);
                    let numbers = numbers.map(|x| &x[block * run..][..run]);
                    for (j, o) in out.iter_mut().enumerate() {
                        *o = f(k, *o, operands.map(|x| x[j]), numbers.map(|x| x[j]));
                    }
                }
            }
        });
    }
}

/// `f` of every number, rounded to the scalar type.
pub(crate) fn rounded<A, T: Scalar>(numbers: &[A], f: impl Fn(&A) -> f64) -> Vec<T> {
    numbers.iter().map(|number| T::from_f64(f(number))).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Tensor;
    use crate::ops::testing::{self, random};

    /// Writes every entry as a sum of digits that tells the line, the position, the old entry and the operand.
    fn described(shape: Shape, axis: usize) -> Vec<f64> {
        let lines = Lines::along(shape, axis);
        let numbers: Vec<f64> = (0..lines.count()).map(|line| 1000.0 * line as f64).collect();
        let operand: Vec<f64> = (0..shape.len()).map(|i| i as f64 / 1000.0).collect();
        let mut out = vec![0.5; shape.len()];
        lines.update(&mut out, [&operand], [&numbers], |k, old, [x], [number]| number + k as f64 + old + x);
        out
    }

    #[test]
    fn lines_of_every_axis_are_numbered_in_row_major_order() {
        let shape = Shape::new(2, 3, 4, 5);
        for axis in 0..4 {
            let others = shape.with_axis(axis, 1);
            let want = Tensor::from_fn(shape, |n, c, h, w| {
                let mut at = [n, c, h, w];
                let k = std::mem::take(&mut at[axis]);
                let line = others.index(at[0], at[1], at[2], at[3]);
                1000.0 * line as f64 + k as f64 + 0.5 + shape.index(n, c, h, w) as f64 / 1000.0
            });
            assert_eq!(described(shape, axis), want.to_vec(), "axis {axis}");
        }
    }

    #[test]
    fn a_fold_visits_the_entries_of_a_line_in_order() {
        let x: Vec<f64> = (0..24).map(f64::from).collect();
        let lines = Lines::along(Shape::new(2, 3, 1, 4), 1);
        let mut totals = vec![0.0; 8];
        lines.fold(&mut totals, [&x], |total, k, [x]| 100.0 * total + x + k as f64);
        assert_eq!(totals[..2], [510.0, 10611.0]);
        assert_eq!(totals[4..6], [121722.0, 131823.0]);
    }

    #[test]
    fn long_lines_and_many_lines_are_cut_into_tasks_without_loss() {
        for shape in [Shape::new(3, 1, 1, 40_000), Shape::new(2, 40_000, 1, 3), Shape::new(2, 3, 170, 200)] {
            for axis in 0..4 {
                let lines = Lines::along(shape, axis);
                let ones = vec![1.0_f64; shape.len()];
                let sums = lines.sums([&ones], |[x]| x);
                assert_eq!(sums, vec![lines.len as f64; lines.count()], "{shape} axis {axis}");
                let mut out = ones.clone();
                lines.update(&mut out, [], [&sums], |_, old, [], [sum]| old + sum);
                assert!(out.iter().all(|&x| x == 1.0 + lines.len as f64), "{shape} axis {axis}");
            }
        }
    }

    #[test]
    fn nothing_is_done_without_entries() {
        let lines = Lines::along(Shape::new(2, 0, 1, 3), 1);
        assert_eq!(lines.sums::<f64, 1>([&[]], |[x]| x), [0.0; 6]);
        lines.update::<f64, 0, 0>(&mut [], [], [], |_, old, _, _| old);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn sums_equal_the_sums_over_the_axis(shape in testing::shapes(), axis in 0..4usize, seed in any::<u64>()) {
            let tape = crate::Tape::<f64>::new();
            let x = tape.constant(random(seed, shape, -1.0, 1.0));
            let sums = Lines::along(shape, axis).sums([x.value().data()], |[x]| x);
            testing::close(&sums, x.sum_to(shape.with_axis(axis, 1)).value().data());
        }
    }
}

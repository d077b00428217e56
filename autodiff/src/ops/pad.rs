//! The frame of the paddings: how many rows and columns each side gets, which element stands in for one outside the plane, and
//! the recording.

use super::planes::{add_row, for_each_plane};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Shape, Var};

/// Rows and columns added on each side of every plane.
///
/// A number stands for the same amount on all four sides: `x.pad_reflect(1)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// Rows above.
    pub top: usize,
    /// Rows below.
    pub bottom: usize,
    /// Columns on the left.
    pub left: usize,
    /// Columns on the right.
    pub right: usize,
}

impl From<usize> for Sides {
    fn from(all: usize) -> Self {
        Sides { top: all, bottom: all, left: all, right: all }
    }
}

impl Sides {
    /// The shape after padding.
    pub(crate) fn around(self, shape: Shape) -> Shape {
        shape.with_plane(shape.h() + self.top + self.bottom, shape.w() + self.left + self.right)
    }

    /// The largest amount over and under the plane, and beside it.
    pub(crate) fn largest(self) -> (usize, usize) {
        (self.top.max(self.bottom), self.left.max(self.right))
    }
}

/// Which element stands in for one that lies outside the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Edge {
    /// Mirror about the edge element, which is not repeated.
    Reflect,
    /// Repeat the edge element.
    Replicate,
}

impl Edge {
    /// Element of `0..size` that padded position `i` reads, where `before` positions precede the plane.
    #[inline(always)]
    pub(crate) fn source(self, i: usize, before: usize, size: usize) -> usize {
        let inside = i.wrapping_sub(before);
        match self {
            _ if i >= before && inside < size => inside,
            Edge::Reflect if i < before => before - i,
            Edge::Reflect => 2 * (size - 1) - inside,
            Edge::Replicate if i < before => 0,
            Edge::Replicate => size - 1,
        }
    }
}

/// Fills the cells at both ends of a row whose middle is already in place.
#[inline(always)]
pub(crate) fn fill_ends<T: Scalar>(row: &mut [T], [before, after]: [usize; 2], edge: Edge) {
    let width = row.len() - before - after;
    for i in (0..before).chain(before + width..row.len()) {
        row[i] = row[before + edge.source(i, before, width)];
    }
}

/// Transpose of [`fill_ends`]: adds the end cells onto the middle cells that they were copied from.
#[inline(always)]
pub(crate) fn fold_ends<T: Scalar>(row: &mut [T], [before, after]: [usize; 2], edge: Edge) {
    let width = row.len() - before - after;
    for i in (0..before).chain(before + width..row.len()) {
        let end = row[i];
        row[before + edge.source(i, before, width)] += end;
    }
}

fn forward_plane<T: Scalar>(x: &[T], y: &mut [T], width: usize, sides: Sides, edge: Edge) {
    let height = x.len() / width;
    for (i, row) in y.chunks_exact_mut(sides.left + width + sides.right).enumerate() {
        let source = edge.source(i, sides.top, height) * width;
        row[sides.left..][..width].copy_from_slice(&x[source..source + width]);
        fill_ends(row, [sides.left, sides.right], edge);
    }
}

fn backward_plane<T: Scalar>(g: &[T], gx: &mut [T], width: usize, sides: Sides, edge: Edge) {
    let height = gx.len() / width;
    let padded = sides.left + width + sides.right;
    gx.fill(T::ZERO);
    let mut folded = vec![T::ZERO; padded];
    for (i, row) in g.chunks_exact(padded).enumerate() {
        folded.copy_from_slice(row);
        fold_ends(&mut folded, [sides.left, sides.right], edge);
        let target = edge.source(i, sides.top, height) * width;
        add_row(&mut gx[target..target + width], &folded[sides.left..][..width]);
    }
}

/// Records a padding that copies elements of the plane to its outside.
pub(crate) fn record_edge<'t, T: Scalar>(op: &'static str, x: Var<'t, T>, sides: Sides, edge: Edge) -> Var<'t, T> {
    let width = x.shape().w();
    record(
        op,
        x,
        sides,
        move |x, y| forward_plane(x, y, width, sides, edge),
        move |g, gx| backward_plane(g, gx, width, sides, edge),
    )
}

/// Records a padding from its kernels over one plane, `forward(x, y)` and `backward(g, gx)`, which write every element.
pub(crate) fn record<'t, T: Scalar>(
    op: &'static str,
    x: Var<'t, T>,
    sides: Sides,
    forward: impl Fn(&[T], &mut [T]) + Sync + Send,
    backward: impl Fn(&[T], &mut [T]) + Sync + Send + 'static,
) -> Var<'t, T> {
    let shape = sides.around(x.shape());
    let (plane, padded) = (x.shape().plane(), shape.plane());
    let value = x.value();
    let mut y = x.tape().scratch(shape.len());
    for_each_plane(&mut y, padded, |i, y| forward(&value.data()[i * plane..][..plane], y));
    let y = x.tape().tensor(shape, y);
    x.tape().push(op, y, &[x], move |g, grads| {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|gx| {
                for_each_plane(gx, plane, |i, gx| backward(&g.data()[i * padded..][..padded], gx));
            });
        }
    })
}

/// Twin of the three paddings; no edge means zeros.
#[derive(Clone, Copy, Debug)]
struct Padding {
    edge: Option<Edge>,
    sides: Sides,
}

impl Twin for Padding {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        match self.edge {
            None => v[0].pad_zero(self.sides),
            Some(Edge::Reflect) => v[0].pad_reflect(self.sides),
            Some(Edge::Replicate) => v[0].pad_replicate(self.sides),
        }
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let Sides { top, bottom, left, right } = self.sides;
        let [n, c, height, width] = x[0].shape.0;
        let place = |i: usize, before: usize, size: usize| {
            let (i, last) = (i as isize - before as isize, size as isize - 1);
            match self.edge {
                None => i,
                Some(Edge::Replicate) => i.clamp(0, last),
                Some(Edge::Reflect) if i > last => 2 * last - i,
                Some(Edge::Reflect) => i.abs(),
            }
        };
        Plain::from_fn(Shape::new(n, c, height + top + bottom, width + left + right), |[n, c, h, w]| {
            x[0].or_zero(n, c, place(h, top, height), place(w, left, width))
        })
    }
}

/// The proof of a padding, with amounts that the rule allows.
pub(crate) fn proof_of(op: &'static str, edge: Option<Edge>) -> Proof {
    let mut draw = Draw::new(op);
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().chain([Shape::new(1, 2, 2, 3), Shape::new(2, 1, 4, 2)]).enumerate() {
        let most = |size: usize| if edge == Some(Edge::Reflect) { size - 1 } else { size + 2 };
        let (rows, columns) = (most(shape.h()).min(4), most(shape.w()).min(4));
        let mut side = |most| draw.size(0, most);
        let sides = match i {
            5 => Sides { top: rows, bottom: rows, left: columns, right: columns },
            _ => Sides { top: side(rows), bottom: side(rows), left: side(columns), right: side(columns) },
        };
        cases.push(Case::new(Padding { edge, sides }, [draw.uniform(shape, -1.0, 1.0)]));
    }
    Proof::new(op, cases)
}

/// Helpers of the tests of the paddings.
#[cfg(test)]
pub(crate) mod testing {
    use proptest::prelude::*;

    use super::Sides;

    /// Amounts of `0..limit` for each side.
    pub(crate) fn sides(limit: usize) -> impl Strategy<Value = Sides> {
        let amount = || 0..limit;
        (amount(), amount(), amount(), amount()).prop_map(|(top, bottom, left, right)| Sides { top, bottom, left, right })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_means_all_four_sides() {
        let sides = Sides::from(2);
        assert_eq!(sides, Sides { top: 2, bottom: 2, left: 2, right: 2 });
        assert_eq!(sides.around(Shape::new(1, 3, 4, 5)), Shape::new(1, 3, 8, 9));
        assert_eq!(Sides { top: 1, left: 4, ..Sides::default() }.largest(), (1, 4));
    }

    #[test]
    fn positions_outside_read_the_edge_or_its_mirror_image() {
        let sources = |edge: Edge| (0..7).map(|i| edge.source(i, 2, 3)).collect::<Vec<_>>();
        assert_eq!(sources(Edge::Reflect), [2, 1, 0, 1, 2, 1, 0]);
        assert_eq!(sources(Edge::Replicate), [0, 0, 0, 1, 2, 2, 2]);
    }

    #[test]
    fn ends_are_filled_and_folded_back() {
        let mut row = [0.0, 0.0, 1.0, 2.0, 3.0, 0.0];
        fill_ends(&mut row, [2, 1], Edge::Reflect);
        assert_eq!(row, [3.0, 2.0, 1.0, 2.0, 3.0, 2.0]);
        fold_ends(&mut row, [2, 1], Edge::Reflect);
        assert_eq!(row[2..5], [1.0, 6.0, 6.0]);
    }
}

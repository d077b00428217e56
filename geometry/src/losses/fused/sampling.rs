//! Reading the source depth where the flow ends, and sending gradients back there.
//!
//! As [`bilinear_sample`](dimode_autodiff::Var::bilinear_sample) with the border held. Pixels that leave the view read the first
//! cell of their own row, which nobody uses.

use dimode_autodiff::simd::{Simd, Wide};
use dimode_autodiff::{Scalar, Shape};

use super::rows::{Rows, add, load2, load4, read, splat, write};

/// Size of a map and the distances to the right and lower neighbour, 0 along an axis of one pixel.
#[derive(Clone, Copy)]
pub(super) struct Grid {
    pub height: usize,
    pub width: usize,
    right: usize,
    below: usize,
}

impl Grid {
    pub(super) fn new(map: Shape) -> Self {
        let (height, width) = (map.h(), map.w());
        Self { height, width, right: usize::from(width > 1), below: if height > 1 { width } else { 0 } }
    }

    /// Whether numbers of the type can count the pixels of a map.
    pub(super) fn counts<T: Scalar>(map: Shape) -> bool {
        (map.plane() as f64) < 1.0 / T::EPSILON.to_f64()
    }

    /// Finds the cells of a segment and how many of its pixels end in view; returns the first and last cell.
    #[inline(always)]
    pub(super) fn find<S: Simd, T: Scalar>(&self, simd: S, flow: [&[T]; 2], rows: &mut Rows<'_, T>) -> [usize; 2] {
        let last: [Wide<S, T>; 2] = [splat(simd, self.width as f64 - 1.0), splat(simd, self.height as f64 - 1.0)];
        let last_cell = [splat(simd, (self.width - 1 - self.right) as f64), splat(simd, self.last_row() as f64)];
        let (zero, v): (Wide<S, T>, _) = (splat(simd, 0.0), splat(simd, rows.row as f64));
        // Adding and taking it away leaves the nearest whole number.
        let (whole, one, width) = (splat(simd, 1.0 / T::EPSILON.to_f64()), splat(simd, 1.0), splat(simd, self.width as f64));
        let own = splat(simd, (rows.row.min(self.last_row()) * self.width) as f64);
        let (mut low, mut high) = (own + whole, own + whole);
        for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
            let x = Wide::load(simd, &rows.column[at..]) + read(simd, flow[0], at);
            let y = v + read(simd, flow[1], at);
            let inside = zero.at_most(x) & x.at_most(last[0]) & zero.at_most(y) & y.at_most(last[1]);
            let (x, y) = (inside.choose(x, zero), inside.choose(y, zero));
            let (near_x, near_y) = ((x + whole) - whole, (y + whole) - whole);
            let floor_x = x.less(near_x).choose(near_x - one, near_x).min(last_cell[0]);
            let floor_y = y.less(near_y).choose(near_y - one, near_y).min(last_cell[1]);
            let cell = inside.choose(floor_y * width + floor_x, own) + whole;
            (low, high) = (low.min(cell), high.max(cell));
            cell.store(&mut rows.cell[at..]);
            // A weight of 0 marks what is out of view.
            inside.choose(x - floor_x, -one).store(&mut rows.part[0][at..]);
            (y - floor_y).store(&mut rows.part[1][at..]);
        }
        let mut ends = [T::ZERO; 2 * LANES];
        let lanes = Wide::<S, T>::lanes();
        low.store(&mut ends);
        high.store(&mut ends[LANES..]);
        let low = ends[..lanes].iter().map(|x| x.low_bits()).min();
        let high = ends[LANES..LANES + lanes].iter().map(|x| x.low_bits()).max();
        [low.expect("a register has lanes"), high.expect("a register has lanes")]
    }

    /// Row of the last cells.
    fn last_row(&self) -> usize {
        self.height - 1 - usize::from(self.below > 0)
    }

    /// Rows of the map that a range of cells covers.
    pub(super) fn rows_of(&self, [first, last]: [usize; 2]) -> [usize; 2] {
        [first / self.width, last / self.width + 1 + usize::from(self.below > 0)]
    }

    /// Reads the corners of the cells.
    #[inline(always)]
    pub(super) fn gather<T: Scalar>(&self, map: &[T], len: usize, rows: &mut Rows<'_, T>) {
        let [a, b, c, d] = rows.corners.each_mut().map(|row| &mut row[..len]);
        let cells = &rows.cell[..len];
        let (right, below) = (self.right, self.below);
        for j in 0..len {
            let base = cells[j].low_bits();
            let cell = &map[base..base + below + right + 1];
            a[j] = cell[0];
            b[j] = cell[right];
            c[j] = cell[below];
            d[j] = cell[below + right];
        }
    }

    /// Mixes the corners.
    #[inline(always)]
    pub(super) fn blend<S: Simd, T: Scalar>(&self, simd: S, rows: &Rows<'_, T>, out: &mut [T]) {
        let one = Wide::splat(simd, T::ONE);
        for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
            let [a, b] = load2(simd, &rows.part, at);
            let [p, q, r, s] = load4(simd, &rows.corners, at);
            let (c, d) = (one - a, one - b);
            let upper = (c * d).mul_add(p, a * d * q);
            let lower = (c * b).mul_add(r, a * b * s);
            write(out, at, upper + lower);
        }
    }

    /// Adds the gradients of a segment's readings to the map, with the weights of the corners.
    #[inline(always)]
    pub(super) fn scatter<T: Scalar>(&self, len: usize, rows: &Rows<'_, T>, map: &mut [T]) {
        let (cells, gradients) = (&rows.cell[..len], &rows.to_source_depth[..len]);
        let [along_u, along_v] = rows.part.each_ref().map(|row| &row[..len]);
        let (right, below) = (self.right, self.below);
        for j in 0..len {
            let base = cells[j].low_bits();
            let cell = &mut map[base..base + below + right + 1];
            let lower = gradients[j] * along_v[j];
            let upper = gradients[j] - lower;
            let (lower_right, upper_right) = (lower * along_u[j], upper * along_u[j]);
            cell[0] += upper - upper_right;
            cell[right] += upper_right;
            cell[below] += lower - lower_right;
            cell[below + right] += lower_right;
        }
    }

    /// Adds to the gradient of the flow what it has by moving the reading; 0 on the first and last line of pixels.
    #[inline(always)]
    pub(super) fn slopes<S: Simd, T: Scalar>(&self, simd: S, flow: [&[T]; 2], rows: &mut Rows<'_, T>) {
        let last: [Wide<S, T>; 2] = [splat(simd, self.width as f64 - 1.0), splat(simd, self.height as f64 - 1.0)];
        let (zero, one, v) = (splat(simd, 0.0), splat(simd, 1.0), splat(simd, rows.row as f64));
        for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
            let g = Wide::load(simd, &rows.to_source_depth[at..]);
            let used = zero.less(g.abs());
            let [a, b] = load2(simd, &rows.part, at);
            let [p, q, r, s] = load4(simd, &rows.corners, at);
            let x = Wide::load(simd, &rows.column[at..]) + read(simd, flow[0], at);
            let y = v + read(simd, flow[1], at);
            let along_u = (one - b) * (q - p) + b * (s - r);
            let along_v = (one - a) * (r - p) + a * (s - q);
            let moves_u = used & zero.less(x) & x.less(last[0]);
            let moves_v = used & zero.less(y) & y.less(last[1]);
            add(simd, rows.to_flow[0], at, moves_u.choose(g * along_u, zero));
            add(simd, rows.to_flow[1], at, moves_v.choose(g * along_v, zero));
        }
    }
}

/// Most lanes of a register.
const LANES: usize = 16;

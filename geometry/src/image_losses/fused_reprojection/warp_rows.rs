//! One row of a source, read where depth and motion put the pixels of the target.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::Wide;
use pulp::Simd;

use super::super::photometric::SHIFT;
use super::super::rows::{CHUNK, PAD, get, number};
use super::{CHANNELS, PIXEL};
use crate::taped::MIN_DEPTH;
use crate::taped::bands::Motion;

/// What a warped row is made of.
pub(super) struct WarpRow<'a, T> {
    pub motion: &'a Motion<T>,
    /// Numbers and viewing rays of the columns, up to a whole chunk.
    pub columns: &'a [T],
    pub rays: &'a [T],
    pub row: usize,
    pub height: usize,
    pub width: usize,
    pub depth: &'a [T],
    pub image: &'a [[T; PIXEL]],
}

/// Scratch rows of a warped row.
pub(super) struct WarpedRow<'a, T> {
    /// Shifted colours and their slopes by u and v, channel by channel.
    pub colours: [&'a mut [T]; CHANNELS],
    pub by_u: [&'a mut [T]; CHANNELS],
    pub by_v: [&'a mut [T]; CHANNELS],
    pub motion: MotionRow<&'a mut [T]>,
}

/// How the coordinates of a row depend on depth and motion; all 0 where a coordinate is not free to move: beyond the border, behind
/// the source, not a number, or behind the end of the row.
pub(super) struct MotionRow<R> {
    /// Focal length divided by the depth in the source, of u and v.
    pub reach: [R; 2],
    /// Flow divided by the focal length.
    pub flow: [R; 2],
}

/// Coordinates of a chunk, first as such, then as parts of a cell.
struct Chunk<T> {
    u: [T; CHUNK],
    v: [T; CHUNK],
    cell: [u32; CHUNK],
}

/// Colours of a chunk and their slopes by u and v, pixel by pixel.
struct Tile<T> {
    colours: [[T; PIXEL]; CHUNK],
    by_u: [[T; PIXEL]; CHUNK],
    by_v: [[T; PIXEL]; CHUNK],
}

impl<T: Scalar> WarpRow<'_, T> {
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, out: &mut WarpedRow<'_, T>) {
        let mut chunk = Chunk { u: [T::ZERO; CHUNK], v: [T::ZERO; CHUNK], cell: [0; CHUNK] };
        let pixels = [[T::ZERO; PIXEL]; CHUNK];
        let mut tile = Tile { colours: pixels, by_u: pixels, by_v: pixels };
        for start in (0..self.width).step_by(CHUNK) {
            for j in (0..CHUNK).step_by(Wide::<S, T>::lanes()) {
                self.coordinates(simd, start, j, &mut chunk, &mut out.motion);
            }
            self.cells(&mut chunk);
            self.read(&chunk, &mut tile);
            for c in 0..CHANNELS {
                unpack(&tile.colours, c, &mut out.colours[c][PAD + start..]);
                unpack(&tile.by_u, c, &mut out.by_u[c][PAD + start..]);
                unpack(&tile.by_v, c, &mut out.by_v[c][PAD + start..]);
            }
        }
    }

    /// Coordinates of a register, held at the border.
    #[inline(always)]
    fn coordinates<S: Simd>(&self, simd: S, start: usize, j: usize, chunk: &mut Chunk<T>, out: &mut MotionRow<&mut [T]>) {
        let m = self.motion;
        let (zero, one) = (number(simd, 0.0), number(simd, 1.0));
        let at = start + j;
        let (column, x) = (Wide::load(simd, &self.columns[at..]), Wide::load(simd, &self.rays[at..]));
        let y = m.ray_row(self.row);
        let z = get(simd, self.depth, at);
        let [e0, e1, e2] = [turn(simd, m, 0, x, y), turn(simd, m, 1, x, y), turn(simd, m, 2, x, y)];
        let [tx, ty, tz] = [Wide::splat(simd, m.t[0]), Wide::splat(simd, m.t[1]), Wide::splat(simd, m.t[2])];
        let y = Wide::splat(simd, y);
        let depth = z.mul_add(one + e2, tz);
        let before = depth.greater(number(simd, MIN_DEPTH));
        let inverse = before.choose(one / before.choose(depth, one), zero);
        let p = (z * (e0 - x * e2) + (tx - x * tz)) * inverse;
        let q = (z * (e1 - y * e2) + (ty - y * tz)) * inverse;
        let (fu, fv) = (Wide::splat(simd, m.fu), Wide::splat(simd, m.fv));
        let (u, v) = (fu.mul_add(p, column), fv.mul_add(q, number(simd, self.row as f64)));
        let (right, bottom) = (number(simd, (self.width - 1) as f64), number(simd, (self.height - 1) as f64));
        // Only a NaN is neither below 1 nor above 0. It must show in the colours.
        let good = (u.less(one) | u.greater(zero)) & (v.less(one) | v.greater(zero));
        let nan = number(simd, f64::NAN);
        good.choose(u.max(zero).min(right), nan).store(&mut chunk.u[j..]);
        good.choose(v.max(zero).min(bottom), nan).store(&mut chunk.v[j..]);
        let movable = good & before & column.less(number(simd, self.width as f64));
        let free_u = movable & u.greater(zero) & u.less(right);
        let free_v = movable & v.greater(zero) & v.less(bottom);
        free_u.choose(fu * inverse, zero).store(&mut out.reach[0][PAD + at..]);
        free_v.choose(fv * inverse, zero).store(&mut out.reach[1][PAD + at..]);
        free_u.choose(p, zero).store(&mut out.flow[0][PAD + at..]);
        free_v.choose(q, zero).store(&mut out.flow[1][PAD + at..]);
    }

    /// Splits coordinates into the first pixel of their cell and the parts beyond it.
    #[inline(always)]
    fn cells(&self, chunk: &mut Chunk<T>) {
        // The last pixel belongs to the cell before it.
        let (right, bottom) = (self.width as i32 - 2, self.height as i32 - 2);
        for ((u, v), cell) in chunk.u.iter_mut().zip(&mut chunk.v).zip(&mut chunk.cell) {
            let (i, j) = ((u.to_f64() as i32).min(right), (v.to_f64() as i32).min(bottom));
            *u = *u - T::from_f64(f64::from(i));
            *v = *v - T::from_f64(f64::from(j));
            *cell = (j * self.width as i32 + i) as u32;
        }
    }

    /// Blends the four pixels of each cell; all colours of a pixel at once.
    #[inline(always)]
    fn read(&self, chunk: &Chunk<T>, tile: &mut Tile<T>) {
        let shift = T::from_f64(SHIFT);
        for k in 0..CHUNK {
            let (cell, a, b) = (chunk.cell[k] as usize, chunk.u[k], chunk.v[k]);
            let (left, above) = (T::ONE - a, T::ONE - b);
            let [p, q] = [self.image[cell], self.image[cell + 1]];
            let [r, s] = [self.image[cell + self.width], self.image[cell + self.width + 1]];
            for c in 0..PIXEL {
                let (up, down) = (left * p[c] + a * q[c], left * r[c] + a * s[c]);
                tile.colours[k][c] = (above * up + b * down) - shift;
                tile.by_u[k][c] = above * (q[c] - p[c]) + b * (s[c] - r[c]);
                tile.by_v[k][c] = down - up;
            }
        }
    }
}

/// Row `i` of `R - I` times the viewing rays `(x, y, 1)`.
#[inline(always)]
pub(super) fn turn<S: Simd, T: Scalar>(simd: S, m: &Motion<T>, i: usize, x: Wide<S, T>, y: T) -> Wide<S, T> {
    Wide::splat(simd, m.e[i][0]).mul_add(x, Wide::splat(simd, m.e[i][1] * y + m.e[i][2]))
}

/// Takes one colour of every pixel.
#[inline(always)]
fn unpack<T: Scalar>(pixels: &[[T; PIXEL]; CHUNK], c: usize, out: &mut [T]) {
    for (out, pixel) in out[..CHUNK].iter_mut().zip(pixels) {
        *out = pixel[c];
    }
}

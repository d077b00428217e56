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
    /// Colours pixel by pixel, and one number beyond.
    pub image: &'a [T],
    pub slots: &'a [u8; CHUNK],
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

/// Coordinates of a chunk, held at the border: the first pixel of their cell and the parts beyond it.
struct Chunk<T> {
    column: [T; CHUNK],
    row: [T; CHUNK],
    u: [T; CHUNK],
    v: [T; CHUNK],
}

/// Colours of a chunk and their slopes by u and v, pixel by pixel, in the order of [`slots`].
struct Tile<T> {
    colours: [[T; PIXEL]; CHUNK],
    by_u: [[T; PIXEL]; CHUNK],
    by_v: [[T; PIXEL]; CHUNK],
}

/// Where a tile has the pixels of a chunk, so that they come apart in order.
#[inline(always)]
pub(super) fn slots<S: Simd, T: Scalar>(simd: S) -> [u8; CHUNK] {
    let lanes = Wide::<S, T>::lanes();
    let groups: [[T; PIXEL]; CHUNK] = std::array::from_fn(|i| [T::from_usize(i); PIXEL]);
    let mut order = [T::ZERO; CHUNK];
    for j in (0..CHUNK).step_by(lanes) {
        Wide::apart(simd, &groups[j..])[0].store(&mut order[j..]);
    }
    order.map(|slot| slot.to_f64() as u8)
}

impl<T: Scalar> WarpRow<'_, T> {
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, out: &mut WarpedRow<'_, T>) {
        let zeros = [T::ZERO; CHUNK];
        let mut chunk = Chunk { column: zeros, row: zeros, u: zeros, v: zeros };
        let pixels = [[T::ZERO; PIXEL]; CHUNK];
        let mut tile = Tile { colours: pixels, by_u: pixels, by_v: pixels };
        for start in (0..self.width).step_by(CHUNK) {
            for j in (0..CHUNK).step_by(Wide::<S, T>::lanes()) {
                self.coordinates(simd, start, j, &mut chunk, &mut out.motion);
            }
            self.read(&chunk, &mut tile);
            for j in (0..CHUNK).step_by(Wide::<S, T>::lanes()) {
                let at = PAD + start + j;
                unpack(simd, &tile.colours[j..], &mut out.colours, at);
                unpack(simd, &tile.by_u[j..], &mut out.by_u, at);
                unpack(simd, &tile.by_v[j..], &mut out.by_v, at);
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
        let (held_u, held_v) = (u.max(zero).min(right), v.max(zero).min(bottom));
        // The last pixel belongs to the cell before it.
        let (cell_u, cell_v) = (floor(held_u).min(right - one), floor(held_v).min(bottom - one));
        cell_u.store(&mut chunk.column[j..]);
        cell_v.store(&mut chunk.row[j..]);
        good.choose(held_u - cell_u, nan).store(&mut chunk.u[j..]);
        good.choose(held_v - cell_v, nan).store(&mut chunk.v[j..]);
        let movable = good & before & column.less(number(simd, self.width as f64));
        let free_u = movable & u.greater(zero) & u.less(right);
        let free_v = movable & v.greater(zero) & v.less(bottom);
        free_u.choose(fu * inverse, zero).store(&mut out.reach[0][PAD + at..]);
        free_v.choose(fv * inverse, zero).store(&mut out.reach[1][PAD + at..]);
        free_u.choose(p, zero).store(&mut out.flow[0][PAD + at..]);
        free_v.choose(q, zero).store(&mut out.flow[1][PAD + at..]);
    }

    /// Blends the four pixels of each cell; all colours of a pixel at once.
    #[inline(always)]
    fn read(&self, chunk: &Chunk<T>, tile: &mut Tile<T>) {
        let mut cells = [0_u32; CHUNK];
        for ((cell, &column), &row) in cells.iter_mut().zip(&chunk.column).zip(&chunk.row) {
            // The low bits of the sum are the number itself; a conversion that minds every case would not become vector code.
            let number = row.to_f64() * self.width as f64 + column.to_f64();
            *cell = (number + WHOLE).to_bits() as u32;
        }
        let shift = T::from_f64(SHIFT);
        #[allow(clippy::needless_range_loop)] // one index over many arrays
        for k in 0..CHUNK {
            let (a, b) = (chunk.u[k], chunk.v[k]);
            let (left, above) = (T::ONE - a, T::ONE - b);
            let pixels = &self.image[CHANNELS * cells[k] as usize..][..CHANNELS * (self.width + 2) + 1];
            let [up, down] = [neighbours(pixels), neighbours(&pixels[CHANNELS * self.width..])];
            let (mut between, mut slope) = ([[T::ZERO; PIXEL]; 2], [[T::ZERO; PIXEL]; 2]);
            for i in 0..2 {
                for c in 0..PIXEL {
                    between[i][c] = b.mul_add(down[i][c], above * up[i][c]);
                    slope[i][c] = down[i][c] - up[i][c];
                }
            }
            let slot = usize::from(self.slots[k]) % CHUNK;
            let (colours, by_u, by_v) = (&mut tile.colours[slot], &mut tile.by_u[slot], &mut tile.by_v[slot]);
            for c in 0..PIXEL {
                colours[c] = a.mul_add(between[1][c], left * between[0][c]) - shift;
                by_u[c] = between[1][c] - between[0][c];
                by_v[c] = a.mul_add(slope[1][c], left * slope[0][c]);
            }
        }
    }
}

/// The first two pixels, each with a colour that is not its own at the end.
#[inline(always)]
fn neighbours<T: Scalar>(pixels: &[T]) -> [[T; PIXEL]; 2] {
    let p: &[T; CHANNELS + PIXEL] = pixels.first_chunk().expect("two pixels and one number");
    [[p[0], p[1], p[2], p[3]], [p[3], p[4], p[5], p[6]]]
}

/// 2^52: from here on numbers of 64 bits are whole.
const WHOLE: f64 = 4_503_599_627_370_496.0;

/// The largest whole numbers not above `x`, which lie between 0 and 2^22.
#[inline(always)]
fn floor<S: Simd, T: Scalar>(x: Wide<S, T>) -> Wide<S, T> {
    // From this number on the spacing is 1.
    let rounding = x.like(T::ONE / T::EPSILON);
    let nearest = (x + rounding) - rounding;
    nearest.greater(x).choose(nearest - x.like(T::ONE), nearest)
}

/// Row `i` of `R - I` times the viewing rays `(x, y, 1)`.
#[inline(always)]
pub(super) fn turn<S: Simd, T: Scalar>(simd: S, m: &Motion<T>, i: usize, x: Wide<S, T>, y: T) -> Wide<S, T> {
    Wide::splat(simd, m.e[i][0]).mul_add(x, Wide::splat(simd, m.e[i][1] * y + m.e[i][2]))
}

/// Takes the colours of a register of pixels apart.
#[inline(always)]
fn unpack<S: Simd, T: Scalar>(simd: S, pixels: &[[T; PIXEL]], out: &mut [&mut [T]; CHANNELS], at: usize) {
    let [red, green, blue, _] = Wide::apart(simd, pixels);
    red.store(&mut out[0][at..]);
    green.store(&mut out[1][at..]);
    blue.store(&mut out[2][at..]);
}

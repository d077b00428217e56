//! The photometric error of rows of two images and its derivative, in registers: what [`photometric`](super::photometric) and
//! [`fused_reprojection`](super::fused_reprojection) share, so that equal colours have equal errors to the last bit in both.
//!
//! With box means `m` of shifted colours `x`, `y`, the factors `a1, a2, b1, b2` of the similarity `S = a1 a2 / (b1 b2)` and
//! `q = 1 / (b1 b2)`:
//! `dS/dm_x = q (2 (m_y + shift) a2 - 2 m_y a1 - S (2 (m_x + shift) b2 - 2 m_x b1))`, `dS/dm_xx = -q S b1`, `dS/dm_xy = 2 q a1`.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::Wide;
use pulp::Simd;

use super::photometric::{ALPHA, C1, C2, SHIFT};
use super::rows::{PAD, mirror, number};

/// Three consecutive rows of a window, mirrored at the border.
pub(super) type Window<'a, T> = [&'a [T]; 3];

/// The rows that the window around row `i` of `height` has above and below it.
#[inline(always)]
pub(super) fn neighbours(i: usize, height: usize) -> [usize; 2] {
    [if i == 0 { 1 } else { i - 1 }, if i + 1 == height { height - 2 } else { i + 1 }]
}

/// How often row `i` of `height` stands above and below the windows of the next and the previous row: 2 where the mirror shows it.
#[inline(always)]
pub(super) fn readings<T: Scalar>(i: usize, height: usize) -> [T; 2] {
    let times = |exists: bool, twice: bool| T::from_usize(usize::from(exists) + usize::from(exists && twice));
    [times(i > 0, i == 1), times(i + 1 < height, i + 2 == height)]
}

/// The registers of three rows.
#[inline(always)]
fn load_window<S: Simd, T: Scalar>(simd: S, rows: &Window<'_, T>, j: usize) -> [Wide<S, T>; 3] {
    [Wide::load(simd, &rows[0][j..]), Wide::load(simd, &rows[1][j..]), Wide::load(simd, &rows[2][j..])]
}

/// Sums of three rows and of their squares, mirrored at both ends.
#[inline(always)]
pub(super) fn add_rows<S: Simd, T: Scalar>(simd: S, y: Window<'_, T>, width: usize, [sum, squares]: [&mut [T]; 2]) {
    for j in (PAD..PAD + width).step_by(Wide::<S, T>::lanes()) {
        let [a, b, c] = load_window(simd, &y, j);
        (a + b + c).store(&mut sum[j..]);
        c.mul_add(c, b.mul_add(b, a * a)).store(&mut squares[j..]);
    }
    mirror(sum, width);
    mirror(squares, width);
}

/// Sums of three rows, of their squares and of their products with the other image, mirrored at both ends.
#[inline(always)]
pub(super) fn add_row_pairs<S: Simd, T: Scalar>(
    simd: S,
    (x, y): (Window<'_, T>, Window<'_, T>),
    width: usize,
    [sum, squares, products]: [&mut [T]; 3],
) {
    for j in (PAD..PAD + width).step_by(Wide::<S, T>::lanes()) {
        let ([a, b, c], [p, q, r]) = (load_window(simd, &x, j), load_window(simd, &y, j));
        (a + b + c).store(&mut sum[j..]);
        c.mul_add(c, b.mul_add(b, a * a)).store(&mut squares[j..]);
        c.mul_add(r, b.mul_add(q, a * p)).store(&mut products[j..]);
    }
    mirror(sum, width);
    mirror(squares, width);
    mirror(products, width);
}

/// The registers from columns `j - 1`, `j` and `j + 1` on. One slice for all of them is one check of its bounds.
#[inline(always)]
fn neighbourhood<S: Simd, T: Scalar>(simd: S, row: &[T], j: usize) -> [Wide<S, T>; 3] {
    let lanes = Wide::<S, T>::lanes();
    let row = &row[j - 1..][..lanes + 2];
    [Wide::load(simd, &row[..lanes]), Wide::load(simd, &row[1..lanes + 1]), Wide::load(simd, &row[2..])]
}

/// Sums over windows of three columns.
#[inline(always)]
fn across<S: Simd, T: Scalar>(simd: S, row: &[T], j: usize) -> Wide<S, T> {
    let [left, middle, right] = neighbourhood(simd, row, j);
    left + middle + right
}

/// Sums of one channel of a row of windows: of x, y, xx, yy, xy.
pub(super) struct Sums<'a, T> {
    pub x: &'a [T],
    pub y: &'a [T],
    pub xx: &'a [T],
    pub yy: &'a [T],
    pub xy: &'a [T],
}

/// The error of one channel of a row, added to `error` unless it is the first one, and the derivatives of the error by the sums
/// of x, by half the sum of xx and by that of xy, if `partial` is given.
///
/// A derivative is 0 where the dissimilarity is clamped or not a number.
#[inline(always)]
pub(super) fn error_row<S: Simd, T: Scalar>(
    simd: S,
    sums: &Sums<'_, T>,
    [x, y]: [&[T]; 2],
    (width, channels, first): (usize, usize, bool),
    error: &mut [T],
    partial: Option<[&mut [T]; 3]>,
) {
    let scale = 1.0 / channels as f64;
    let (zero, one, two, half) = (number(simd, 0.0), number(simd, 1.0), number(simd, 2.0), number(simd, 0.5));
    let (ninth, shift, c1, c2) = (number(simd, 1.0 / 9.0), number(simd, SHIFT), number(simd, C1), number(simd, C2));
    let (dissimilar, absolute) = (number(simd, ALPHA * scale), number(simd, (1.0 - ALPHA) * scale));
    let weight = number(simd, -0.5 * ALPHA * scale / 9.0);
    let mut partial = partial;
    for j in (PAD..PAD + width).step_by(Wide::<S, T>::lanes()) {
        let (mx, my) = (across(simd, sums.x, j) * ninth, across(simd, sums.y, j) * ninth);
        let (mxx, myy) = (across(simd, sums.xx, j) * ninth, across(simd, sums.yy, j) * ninth);
        let mxy = across(simd, sums.xy, j) * ninth;
        let (x_mean, y_mean) = (mx + shift, my + shift);
        let a1 = (two * x_mean).mul_add(y_mean, c1);
        let a2 = two.mul_add(mxy - mx * my, c2);
        let b1 = x_mean.mul_add(x_mean, y_mean.mul_add(y_mean, c1));
        let b2 = (mxx - mx * mx) + (myy - my * my) + c2;
        let q = one / (b1 * b2);
        let s = a1 * a2 * q;
        let d = ((one - s) * half).max(zero).min(one);
        let difference = (Wide::load(simd, &x[j..]) - Wide::load(simd, &y[j..])).abs();
        let e = dissimilar.mul_add(d, absolute * difference);
        let e = if first { e } else { e + Wide::load(simd, &error[j..]) };
        e.store(&mut error[j..]);
        if let Some([by_x, by_xx, by_xy]) = &mut partial {
            let inside = s.less(one) & s.greater(-one);
            let q = q * weight;
            let means = y_mean * a2 - my * a1 - s * (x_mean * b2 - mx * b1);
            inside.choose(two * q * means, zero).store(&mut by_x[j..]);
            inside.choose(-(two * q * s * b1), zero).store(&mut by_xx[j..]);
            inside.choose(two * q * a1, zero).store(&mut by_xy[j..]);
        }
    }
}

/// The transposed sum over windows of three columns of `partial` times `gradient`, mirrored.
///
/// Both rows must be finite one column beyond either end, and `gradient` 0 there.
#[inline(always)]
pub(super) fn spread_row<S: Simd, T: Scalar>(simd: S, [partial, gradient]: [&[T]; 2], width: usize, out: &mut [T]) {
    for j in (PAD..PAD + width).step_by(Wide::<S, T>::lanes()) {
        let ([p0, p1, p2], [g0, g1, g2]) = (neighbourhood(simd, partial, j), neighbourhood(simd, gradient, j));
        p2.mul_add(g2, p1.mul_add(g1, p0 * g0)).store(&mut out[j..]);
    }
    let (first, last) = (PAD, PAD + width - 1);
    out[first + 1] += partial[first] * gradient[first];
    out[last - 1] += partial[last] * gradient[last];
}

/// Three rows of what [`spread_row`] gave, with their weights, and the row of colours between them.
pub(super) struct Colours<'a, T> {
    pub by_x: Window<'a, T>,
    pub by_xx: Window<'a, T>,
    pub by_xy: Window<'a, T>,
    pub x: &'a [T],
    pub y: &'a [T],
}

/// What all channels of a row share: how often the rows above and below are read, and the weight of the absolute difference.
#[derive(Clone, Copy)]
pub(super) struct Weights<S: Simd, T: Scalar> {
    pub above: Wide<S, T>,
    pub below: Wide<S, T>,
    pub absolute: Wide<S, T>,
}

impl<S: Simd, T: Scalar> Weights<S, T> {
    /// Weights of row `i` of `height`.
    #[inline(always)]
    pub fn new(simd: S, i: usize, height: usize, channels: usize) -> Self {
        let [above, below] = readings(i, height).map(|x| Wide::splat(simd, x));
        Self { above, below, absolute: Wide::splat(simd, T::from_f64((1.0 - ALPHA) / channels as f64)) }
    }
}

impl<T: Scalar> Colours<'_, T> {
    /// The gradient of the error by the colours `x` in the register from column `j` on; `gradient` is that of the error there.
    #[inline(always)]
    pub fn gradient<S: Simd>(&self, simd: S, j: usize, weights: Weights<S, T>, gradient: Wide<S, T>) -> Wide<S, T> {
        self.sum(simd, j, self.parts(simd, j, weights), weights.absolute * gradient)
    }

    /// As [`Colours::gradient`], and 0 where no gradient comes from any window, whatever the colours are.
    #[inline(always)]
    pub fn gradient_of_used<S: Simd>(&self, simd: S, j: usize, weights: Weights<S, T>, gradient: Wide<S, T>) -> Wide<S, T> {
        let parts = self.parts(simd, j, weights);
        let zero = gradient.like(T::ZERO);
        let used = parts[0].abs() + parts[1].abs() + parts[2].abs() + gradient.abs();
        // Written so that an incoming NaN passes.
        let unused = used.less(gradient.like(T::ONE)) & !used.greater(zero);
        unused.choose(zero, self.sum(simd, j, parts, weights.absolute * gradient))
    }

    /// Gradients of the windows' means of x, of half of xx and of xy.
    #[inline(always)]
    fn parts<S: Simd>(&self, simd: S, j: usize, weights: Weights<S, T>) -> [Wide<S, T>; 3] {
        [column(simd, &self.by_x, j, weights), column(simd, &self.by_xx, j, weights), column(simd, &self.by_xy, j, weights)]
    }

    #[inline(always)]
    fn sum<S: Simd>(&self, simd: S, j: usize, [a, b, c]: [Wide<S, T>; 3], absolute: Wide<S, T>) -> Wide<S, T> {
        let (x, y) = (Wide::load(simd, &self.x[j..]), Wide::load(simd, &self.y[j..]));
        let signed = x.greater(y).choose(absolute, x.less(y).choose(-absolute, x.like(T::ZERO)));
        c.mul_add(y, b.mul_add(x, a + signed))
    }
}

/// The weighted sum of three rows.
#[inline(always)]
fn column<S: Simd, T: Scalar>(simd: S, rows: &Window<'_, T>, j: usize, weights: Weights<S, T>) -> Wide<S, T> {
    let middle = Wide::load(simd, &rows[1][j..]);
    let above = Wide::load(simd, &rows[0][j..]).mul_add(weights.above, middle);
    Wide::load(simd, &rows[2][j..]).mul_add(weights.below, above)
}

//! Rows of scratch memory with room on both sides, and registers at any column of a row.
//!
//! A scratch row has [`PAD`] elements in front of column 0 and at least as many behind the last one, so that a register may
//! start at any column from -1 on. What stands there is up to the kernels.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::Wide;
use pulp::Simd;

/// Elements in front of column 0: not less than any register has.
pub(super) const PAD: usize = 16;

/// Columns that are worked on together; registers have a divisor of it.
pub(super) const CHUNK: usize = 32;

/// Rows that a ring holds: a window of three.
pub(super) const RING: usize = 3;

/// Rows of a band at most.
const BAND: usize = 32;
/// Rows of a band at least: two rows on either side are computed for its neighbours.
const LEAST_BAND: usize = 12;

/// Rows of a band of an image of `height` rows: the unit of parallel work, independent of the number of threads.
///
/// Bands are even in number, so that two threads share a small image evenly.
pub(super) const fn band_rows(height: usize) -> usize {
    let bands = 2 * height.div_ceil(2 * BAND);
    let rows = height.div_ceil(bands);
    if rows < LEAST_BAND { LEAST_BAND } else { rows }
}

/// Elements of a scratch row.
pub(super) const fn stride(width: usize) -> usize {
    width.next_multiple_of(CHUNK) + 2 * PAD
}

/// Row `index` of a buffer.
#[inline(always)]
pub(super) fn row<T>(buffer: &[T], index: usize, stride: usize) -> &[T] {
    &buffer[index * stride..][..stride]
}

/// Row `index` of a buffer, to be written.
#[inline(always)]
pub(super) fn row_mut<T>(buffer: &mut [T], index: usize, stride: usize) -> &mut [T] {
    &mut buffer[index * stride..][..stride]
}

/// Group `index` of `N` consecutive rows.
#[inline(always)]
pub(super) fn rows_mut<T, const N: usize>(buffer: &mut [T], index: usize, stride: usize) -> [&mut [T]; N] {
    let mut rows = buffer[index * N * stride..][..N * stride].chunks_exact_mut(stride);
    std::array::from_fn(|_| rows.next().expect("N rows"))
}

/// The same number in every lane.
#[inline(always)]
pub(super) fn number<S: Simd, T: Scalar>(simd: S, x: f64) -> Wide<S, T> {
    Wide::splat(simd, T::from_f64(x))
}

/// The register from column `j` of an image row on, zeros behind its end.
#[inline(always)]
pub(super) fn get<S: Simd, T: Scalar>(simd: S, row: &[T], j: usize) -> Wide<S, T> {
    if row.len() >= j + Wide::<S, T>::lanes() {
        Wide::load(simd, &row[j..])
    } else {
        Wide::load_part(simd, &row[j.min(row.len())..])
    }
}

/// Writes the register to an image row from column `j` on, as far as the row goes.
#[inline(always)]
pub(super) fn put<S: Simd, T: Scalar>(value: Wide<S, T>, row: &mut [T], j: usize) {
    let start = j.min(row.len());
    if row.len() >= j + Wide::<S, T>::lanes() {
        value.store(&mut row[j..]);
    } else {
        value.store_part(&mut row[start..]);
    }
}

/// Sets everything in front of column 0 and from column `from` on to 0.
#[inline(always)]
pub(super) fn clear_sides<T: Scalar>(row: &mut [T], from: usize) {
    row[..PAD].fill(T::ZERO);
    row[PAD + from..].fill(T::ZERO);
}

/// Mirrors a row of `width` columns about its first and last one: columns -1 and `width`.
#[inline(always)]
pub(super) fn mirror<T: Scalar>(row: &mut [T], width: usize) {
    row[PAD - 1] = row[PAD + 1];
    row[PAD + width] = row[PAD + width - 2];
}

/// Takes the first `len` elements off a buffer.
#[inline(always)]
pub(super) fn cut<'a, T>(rest: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    rest.split_off_mut(..len).expect("a buffer is as long as its parts")
}

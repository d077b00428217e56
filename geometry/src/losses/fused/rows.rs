//! What the kernels of one row know and where they leave their results.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Wide};

use crate::camera::Intrinsics;
use crate::taped::bands::Motion;

/// Columns that are worked on at a time: all rows of [`Rows`] for as many stay in the first cache.
pub(super) const SEGMENT: usize = 320;

/// Rows of scratch are as long as a whole number of any registers.
const WIDEST: usize = 16;

/// Sums of one loss: weight, number of pixels and what the loss needs beside them.
pub(super) type Sums = [f64; 8];

/// Place of the sum of weights.
pub(super) const WEIGHT: usize = 0;
/// Place of the number of pixels.
pub(super) const COUNT: usize = 1;

/// Camera and motion of one sample, and the limits of its pixels.
pub(super) struct Sample<T> {
    /// `R^T - I`, `a` and focal lengths.
    pub motion: Motion<T>,
    /// Principal point, pixels.
    pub principal_point: [f64; 2],
    /// `1 / f_u`, `1 / f_v`.
    pub inverse_focal: [T; 2],
    /// Smallest depth in front of the camera.
    pub z_min: T,
    /// `noise_pixels`, `noise_share`; `None` when both are 0.
    pub noise: Option<[T; 2]>,
}

impl<T: Scalar> Sample<T> {
    pub(super) fn new(camera: &Intrinsics, rotation: &[T], a: &[T], n: usize, z_min: f64, noise: Option<[f64; 2]>) -> Self {
        let motion = Motion::new(camera, rotation, a, n, true);
        let (fu, fv) = motion.inverse_focal();
        Self {
            motion,
            principal_point: [camera.u0, camera.v0],
            inverse_focal: [fu, fv],
            z_min: T::from_f64(z_min),
            noise: noise.map(|noise| noise.map(T::from_f64)),
        }
    }
}

/// Rows of a segment, one after another in a buffer.
pub(super) struct Rows<'a, T> {
    /// Column of the pixel, pixels.
    pub column: &'a mut [T],
    /// `u - u0`, pixels.
    pub offset: &'a mut [T],
    /// Row of the pixel.
    pub row: usize,
    /// `v - v0`, pixels.
    pub offset_v: T,
    /// Flat index of the upper left pixel of the cell where the flow ends.
    pub cell: &'a mut [T],
    /// Where in the cell the flow ends, both in [0, 1].
    pub part: [&'a mut [T]; 2],
    /// Source depths at the corners of the cell: upper left and right, lower left and right.
    pub corners: [&'a mut [T]; 4],
    /// Weight of the pixel; 0 where it is not usable.
    pub weight: &'a mut [T],
    /// Source depth where the flow ends; 1 where the pixel is not usable.
    pub source_depth: &'a mut [T],
    /// Target depth as it is.
    pub target_depth: &'a mut [T],
    /// Weight of the pixel; 0 too where the target depth is not in front of the camera.
    pub front_weight: &'a mut [T],
    /// `1 / z` of the target; 1 where that weight is 0.
    pub inverse_depth: &'a mut [T],
    /// `1 / z_pla` and `1 / z_axi`; 0 where the pixel is not usable.
    pub inverse: [&'a mut [T]; 2],
    /// Planar flow, pixels; 0 where the pixel is not usable.
    pub planar: [&'a mut [T]; 2],
    /// Axial flow, likewise.
    pub axial: [&'a mut [T]; 2],
    /// What a residual may have by the flow's own error, pixels.
    pub noise: &'a mut [T],
    /// Gradient of the planar flow.
    pub to_planar: [&'a mut [T]; 2],
    /// Gradient of the axial flow.
    pub to_axial: [&'a mut [T]; 2],
    /// Gradient of the target depth.
    pub to_target_depth: &'a mut [T],
    /// Gradient of the noise.
    pub to_noise: &'a mut [T],
    /// Gradient of the source depth where the flow ends.
    pub to_source_depth: &'a mut [T],
    /// Gradient of the flow.
    pub to_flow: [&'a mut [T]; 2],
}

const ROWS: usize = 31;

impl<'a, T: Scalar> Rows<'a, T> {
    /// Length of the buffer for maps of a width.
    pub(super) fn len(width: usize) -> usize {
        ROWS * width.min(SEGMENT).next_multiple_of(WIDEST)
    }

    /// Cuts a buffer of [`Rows::len`] into rows of a segment of `len` columns from `start`.
    pub(super) fn new(buffer: &'a mut [T], start: usize, len: usize, u0: f64) -> Self {
        let mut rows = buffer.chunks_exact_mut(len.next_multiple_of(WIDEST));
        let mut next = || rows.next().expect("a buffer for all rows");
        let (column, offset) = (next(), next());
        for (j, (column, offset)) in column.iter_mut().zip(offset.iter_mut()).enumerate() {
            *column = T::from_usize(start + j);
            *offset = T::from_f64((start + j) as f64 - u0);
        }
        Self {
            column,
            offset,
            row: 0,
            offset_v: T::ZERO,
            cell: next(),
            part: [next(), next()],
            corners: [next(), next(), next(), next()],
            weight: next(),
            source_depth: next(),
            target_depth: next(),
            front_weight: next(),
            inverse_depth: next(),
            inverse: [next(), next()],
            planar: [next(), next()],
            axial: [next(), next()],
            noise: next(),
            to_planar: [next(), next()],
            to_axial: [next(), next()],
            to_target_depth: next(),
            to_noise: next(),
            to_source_depth: next(),
            to_flow: [next(), next()],
        }
    }

    /// Length of every row, a whole number of registers.
    #[inline(always)]
    pub(super) fn padded(&self) -> usize {
        self.column.len()
    }

    /// Goes to a row of the image.
    pub(super) fn enter(&mut self, row: usize, v0: f64) {
        self.row = row;
        self.offset_v = T::from_f64(row as f64 - v0);
    }

    /// Sets all gradients to 0 that kernels add to.
    pub(super) fn clear_gradients(&mut self) {
        for row in self.to_planar.iter_mut().chain(&mut self.to_axial) {
            row.fill(T::ZERO);
        }
        self.to_target_depth.fill(T::ZERO);
        self.to_noise.fill(T::ZERO);
    }
}

/// The same number in every lane.
#[inline(always)]
pub(super) fn splat<S: Simd, T: Scalar>(simd: S, x: f64) -> Wide<S, T> {
    Wide::splat(simd, T::from_f64(x))
}

/// A register of each of two rows.
#[inline(always)]
pub(super) fn load2<S: Simd, T: Scalar>(simd: S, rows: &[&mut [T]; 2], at: usize) -> [Wide<S, T>; 2] {
    [Wide::load(simd, &rows[0][at..]), Wide::load(simd, &rows[1][at..])]
}

/// A register of each of four rows.
#[inline(always)]
pub(super) fn load4<S: Simd, T: Scalar>(simd: S, rows: &[&mut [T]; 4], at: usize) -> [Wide<S, T>; 4] {
    let [a, b, c, d] = rows;
    [Wide::load(simd, &a[at..]), Wide::load(simd, &b[at..]), Wide::load(simd, &c[at..]), Wide::load(simd, &d[at..])]
}

/// Numbers of a map from `at` on, zeros behind its end.
#[inline(always)]
pub(super) fn read<S: Simd, T: Scalar>(simd: S, row: &[T], at: usize) -> Wide<S, T> {
    if at + Wide::<S, T>::lanes() <= row.len() {
        Wide::load(simd, &row[at..])
    } else {
        Wide::load_part(simd, &row[at.min(row.len())..])
    }
}

/// Writes numbers of a map from `at` to its end at most.
#[inline(always)]
pub(super) fn write<S: Simd, T: Scalar>(row: &mut [T], at: usize, x: Wide<S, T>) {
    if at + Wide::<S, T>::lanes() <= row.len() {
        x.store(&mut row[at..]);
    } else {
        let from = at.min(row.len());
        x.store_part(&mut row[from..]);
    }
}

/// Adds to a row of scratch.
#[inline(always)]
pub(super) fn add<S: Simd, T: Scalar>(simd: S, row: &mut [T], at: usize, x: Wide<S, T>) {
    (Wide::load(simd, &row[at..]) + x).store(&mut row[at..]);
}

/// Adds sums over lanes to sums in `f64`.
#[inline(always)]
pub(super) fn add_sums<S: Simd, T: Scalar, const K: usize>(sums: &mut [f64], lanes: [Wide<S, T>; K]) {
    for (sum, lanes) in sums.iter_mut().zip(lanes) {
        *sum += lanes.sum().to_f64();
    }
}

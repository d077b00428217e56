//! Cutting (N,C,H,W) buffers into row bands of fixed size, and sums with a fixed order.

use dimode_autodiff::Scalar;

use crate::camera::Intrinsics;

/// Rows of one band: the unit of parallel work, independent of the number of threads.
pub(crate) const ROWS: usize = 16;
const LANES: usize = 8;

/// Consecutive rows of every channel of one sample.
pub(crate) struct Band<'a, T, const C: usize> {
    pub sample: usize,
    pub first_row: usize,
    pub channels: [&'a mut [T]; C],
}

/// All bands of a buffer, sample by sample from the first row down.
pub(crate) fn bands<T, const C: usize>(data: &mut [T], height: usize, width: usize) -> Vec<Band<'_, T, C>> {
    let mut out = Vec::new();
    for (sample, block) in data.chunks_mut((C * height * width).max(1)).enumerate() {
        let mut planes = block.chunks_mut(height * width);
        let mut rows: [_; C] = std::array::from_fn(|_| {
            let plane = planes.next().expect("a block has C planes");
            plane.chunks_mut(ROWS * width)
        });
        for first_row in (0..height).step_by(ROWS) {
            out.push(Band { sample, first_row, channels: rows.each_mut().map(|r| r.next().expect("planes have equal heights")) });
        }
    }
    out
}

/// Number of bands of one sample.
pub(crate) fn bands_per_sample(height: usize) -> usize {
    height.div_ceil(ROWS)
}

/// Sum of a row in eight lanes, added up in `f64`.
pub(crate) fn sum<T: Scalar>(x: &[T]) -> f64 {
    let mut lanes = [T::ZERO; LANES];
    let (chunks, rest) = x.as_chunks::<LANES>();
    for chunk in chunks {
        for (lane, &x) in lanes.iter_mut().zip(chunk) {
            *lane += x;
        }
    }
    total(lanes) + rest.iter().map(|x| x.to_f64()).sum::<f64>()
}

/// Scalar product of two rows, as [`sum`].
pub(crate) fn dot<T: Scalar>(x: &[T], y: &[T]) -> f64 {
    let mut lanes = [T::ZERO; LANES];
    let ((xs, x_rest), (ys, y_rest)) = (x.as_chunks::<LANES>(), y.as_chunks::<LANES>());
    for (x, y) in xs.iter().zip(ys) {
        for (lane, (&x, &y)) in lanes.iter_mut().zip(x.iter().zip(y)) {
            *lane += x * y;
        }
    }
    let rest = x_rest.iter().zip(y_rest).map(|(x, y)| (*x * *y).to_f64());
    total(lanes) + rest.sum::<f64>()
}

fn total<T: Scalar>(lanes: [T; LANES]) -> f64 {
    lanes.iter().map(|x| x.to_f64()).sum()
}

/// One sample's camera, `R - I` (or `R^T - I`) and translation, in the tape's number type.
#[derive(Clone, Copy)]
pub(crate) struct Motion<T> {
    pub fu: T,
    pub fv: T,
    u0: f64,
    v0: f64,
    inv_fu: f64,
    inv_fv: f64,
    /// Rotation minus identity, row by row.
    pub e: [[T; 3]; 3],
    pub t: [T; 3],
}

impl<T: Scalar> Motion<T> {
    /// Reads sample `n`; `transposed` stores `R^T - I`.
    pub(crate) fn new(camera: &Intrinsics, rotation: &[T], t: &[T], n: usize, transposed: bool) -> Self {
        let r = &rotation[9 * n..9 * n + 9];
        let entry = |i: usize, j: usize| {
            if transposed { r[3 * j + i] } else { r[3 * i + j] }
        };
        let identity = |i: usize, j: usize| if i == j { T::ONE } else { T::ZERO };
        Self {
            fu: T::from_f64(camera.fu),
            fv: T::from_f64(camera.fv),
            u0: camera.u0,
            v0: camera.v0,
            inv_fu: 1.0 / camera.fu,
            inv_fv: 1.0 / camera.fv,
            e: std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j) - identity(i, j))),
            t: [t[3 * n], t[3 * n + 1], t[3 * n + 2]],
        }
    }

    /// Viewing-ray coordinates of the columns of a row.
    pub(crate) fn ray_columns(&self, width: usize) -> Vec<T> {
        (0..width).map(|u| T::from_f64((u as f64 - self.u0) * self.inv_fu)).collect()
    }

    /// Viewing-ray coordinate of a row.
    pub(crate) fn ray_row(&self, v: usize) -> T {
        T::from_f64((v as f64 - self.v0) * self.inv_fv)
    }

    /// `1/f_u`, `1/f_v`.
    pub(crate) fn inverse_focal(&self) -> (T, T) {
        (T::from_f64(self.inv_fu), T::from_f64(self.inv_fv))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_cover_every_element_once_and_keep_the_channels_apart() {
        let (height, width) = (ROWS + 3, 5);
        let mut data = vec![0; 2 * 3 * height * width];
        for (k, band) in bands::<_, 3>(&mut data, height, width).into_iter().enumerate() {
            assert_eq!((band.sample, band.first_row), (k / 2, ROWS * (k % 2)));
            for (c, rows) in band.channels.into_iter().enumerate() {
                rows.iter_mut().for_each(|x| *x += 10 * band.sample + c + 1);
            }
        }
        let plane = height * width;
        for (i, &x) in data.iter().enumerate() {
            assert_eq!(x, 10 * (i / (3 * plane)) + (i / plane) % 3 + 1);
        }
        assert_eq!(bands_per_sample(height), 2);
    }

    #[test]
    fn sums_of_odd_lengths() {
        let x: Vec<f64> = (0..21).map(f64::from).collect();
        assert_eq!(sum(&x), 210.0);
        assert_eq!(dot(&x, &x), 2870.0);
    }
}

//! Matrix products: the only place that names the linear algebra library.
//!
//! Work is cut into units of fixed size that run in parallel; each product runs on one thread, so its bits do not depend on the
//! number of threads.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::par;

/// A matrix in memory: `rows x cols` over a slice.
#[derive(Clone, Copy, Debug)]
pub struct View<'a, T> {
    /// The elements.
    pub data: &'a [T],
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// Whether `data` is read transposed: element `(i, j)` is at `j * rows + i` instead of `i * cols + j`.
    pub transposed: bool,
}

impl<'a, T> View<'a, T> {
    /// A row-major matrix.
    pub fn new(data: &'a [T], rows: usize, cols: usize) -> Self {
        View { data, rows, cols, transposed: false }
    }

    /// The transpose of a row-major `cols x rows` matrix.
    pub fn transpose_of(data: &'a [T], rows: usize, cols: usize) -> Self {
        View { data, rows, cols, transposed: true }
    }

    /// The transpose of this matrix, over the same slice.
    pub fn t(self) -> Self {
        View { rows: self.cols, cols: self.rows, transposed: !self.transposed, ..self }
    }
}

/// Element types with a matrix product.
pub trait GemmScalar: Sized {
    /// `out = a b` or `out += a b`; `out` is row-major `a.rows x b.cols`.
    ///
    /// # Panics
    /// When the inner sizes differ or a slice has the wrong length.
    fn gemm(out: &mut [Self], a: View<'_, Self>, b: View<'_, Self>, add: bool);

    /// `out = a b` in parallel, `columns` columns of `b` and `out` at a time.
    ///
    /// # Panics
    /// When the inner sizes differ or a slice has the wrong length.
    fn gemm_by_columns(out: &mut [Self], a: View<'_, Self>, b: View<'_, Self>, columns: usize);
}

macro_rules! gemm_scalar {
    ($t:ident) => {
        impl GemmScalar for $t {
            #[track_caller]
            fn gemm(out: &mut [Self], a: View<'_, Self>, b: View<'_, Self>, add: bool) {
                assert!(a.cols == b.rows, "gemm: inner sizes differ: [{}, {}] x [{}, {}]", a.rows, a.cols, b.rows, b.cols);
                if a.rows == 0 || b.cols == 0 {
                    return;
                }
                let accum = if add { Accum::Add } else { Accum::Replace };
                let dst = MatMut::from_row_major_slice_mut(out, a.rows, b.cols);
                matmul(dst, accum, mat(a), mat(b), 1.0, Par::Seq);
            }

            #[track_caller]
            fn gemm_by_columns(out: &mut [Self], a: View<'_, Self>, b: View<'_, Self>, columns: usize) {
                assert!(a.cols == b.rows, "gemm: inner sizes differ: [{}, {}] x [{}, {}]", a.rows, a.cols, b.rows, b.cols);
                let mut rest = MatMut::from_row_major_slice_mut(out, a.rows, b.cols);
                let mut tiles = Vec::with_capacity(b.cols.div_ceil(columns));
                while rest.ncols() > columns {
                    let (tile, right) = rest.split_at_col_mut(columns);
                    tiles.push(tile);
                    rest = right;
                }
                tiles.push(rest);
                par::for_each_item(tiles, |i, tile| {
                    let b = mat(b).subcols(i * columns, tile.ncols());
                    matmul(tile, Accum::Replace, mat(a), b, 1.0, Par::Seq);
                });
            }
        }
    };
}

fn mat<T>(view: View<'_, T>) -> MatRef<'_, T> {
    if view.transposed {
        MatRef::from_column_major_slice(view.data, view.rows, view.cols)
    } else {
        MatRef::from_row_major_slice(view.data, view.rows, view.cols)
    }
}

gemm_scalar!(f32);
gemm_scalar!(f64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worked_product_in_every_orientation() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]; // 2 x 3
        let at = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0];
        let b = [1.0, 0.0, -1.0, 2.0, 0.5, 1.0]; // 3 x 2
        let bt = [1.0, -1.0, 0.5, 0.0, 2.0, 1.0];
        let want = [0.5, 7.0, 2.0, 16.0];
        for a in [View::new(&a, 2, 3), View::transpose_of(&at, 2, 3)] {
            for b in [View::new(&b, 3, 2), View::transpose_of(&bt, 3, 2)] {
                let mut out = [0.0_f64; 4];
                f64::gemm(&mut out, a, b, false);
                assert_eq!(out, want);
                f64::gemm(&mut out, a, b, true);
                assert_eq!(out, want.map(|x| 2.0 * x));
                f64::gemm(&mut out, b.t(), a.t(), false);
                assert_eq!(out, [0.5, 2.0, 7.0, 16.0]);
            }
        }
    }

    #[test]
    fn sizes_around_the_block_size_equal_a_plain_loop() {
        for (m, k, n) in [(1, 7, 1), (1, 300, 17), (17, 1, 31), (31, 33, 129), (130, 64, 5), (1, 1000, 1)] {
            let a: Vec<f64> = (0..m * k).map(|i| ((i * 37 % 101) as f64 - 50.0) / 17.0).collect();
            let b: Vec<f64> = (0..k * n).map(|i| ((i * 53 % 97) as f64 - 48.0) / 13.0).collect();
            let mut out = vec![0.0; m * n];
            let mut by_columns = out.clone();
            f64::gemm_by_columns(&mut by_columns, View::new(&a, m, k), View::new(&b, k, n), 16);
            f64::gemm(&mut out, View::new(&a, m, k), View::new(&b, k, n), false);
            for i in 0..m {
                for j in 0..n {
                    let want: f64 = (0..k).map(|l| a[i * k + l] * b[l * n + j]).sum();
                    for found in [out[i * n + j], by_columns[i * n + j]] {
                        assert!((found - want).abs() < 1e-9 * (1.0 + want.abs()), "{m}x{k}x{n} at {i},{j}");
                    }
                }
            }
        }
    }
}

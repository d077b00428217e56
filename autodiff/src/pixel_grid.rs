//! Where the pixels of a map lie.

use crate::{Scalar, Shape, Tape, Tensor, Var};

/// Coordinates of the pixels of a map, `[n, 2, h, w]`: the column in channel 0, the row in channel 1, the first pixel at (0, 0).
///
/// [`bilinear_sample`](crate::Var::bilinear_sample) and [`correlation_lookup`](crate::Var::correlation_lookup) read coordinates
/// of this form. Of `map` only the number of samples and the size of a plane count.
pub fn pixel_grid<T: Scalar>(map: Shape) -> Tensor<T> {
    let mut grid = vec![T::ZERO; map.with_c(2).len()];
    fill(&mut grid, map);
    Tensor::from_vec(map.with_c(2), grid)
}

/// Writes the coordinates of every sample.
fn fill<T: Scalar>(grid: &mut [T], map: Shape) {
    for sample in grid.chunks_exact_mut(2 * map.plane()) {
        let (columns, rows) = sample.split_at_mut(map.plane());
        for (row, (columns, rows)) in columns.chunks_exact_mut(map.w()).zip(rows.chunks_exact_mut(map.w())).enumerate() {
            columns.iter_mut().enumerate().for_each(|(column, c)| *c = T::from_usize(column));
            rows.fill(T::from_usize(row));
        }
    }
}

impl<T: Scalar> Tape<T> {
    /// [`pixel_grid`] as a constant, in a pooled buffer.
    pub fn pixel_grid(&self, map: Shape) -> Var<'_, T> {
        let mut grid = self.scratch(map.with_c(2).len());
        fill(&mut grid, map);
        self.constant(self.tensor(map.with_c(2), grid))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_come_first_and_every_sample_has_the_same() {
        let grid = pixel_grid::<f32>(Shape::new(2, 5, 2, 3));
        let sample = [0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
        assert_eq!(grid.shape(), Shape::new(2, 2, 2, 3));
        assert_eq!(grid.data(), [sample, sample].concat());
        assert_eq!(Tape::new().pixel_grid(Shape::new(2, 5, 2, 3)).value(), grid);
    }
}

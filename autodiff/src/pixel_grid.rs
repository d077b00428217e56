//! Where the pixels of a map lie.

use crate::{Scalar, Shape, Tensor};

/// Coordinates of the pixels of a map, `[n, 2, h, w]`: the column in channel 0, the row in channel 1, the first pixel at (0, 0).
///
/// [`bilinear_sample`](crate::Var::bilinear_sample) and [`correlation_lookup`](crate::Var::correlation_lookup) read coordinates
/// of this form. Of `map` only the number of samples and the size of a plane count.
pub fn pixel_grid<T: Scalar>(map: Shape) -> Tensor<T> {
    Tensor::from_fn(map.with_c(2), |_, c, row, column| T::from_usize(if c == 0 { column } else { row }))
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
    }
}

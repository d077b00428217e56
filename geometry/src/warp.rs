//! Images read at flow-shifted pixels (the unnumbered warp equation), on plain numbers.

use nalgebra::Vector2;

/// One channel of an image, row by row; the centre of the first pixel is `(0, 0)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Image<'a> {
    values: &'a [f64],
    width: usize,
    height: usize,
}

/// The four pixels around a place, upper left and right, lower left and right, and the place within their cell.
struct Cell {
    corners: [f64; 4],
    a: f64,
    b: f64,
}

/// First pixel of the cell of a coordinate along an axis of `size` pixels, the one after it, and the rest; `None` outside.
fn along(x: f64, size: usize) -> Option<(usize, usize, f64)> {
    let last = size - 1;
    // The last pixel belongs to the cell before it.
    let first = (x.floor().max(0.0) as usize).min(last.saturating_sub(1));
    (x >= 0.0 && x <= last as f64).then(|| (first, (first + 1).min(last), x - first as f64))
}

impl<'a> Image<'a> {
    /// An image of rows of `width` values.
    ///
    /// **Panics** when the values do not fill at least one whole row.
    #[must_use]
    #[track_caller]
    pub fn new(values: &'a [f64], width: usize) -> Self {
        let fits = width > 0 && !values.is_empty() && values.len().is_multiple_of(width);
        assert!(fits, "{} values do not make rows of {width}", values.len());
        Self { values, width, height: values.len() / width }
    }

    fn cell(&self, p: &Vector2<f64>) -> Option<Cell> {
        let (left, right, a) = along(p.x, self.width)?;
        let (upper, lower, b) = along(p.y, self.height)?;
        let at = |row: usize, column: usize| self.values[row * self.width + column];
        Some(Cell { corners: [at(upper, left), at(upper, right), at(lower, left), at(lower, right)], a, b })
    }

    /// The image at a place between pixels, bilinear; `None` outside `[0, W - 1] x [0, H - 1]`.
    ///
    /// **Formula**: `(1 - b) [(1 - a) I_00 + a I_10] + b [(1 - a) I_01 + a I_11]`, `a` and `b` the parts of column and row
    /// behind the point, `I_10` the right and `I_01` the lower neighbour.
    #[must_use]
    pub fn read(&self, p: &Vector2<f64>) -> Option<f64> {
        let Cell { corners: [i00, i10, i01, i11], a, b } = self.cell(p)?;
        Some((1.0 - b) * ((1.0 - a) * i00 + a * i10) + b * ((1.0 - a) * i01 + a * i11))
    }

    /// Derivatives of [`Image::read`] by column and row, colours per pixel.
    ///
    /// **Formula**: `(1 - b) (I_10 - I_00) + b (I_11 - I_01)` and `(1 - a) (I_01 - I_00) + a (I_11 - I_10)`. On a row or column
    /// of pixels the derivative of the cell to the right or below, at the end that of the last cell.
    #[must_use]
    pub fn slope(&self, p: &Vector2<f64>) -> Option<Vector2<f64>> {
        let Cell { corners: [i00, i10, i01, i11], a, b } = self.cell(p)?;
        Some(Vector2::new((1.0 - b) * (i10 - i00) + b * (i11 - i01), (1.0 - a) * (i01 - i00) + a * (i11 - i10)))
    }

    /// Pixel number `index` shifted by a flow.
    #[must_use]
    pub fn shifted(&self, index: usize, flow: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new((index % self.width) as f64, (index / self.width) as f64) + flow
    }

    /// The image read along a flow with one entry a pixel: `I'(p) = I(p + f(p))`, `None` where that lies outside.
    ///
    /// **Panics** when there is not one flow a pixel.
    #[must_use]
    #[track_caller]
    pub fn warped(&self, flow: &[Vector2<f64>]) -> Vec<Option<f64>> {
        assert!(flow.len() == self.values.len(), "{} flows for {} pixels", flow.len(), self.values.len());
        flow.iter().enumerate().map(|(i, f)| self.read(&self.shifted(i, f))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_pixels_on_them_and_outside() {
        let image = Image::new(&[1.0, 2.0, 3.0, 5.0, 7.0, 11.0], 3);
        let read = |u: f64, v: f64| image.read(&Vector2::new(u, v));
        assert_eq!(read(2.0, 1.0), Some(11.0));
        assert_eq!(read(0.5, 0.25), Some(0.75 * 1.5 + 0.25 * 6.0));
        assert_eq!([read(-0.001, 0.0), read(2.001, 0.0), read(0.0, 1.5), read(f64::NAN, 0.0)], [None; 4]);
        assert_eq!(image.slope(&Vector2::new(1.5, 0.5)), Some(Vector2::new(2.5, 6.5)));
    }

    #[test]
    fn one_row_has_no_slope_across() {
        let image = Image::new(&[1.0, 4.0], 2);
        assert_eq!(image.read(&Vector2::new(0.5, 0.0)), Some(2.5));
        assert_eq!(image.slope(&Vector2::new(0.5, 0.0)), Some(Vector2::new(3.0, 0.0)));
        assert_eq!(image.warped(&[Vector2::x(), Vector2::x()]), [Some(4.0), None]);
    }

    #[test]
    #[should_panic(expected = "do not make rows of 2")]
    fn unfinished_rows_are_refused() {
        let _ = Image::new(&[1.0, 2.0, 3.0], 2);
    }
}

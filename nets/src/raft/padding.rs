//! Frames of any size for a network that wants multiples of its factor.

use dimode_autodiff::ops::pad::Sides;
use dimode_autodiff::{Scalar, Shape, Var};

/// Where the rows and columns go that fill a frame up with copies of its edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PaddingStyle {
    /// The same on both sides, one more at the end where the number is odd: as the reference does on Sintel.
    #[default]
    Sintel,
    /// Rows at the bottom alone, columns as in Sintel style: as the reference does on KITTI.
    Kitti,
}

/// What is added around frames of one size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Padding {
    sides: Sides,
    height: usize,
    width: usize,
}

impl Padding {
    /// To the next multiples of `multiple` that are not below `least`, itself one of them.
    pub(super) fn new(style: PaddingStyle, (multiple, least): (usize, usize), frame: Shape) -> Self {
        let (height, width) = (frame.h(), frame.w());
        let more = |side: usize| side.next_multiple_of(multiple).max(least) - side;
        let (rows, columns) = (more(height), more(width));
        let top = match style {
            PaddingStyle::Sintel => rows / 2,
            PaddingStyle::Kitti => 0,
        };
        let left = columns / 2;
        Self { sides: Sides { top, bottom: rows - top, left, right: columns - left }, height, width }
    }

    /// (N, C, H, W) -> the size that the network takes.
    pub(super) fn pad<'t, T: Scalar>(&self, frames: Var<'t, T>) -> Var<'t, T> {
        frames.pad_replicate(self.sides)
    }

    /// From the size that the network takes to that of the frames.
    pub(super) fn crop<'t, T: Scalar>(&self, x: Var<'t, T>) -> Var<'t, T> {
        x.slice(2, self.sides.top, self.height).last_use(|x| x.slice(3, self.sides.left, self.width))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Tape, Tensor};

    fn sides(style: PaddingStyle, height: usize, width: usize) -> [usize; 4] {
        let Sides { top, bottom, left, right } = Padding::new(style, (8, 64), Shape::new(1, 3, height, width)).sides;
        [top, bottom, left, right]
    }

    #[test]
    fn rows_and_columns_go_where_the_reference_puts_them() {
        // The usual frames of KITTI and Sintel.
        assert_eq!(sides(PaddingStyle::Kitti, 375, 1242), [0, 1, 3, 3]);
        assert_eq!(sides(PaddingStyle::Sintel, 436, 1024), [2, 2, 0, 0]);
        assert_eq!(sides(PaddingStyle::Sintel, 375, 1241), [0, 1, 3, 4]);
        assert_eq!(sides(PaddingStyle::Kitti, 370, 1226), [0, 6, 3, 3]);
        assert_eq!(sides(PaddingStyle::Sintel, 128, 64), [0; 4]);
        assert_eq!(sides(PaddingStyle::Sintel, 50, 64), [7, 7, 0, 0], "the coarsest map must not be empty");
    }

    #[test]
    fn the_crop_takes_back_what_was_added() {
        let frame = Tensor::from_fn(Shape::new(2, 3, 5, 67), |n, c, v, u| (n * 1000 + c * 500 + v * 70 + u) as f64);
        for style in [PaddingStyle::Sintel, PaddingStyle::Kitti] {
            let tape = Tape::new();
            let padding = Padding::new(style, (8, 64), frame.shape());
            let padded = padding.pad(tape.constant(frame.clone()));
            assert_eq!(padded.shape(), Shape::new(2, 3, 64, 72));
            assert_eq!(padding.crop(padded).value().data(), frame.data());
        }
    }
}

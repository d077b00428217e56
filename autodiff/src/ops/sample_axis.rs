//! Bilinear weights of one coordinate along one axis of an image, and what lies beyond its ends.

use crate::Scalar;

/// What a sample outside the image reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SamplePadding {
    /// The nearest pixel of the border: coordinates are clamped to the image. PyTorch: `padding_mode="border"`.
    Border,
    /// Zero: each neighbour outside counts as 0 with its weight. PyTorch: `padding_mode="zeros"`.
    Zeros,
}

/// Weights of one coordinate along one axis: on `base` and on the element after it, with their derivatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisTap<T> {
    /// The first of the two elements; the second is the same one along an axis of one element.
    pub(crate) base: usize,
    /// Weights of both.
    pub(crate) weight: [T; 2],
    /// Derivatives of the weights by the coordinate.
    pub(crate) slope: [T; 2],
}

impl<T: Scalar> AxisTap<T> {
    /// Weights of coordinate `x` along an axis of `size` elements.
    #[inline(always)]
    pub(crate) fn at(x: T, size: usize, padding: SamplePadding) -> Self {
        match padding {
            SamplePadding::Border => Self::border(x, size),
            SamplePadding::Zeros => Self::zeros(x, size),
        }
    }

    #[inline(always)]
    fn constant(base: usize, weight: [T; 2]) -> Self {
        Self { base, weight, slope: [T::ZERO; 2] }
    }

    #[inline(always)]
    fn inside(base: usize, part: T) -> Self {
        Self { base, weight: [T::ONE - part, part], slope: [-T::ONE, T::ONE] }
    }

    #[inline(always)]
    fn border(x: T, size: usize) -> Self {
        let last = T::from_f64((size - 1) as f64);
        if x > T::ZERO && x < last {
            let base = x.to_f64() as i32 as usize;
            Self::inside(base, x - T::from_f64(base as f64))
        } else if x >= last && size > 1 {
            Self::constant(size - 2, [T::ZERO, T::ONE])
        } else if x.is_nan() {
            Self::constant(0, [x; 2])
        } else {
            Self::constant(0, [T::ONE, T::ZERO])
        }
    }

    #[inline(always)]
    fn zeros(x: T, size: usize) -> Self {
        let last = T::from_f64((size - 1) as f64);
        if x >= T::ZERO && x < last {
            let base = x.to_f64() as i32 as usize;
            Self::inside(base, x - T::from_f64(base as f64))
        } else if x >= last && x < last + T::ONE {
            let rest = T::ONE - (x - last);
            if size > 1 {
                Self { base: size - 2, weight: [T::ZERO, rest], slope: [T::ZERO, -T::ONE] }
            } else {
                Self { base: 0, weight: [rest, T::ZERO], slope: [-T::ONE, T::ZERO] }
            }
        } else if x < T::ZERO && x >= -T::ONE {
            Self { base: 0, weight: [T::ONE + x, T::ZERO], slope: [T::ONE, T::ZERO] }
        } else if x.is_nan() {
            Self::constant(0, [x; 2])
        } else {
            Self::constant(0, [T::ZERO; 2])
        }
    }

    /// Whether the coordinate was NaN; the weights are then NaN and the slopes 0.
    #[inline(always)]
    pub(crate) fn is_nan(&self) -> bool {
        self.weight[0].is_nan()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, size: usize, padding: SamplePadding) -> (usize, [f64; 2], [f64; 2]) {
        let tap = AxisTap::at(x, size, padding);
        (tap.base, tap.weight, tap.slope)
    }

    #[test]
    fn inside_both_rules_agree() {
        for padding in [SamplePadding::Border, SamplePadding::Zeros] {
            assert_eq!(at(1.25, 4, padding), (1, [0.75, 0.25], [-1.0, 1.0]));
            assert_eq!(at(2.0, 4, padding), (2, [1.0, 0.0], [-1.0, 1.0]));
        }
    }

    #[test]
    fn the_border_holds_the_value_and_has_no_slope() {
        let border = |x| at(x, 4, SamplePadding::Border);
        assert_eq!(border(-7.0), (0, [1.0, 0.0], [0.0; 2]));
        assert_eq!(border(0.0), (0, [1.0, 0.0], [0.0; 2]));
        assert_eq!(border(3.0), (2, [0.0, 1.0], [0.0; 2]));
        assert_eq!(border(f64::INFINITY), (2, [0.0, 1.0], [0.0; 2]));
        assert_eq!(at(0.4, 1, SamplePadding::Border), (0, [1.0, 0.0], [0.0; 2]));
    }

    #[test]
    fn zeros_fade_over_one_element() {
        let zeros = |x| at(x, 4, SamplePadding::Zeros);
        assert_eq!(zeros(-0.25), (0, [0.75, 0.0], [1.0, 0.0]));
        assert_eq!(zeros(-1.0), (0, [0.0, 0.0], [1.0, 0.0]));
        assert_eq!(zeros(3.25), (2, [0.0, 0.75], [0.0, -1.0]));
        assert_eq!(zeros(-1.1), (0, [0.0; 2], [0.0; 2]));
        assert_eq!(zeros(4.0), (0, [0.0; 2], [0.0; 2]));
        assert_eq!(at(0.25, 1, SamplePadding::Zeros), (0, [0.75, 0.0], [-1.0, 0.0]));
    }

    #[test]
    fn values_are_continuous_across_every_joint() {
        let signal = [3.0, -1.0, 4.0];
        let value = |x: f64, padding| {
            let (base, weight, _) = at(x, 3, padding);
            weight[0] * signal[base] + weight[1] * signal[base + 1]
        };
        for padding in [SamplePadding::Border, SamplePadding::Zeros] {
            for joint in [-1.0, 0.0, 1.0, 2.0, 3.0] {
                let (below, above) = (value(joint - 1e-9, padding), value(joint + 1e-9, padding));
                assert!((below - above).abs() < 1e-7, "{padding:?} at {joint}: {below} and {above}");
            }
        }
    }
}

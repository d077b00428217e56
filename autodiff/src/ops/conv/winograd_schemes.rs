//! Winograd's schemes in one direction; a tile takes each in both.
//!
//! A scheme turns the padded inputs that a tile reads into sums of them, three weights into four, multiplies, sums over the
//! channels and turns the sums into outputs. With stride 2 a kernel of three is one of two over the even inputs and one of one
//! over the odd ones: the first takes three products for two outputs, F(2, 2), the second two. That is 25 products instead of 36
//! for four outputs, and as many for the sixteen gradients of the inputs that four outputs read.

use pulp::Simd;

use crate::Scalar;
use crate::simd::Wide;

/// Weights in one direction after their transform.
pub const WEIGHTS: usize = 4;
/// Most numbers of a tile in one direction.
pub const MOST: usize = 5;

/// Sizes of a scheme.
#[derive(Clone, Copy, Debug)]
pub struct Scheme {
    /// Padded inputs from one tile to the next.
    pub step: usize,
    /// Padded inputs that a tile reads, and numbers that they are transformed to.
    pub read: usize,
    pub inputs: usize,
    /// The products of every sum: transformed weight, transformed input.
    pub sums: &'static [&'static [(usize, usize)]],
    /// Outputs that the sums are transformed to.
    pub outputs: usize,
}

/// The schemes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// F(2, 3).
    Dense,
    /// Outputs of stride 2.
    Strided,
    /// Gradients of the inputs of stride 2: `step`, `read` and `inputs` are those of the output gradients.
    StridedInput,
}

impl Kind {
    /// Its sizes.
    pub fn scheme(self) -> Scheme {
        match self {
            Kind::Dense => Dense::SCHEME,
            Kind::Strided => Strided::SCHEME,
            Kind::StridedInput => StridedInput::SCHEME,
        }
    }
}

/// The transforms of a scheme. Of arrays the first elements count.
pub trait Transforms {
    const SCHEME: Scheme;
    /// Three weights.
    fn weights<S: Simd, T: Scalar>(w: [Wide<S, T>; 3], half: Wide<S, T>) -> [Wide<S, T>; WEIGHTS];
    /// What a tile reads.
    fn inputs<S: Simd, T: Scalar>(x: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST];
    /// The sums of a tile.
    fn outputs<S: Simd, T: Scalar>(m: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST];
}

/// Runs a block with the type of a scheme.
macro_rules! with_scheme {
    ($kind:expr, $name:ident => $run:expr) => {
        match $kind {
            Kind::Dense => {
                type $name = Dense;
                $run
            }
            Kind::Strided => {
                type $name = Strided;
                $run
            }
            Kind::StridedInput => {
                type $name = StridedInput;
                $run
            }
        }
    };
}
pub(super) use with_scheme;

/// Two outputs of stride 1: `y0 = m0 + m1 + m2`, `y1 = m1 - m2 - m3`.
pub struct Dense;

impl Transforms for Dense {
    const SCHEME: Scheme =
        Scheme { step: 2, read: 4, inputs: 4, sums: &[&[(0, 0)], &[(1, 1)], &[(2, 2)], &[(3, 3)]], outputs: 2 };

    #[inline(always)]
    fn weights<S: Simd, T: Scalar>([a, b, c]: [Wide<S, T>; 3], half: Wide<S, T>) -> [Wide<S, T>; WEIGHTS] {
        let (ends, middle) = (half * (a + c), half * b);
        [a, ends + middle, ends - middle, c]
    }

    #[inline(always)]
    fn inputs<S: Simd, T: Scalar>([a, b, c, d, rest]: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST] {
        [a - c, b + c, c - b, b - d, rest]
    }

    #[inline(always)]
    fn outputs<S: Simd, T: Scalar>([a, b, c, d, rest]: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST] {
        [a + b + c, b - c - d, rest, rest, rest]
    }
}

/// Two outputs of stride 2: `y0 = (x0 - x2) w0 + x1 w1 + x2 (w0 + w2)`, `y1 = x2 (w0 + w2) + x3 w1 + (x4 - x2) w2`.
pub struct Strided;

impl Transforms for Strided {
    const SCHEME: Scheme =
        Scheme { step: 4, read: 5, inputs: 5, sums: &[&[(0, 0), (3, 3)], &[(1, 1)], &[(2, 2), (3, 4)]], outputs: 2 };

    #[inline(always)]
    fn weights<S: Simd, T: Scalar>([a, b, c]: [Wide<S, T>; 3], _: Wide<S, T>) -> [Wide<S, T>; WEIGHTS] {
        [a, a + c, c, b]
    }

    #[inline(always)]
    fn inputs<S: Simd, T: Scalar>([a, b, c, d, e]: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST] {
        [a - c, c, e - c, b, d]
    }

    #[inline(always)]
    fn outputs<S: Simd, T: Scalar>([a, b, c, rest, _]: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST] {
        [a + b, b + c, rest, rest, rest]
    }
}

/// Gradients of four inputs of stride 2, from those of the outputs before, at and behind them, with the weights turned:
/// `dx0 = (g0 - g1) w2 + g1 (w0 + w2)`, `dx1 = g1 w1`, `dx2 = g1 (w0 + w2) + (g2 - g1) w0`, `dx3 = g2 w1`.
pub struct StridedInput;

impl Transforms for StridedInput {
    const SCHEME: Scheme =
        Scheme { step: 2, read: 3, inputs: 4, sums: &[&[(0, 0)], &[(1, 1)], &[(2, 2)], &[(3, 1)], &[(3, 3)]], outputs: 4 };

    #[inline(always)]
    fn weights<S: Simd, T: Scalar>(w: [Wide<S, T>; 3], half: Wide<S, T>) -> [Wide<S, T>; WEIGHTS] {
        Strided::weights(w, half)
    }

    #[inline(always)]
    fn inputs<S: Simd, T: Scalar>([a, b, c, rest, _]: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST] {
        [a - b, b, c - b, c, rest]
    }

    #[inline(always)]
    fn outputs<S: Simd, T: Scalar>([a, b, c, d, e]: [Wide<S, T>; MOST]) -> [Wide<S, T>; MOST] {
        [a + b, d, b + c, e, e]
    }
}

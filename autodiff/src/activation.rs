//! Activations that other operations apply to their output in the same pass.

use crate::Scalar;

/// What follows an operation in the same pass over its output. Each has a slope that its output tells, so that nothing else is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// As [`Var::relu`](crate::Var::relu).
    Relu,
    /// As [`Var::elu`](crate::Var::elu).
    Elu,
}

/// An activation known to the compiler, so that loops over it become vector code.
pub(crate) trait Activate: Copy + Send + Sync {
    /// The activation of one number.
    fn of<T: Scalar>(self, x: T) -> T;
    /// The gradient `g` of the output `y`, brought to the input.
    fn back<T: Scalar>(self, y: T, g: T) -> T;
}

#[derive(Clone, Copy)]
pub(crate) struct Identity;
#[derive(Clone, Copy)]
pub(crate) struct Relu;
#[derive(Clone, Copy)]
pub(crate) struct Elu;

impl Activate for Identity {
    #[inline(always)]
    fn of<T: Scalar>(self, x: T) -> T {
        x
    }
    #[inline(always)]
    fn back<T: Scalar>(self, _: T, g: T) -> T {
        g
    }
}

/// NaN stays NaN, in the value and in the gradient.
impl Activate for Relu {
    #[inline(always)]
    fn of<T: Scalar>(self, x: T) -> T {
        if x <= T::ZERO { T::ZERO } else { x }
    }
    #[inline(always)]
    fn back<T: Scalar>(self, y: T, g: T) -> T {
        if y <= T::ZERO { T::ZERO } else { g }
    }
}

/// `eˣ - 1` is computed as written: its absolute error stays below one unit of `T` at 1.
impl Activate for Elu {
    #[inline(always)]
    fn of<T: Scalar>(self, x: T) -> T {
        if x > T::ZERO { x } else { x.exp() - T::ONE }
    }
    #[inline(always)]
    fn back<T: Scalar>(self, y: T, g: T) -> T {
        if y > T::ZERO { g } else { g * (y + T::ONE) }
    }
}

/// Calls a generic function with the activation as a type: `with_activation!(activation, |a| f(a))`.
macro_rules! with_activation {
    ($activation:expr, |$a:ident| $body:expr) => {
        match $activation {
            $crate::Activation::Identity => {
                let $a = $crate::activation::Identity;
                $body
            }
            $crate::Activation::Relu => {
                let $a = $crate::activation::Relu;
                $body
            }
            $crate::Activation::Elu => {
                let $a = $crate::activation::Elu;
                $body
            }
        }
    };
}
pub(crate) use with_activation;

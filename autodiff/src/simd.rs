//! Vector registers of either number type, so that a kernel is written once and compiled for every instruction set.

mod wide;

pub use pulp::{Arch, Simd, WithSimd};

pub use wide::{Truths, Wide};

use crate::arccos;

/// Vector arithmetic on an element type under an instruction set `S`; [`Wide`] has the operators for it.
pub trait SimdScalar: Copy {
    /// One register.
    type Reg<S: Simd>: Copy;
    /// A truth value for every lane.
    type Truth<S: Simd>: Copy;
    /// Elements in a register.
    fn lanes<S: Simd>() -> usize;
    /// The same value in every lane.
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Reg<S>;
    /// The first lanes of a slice, which must be at least one register long.
    fn load<S: Simd>(x: &[Self]) -> Self::Reg<S>;
    /// As many whole registers as the slice has.
    fn registers<S: Simd>(x: &[Self]) -> &[Self::Reg<S>];
    /// Writes a register to the start of a slice, which must be at least one register long.
    fn store<S: Simd>(x: &mut [Self], v: Self::Reg<S>);
    /// As many lanes as the slice has elements, zeros behind; the slice may be shorter than a register.
    fn load_part<S: Simd>(simd: S, x: &[Self]) -> Self::Reg<S>;
    /// Writes as many lanes as the slice has elements; it may be shorter than a register.
    fn store_part<S: Simd>(simd: S, x: &mut [Self], v: Self::Reg<S>);
    /// `a * b + c`, rounded once.
    fn fma<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>, c: Self::Reg<S>) -> Self::Reg<S>;
    /// Sum of all lanes.
    fn reduce_sum<S: Simd>(simd: S, a: Self::Reg<S>) -> Self;
    /// `a + b`.
    fn plus<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// `a - b`.
    fn minus<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// `a b`.
    fn times<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// `a / b`.
    fn over<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// Square root.
    fn root<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// Absolute value.
    fn size<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// `-a`.
    fn opposite<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// `a < b`; false where one is NaN.
    fn less<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Truth<S>;
    /// `a <= b`; false where one is NaN.
    fn at_most<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Truth<S>;
    /// Arc cosine of cosines in [-1, 1], radians: to rounding in `f64`, to 5e-7 in `f32`.
    fn arccos<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// `a` where `truth` holds, `b` elsewhere.
    fn choose<S: Simd>(simd: S, truth: Self::Truth<S>, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// Where both hold.
    fn both<S: Simd>(simd: S, a: Self::Truth<S>, b: Self::Truth<S>) -> Self::Truth<S>;
    /// Where one holds.
    fn either<S: Simd>(simd: S, a: Self::Truth<S>, b: Self::Truth<S>) -> Self::Truth<S>;
    /// Takes numbers in groups of four apart: the first of every group, the second, and so on. The order of the groups is that of
    /// the instruction set, the same in all four.
    fn apart<S: Simd>(simd: S, a: [Self::Reg<S>; 4]) -> [Self::Reg<S>; 4];
    /// Where it does not hold.
    fn contrary<S: Simd>(simd: S, a: Self::Truth<S>) -> Self::Truth<S>;
}

macro_rules! simd_scalar {
    (
        $t:ident, $reg:ident, $truth:ident, $lanes:ident, $splat:ident, $as:ident, $as_mut:ident, $part:ident, $part_store:ident;
        [$($name:ident = $call:ident($($x:ident),*);)*]
        [$($truth_name:ident = $truth_call:ident($($y:ident),*);)*]
        $less:ident, $at_most:ident, $select:ident, $reduce:ident, $apart:ident, $arccos:path
    ) => {
        impl SimdScalar for $t {
            type Reg<S: Simd> = S::$reg;
            type Truth<S: Simd> = S::$truth;
            #[inline(always)]
            fn lanes<S: Simd>() -> usize {
                S::$lanes
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, x: Self) -> S::$reg {
                simd.$splat(x)
            }
            #[inline(always)]
            fn load<S: Simd>(x: &[Self]) -> S::$reg {
                S::$as(&x[..S::$lanes]).0[0]
            }
            #[inline(always)]
            fn registers<S: Simd>(x: &[Self]) -> &[S::$reg] {
                S::$as(x).0
            }
            #[inline(always)]
            fn store<S: Simd>(x: &mut [Self], v: S::$reg) {
                S::$as_mut(&mut x[..S::$lanes]).0[0] = v;
            }
            #[inline(always)]
            fn load_part<S: Simd>(simd: S, x: &[Self]) -> S::$reg {
                simd.$part(x)
            }
            #[inline(always)]
            fn store_part<S: Simd>(simd: S, x: &mut [Self], v: S::$reg) {
                simd.$part_store(x, v);
            }
            $(
                #[inline(always)]
                fn $name<S: Simd>(simd: S, $($x: S::$reg),*) -> S::$reg {
                    simd.$call($($x),*)
                }
            )*
            $(
                #[inline(always)]
                fn $truth_name<S: Simd>(simd: S, $($y: S::$truth),*) -> S::$truth {
                    simd.$truth_call($($y),*)
                }
            )*
            #[inline(always)]
            fn less<S: Simd>(simd: S, a: S::$reg, b: S::$reg) -> S::$truth {
                simd.$less(a, b)
            }
            #[inline(always)]
            fn at_most<S: Simd>(simd: S, a: S::$reg, b: S::$reg) -> S::$truth {
                simd.$at_most(a, b)
            }
            #[inline(always)]
            fn arccos<S: Simd>(simd: S, a: S::$reg) -> S::$reg {
                $arccos(simd, a)
            }
            #[inline(always)]
            fn choose<S: Simd>(simd: S, truth: S::$truth, a: S::$reg, b: S::$reg) -> S::$reg {
                simd.$select(truth, a, b)
            }
            #[inline(always)]
            fn apart<S: Simd>(simd: S, a: [S::$reg; 4]) -> [S::$reg; 4] {
                simd.$apart(a)
            }
            #[inline(always)]
            fn reduce_sum<S: Simd>(simd: S, a: S::$reg) -> Self {
                simd.$reduce(a)
            }
        }
    };
}

simd_scalar!(
    f32, f32s, m32s, F32_LANES, splat_f32s, as_simd_f32s, as_mut_simd_f32s, partial_load_f32s, partial_store_f32s;
    [fma = mul_add_e_f32s(a, b, c);
    plus = add_f32s(a, b);
    minus = sub_f32s(a, b);
    times = mul_f32s(a, b);
    over = div_f32s(a, b);
    root = sqrt_f32s(a);
    size = abs_f32s(a);
    opposite = neg_f32s(a);]
    [both = and_m32s(a, b);
    either = or_m32s(a, b);
    contrary = not_m32s(a);]
    less_than_f32s, less_than_or_equal_f32s, select_f32s, reduce_sum_f32s, deinterleave_shfl_f32s, arccos::single
);
simd_scalar!(
    f64, f64s, m64s, F64_LANES, splat_f64s, as_simd_f64s, as_mut_simd_f64s, partial_load_f64s, partial_store_f64s;
    [fma = mul_add_e_f64s(a, b, c);
    plus = add_f64s(a, b);
    minus = sub_f64s(a, b);
    times = mul_f64s(a, b);
    over = div_f64s(a, b);
    root = sqrt_f64s(a);
    size = abs_f64s(a);
    opposite = neg_f64s(a);]
    [both = and_m64s(a, b);
    either = or_m64s(a, b);
    contrary = not_m64s(a);]
    less_than_f64s, less_than_or_equal_f64s, select_f64s, reduce_sum_f64s, deinterleave_shfl_f64s, arccos::double
);

/// Repeats a block with a constant that takes each of the values: loops over registers must be written out before the compiler
/// keeps what they index in registers.
macro_rules! unroll {
    ($k:ident in $($value:literal)* => $body:block) => {$({
        const $k: usize = $value;
        $body
    })*};
}
pub(crate) use unroll;

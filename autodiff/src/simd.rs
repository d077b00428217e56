//! Vector registers of either number type, so that a kernel is written once and compiled for every instruction set.

use pulp::Simd;

/// Vector arithmetic on an element type under an instruction set `S`.
pub trait SimdScalar: Copy {
    /// One register.
    type Reg<S: Simd>: Copy;
    /// Elements in a register.
    fn lanes<S: Simd>() -> usize;
    /// The same value in every lane.
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Reg<S>;
    /// The first lanes of a slice, which must be at least one register long.
    fn load<S: Simd>(x: &[Self]) -> Self::Reg<S>;
    /// Writes a register to the start of a slice, which must be at least one register long.
    fn store<S: Simd>(x: &mut [Self], v: Self::Reg<S>);
    /// `a * b + c`, fused where the processor can.
    fn fma<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>, c: Self::Reg<S>) -> Self::Reg<S>;
    /// Sum of all lanes.
    fn reduce_sum<S: Simd>(simd: S, a: Self::Reg<S>) -> Self;
}

macro_rules! simd_scalar {
    ($t:ident, $reg:ident, $lanes:ident, $splat:ident, $as:ident, $as_mut:ident, $fma:ident, $reduce:ident) => {
        impl SimdScalar for $t {
            type Reg<S: Simd> = S::$reg;
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
            fn store<S: Simd>(x: &mut [Self], v: S::$reg) {
                S::$as_mut(&mut x[..S::$lanes]).0[0] = v;
            }
            #[inline(always)]
            fn fma<S: Simd>(simd: S, a: S::$reg, b: S::$reg, c: S::$reg) -> S::$reg {
                simd.$fma(a, b, c)
            }
            #[inline(always)]
            fn reduce_sum<S: Simd>(simd: S, a: S::$reg) -> Self {
                simd.$reduce(a)
            }
        }
    };
}

simd_scalar!(f32, f32s, F32_LANES, splat_f32s, as_simd_f32s, as_mut_simd_f32s, mul_add_e_f32s, reduce_sum_f32s);
simd_scalar!(f64, f64s, F64_LANES, splat_f64s, as_simd_f64s, as_mut_simd_f64s, mul_add_e_f64s, reduce_sum_f64s);

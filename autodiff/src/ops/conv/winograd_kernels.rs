//! The four kernels of Winograd's scheme, each on one thread: weights and inputs to the 16 products of a tile, the products, and
//! back to the four outputs.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::simd::{Wide, unroll};

/// Products of one tile.
pub const PRODUCTS: usize = 16;
/// Most output channels whose weights lie side by side.
pub const GROUP: usize = 64;
/// Output channels of a register block.
pub const BLOCK: usize = 8;
/// Taps of the kernel.
const TAPS: usize = 9;
/// Weights of a group of outputs, transformed: `G w G'` with `G = [1 0 0; 1/2 1/2 1/2; 1/2 -1/2 1/2; 0 0 1]`.
pub struct Weights<'a, T> {
    /// From the group's first output on: tap `t` of output `o`, channel `c` is at `o * steps[0] + c * steps[1] + t`.
    pub w: &'a [T],
    pub steps: [usize; 2],
    /// Whether the last tap is taken for the first one.
    pub turned: bool,
    pub outputs: usize,
    pub channels: usize,
    /// Outputs side by side: a multiple of [`STRIP`].
    pub width: usize,
    /// `[product][channel][width]`, products `step` apart; zeros beyond the last output, to the end of its strip.
    pub out: &'a mut [T],
    pub step: usize,
}

/// Outputs and input channels whose weights are transformed at one time.
const STRIP: usize = 16;
const SOME: usize = 32;

impl<T: Scalar> WithSimd for Weights<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let half = Wide::<S, T>::splat(simd, T::from_f64(0.5));
        // A cache line more: all taps would share one place of the nearest cache otherwise.
        let mut taps = [[T::ZERO; SOME * STRIP + 16]; TAPS];
        for o in (0..self.outputs).step_by(STRIP) {
            let outputs = STRIP.min(self.outputs - o);
            if outputs < STRIP {
                taps = [[T::ZERO; SOME * STRIP + 16]; TAPS];
            }
            for c in (0..self.channels).step_by(SOME) {
                let channels = SOME.min(self.channels - c);
                let w = &self.w[o * self.steps[0] + c * self.steps[1]..];
                // What lies side by side is read side by side.
                if self.steps[0] > self.steps[1] {
                    collect(w, [outputs, channels], self.steps, [1, STRIP], &mut taps);
                } else {
                    collect(w, [channels, outputs], [self.steps[1], self.steps[0]], [STRIP, 1], &mut taps);
                }
                for lane in (0..STRIP).step_by(T::lanes::<S>()) {
                    for i in 0..channels {
                        let out = &mut self.out[(c + i) * self.width + o + lane..];
                        transform_weights(simd, &taps, i * STRIP + lane, self.turned, half, out, self.step);
                    }
                }
            }
        }
    }
}

/// Takes the taps of `sizes` weights apart, which are `steps` apart and come to places `places` apart.
#[inline(always)]
fn collect<T: Scalar, const N: usize>(
    w: &[T],
    sizes: [usize; 2],
    steps: [usize; 2],
    places: [usize; 2],
    taps: &mut [[T; N]; TAPS],
) {
    for i in 0..sizes[0] {
        for j in 0..sizes[1] {
            let one = &w[i * steps[0] + j * steps[1]..][..TAPS];
            let at = i * places[0] + j * places[1];
            unroll!(K in 0 1 2 3 4 5 6 7 8 => {
                taps[K][at] = one[K];
            });
        }
    }
}

#[inline(always)]
fn transform_weights<S: Simd, T: Scalar, const N: usize>(
    simd: S,
    taps: &[[T; N]; TAPS],
    at: usize,
    turned: bool,
    half: Wide<S, T>,
    out: &mut [T],
    step: usize,
) {
    let mut rows = [[half; 4]; 3];
    unroll!(I in 0 1 2 => {
        let [a, b, c] = if turned { [8 - 3 * I, 7 - 3 * I, 6 - 3 * I] } else { [3 * I, 3 * I + 1, 3 * I + 2] };
        let (a, b) = (Wide::load(simd, &taps[a][at..]), Wide::load(simd, &taps[b][at..]));
        rows[I] = spread_weights([a, b, Wide::load(simd, &taps[c][at..])], half);
    });
    unroll!(J in 0 1 2 3 => {
        let column = spread_weights([rows[0][J], rows[1][J], rows[2][J]], half);
        unroll!(I in 0 1 2 3 => {
            column[I].store(&mut out[(4 * I + J) * step..]);
        });
    });
}

#[inline(always)]
fn spread_weights<S: Simd, T: Scalar>([a, b, c]: [Wide<S, T>; 3], half: Wide<S, T>) -> [Wide<S, T>; 4] {
    let (ends, middle) = (half * (a + c), half * b);
    [a, ends + middle, ends - middle, c]
}

/// Rows of tiles of one input plane, transformed: `B' d B` of every 4 x 4 patch, `B' = [1 0 -1 0; 0 1 1 0; 0 -1 1 0; 0 1 0 -1]`.
pub struct Inputs<'a, 'b, T> {
    /// Rows of `width`.
    pub x: &'a [T],
    pub width: usize,
    /// Source row of every padded row from the first tile's on; none is zeros, as is what lies beyond.
    pub rows: &'a [Option<usize>],
    /// Source column of every padded column, `pad` of which precede the image.
    pub cols: &'a [Option<usize>],
    pub pad: usize,
    /// Rows and columns of tiles.
    pub tiles: [usize; 2],
    /// [`Inputs::scratch`] elements.
    pub scratch: &'a mut [T],
    /// Where each product starts; tiles follow each other, with a register's space behind the last one.
    pub out: &'a mut [&'b mut [T]; PRODUCTS],
    pub start: usize,
}

/// Columns of one phase of a padded row.
fn phase_len(tiles: usize) -> usize {
    // The last register of the shifted read begins before tile `tiles`.
    (tiles + 1).next_multiple_of(16) + 16
}

impl<T: Scalar> Inputs<'_, '_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }

    /// Elements of scratch.
    pub fn scratch([rows, columns]: [usize; 2]) -> usize {
        // Rows are taken apart into even and odd columns; one more has the whole row.
        (2 * (2 * rows + 2) + 2) * phase_len(columns)
    }
}

impl<T: Scalar> WithSimd for Inputs<'_, '_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Inputs { x, width, rows, cols, pad, tiles: [high, wide], scratch, out, start } = self;
        let phase = phase_len(wide);
        let (whole, phases) = scratch.split_at_mut(2 * phase);
        for (y, apart) in phases.chunks_exact_mut(2 * phase).enumerate() {
            let (even, odd) = apart.split_at_mut(phase);
            let Some(row) = rows.get(y).copied().flatten() else {
                apart.fill(T::ZERO);
                continue;
            };
            let row = &x[row * width..][..width];
            whole[pad..pad + width].copy_from_slice(row);
            for i in (0..pad).chain(pad + width..cols.len()) {
                whole[i] = cols[i].map_or(T::ZERO, |c| row[c]);
            }
            whole[cols.len()..].fill(T::ZERO);
            for ((even, odd), pair) in even.iter_mut().zip(odd).zip(whole.as_chunks::<2>().0) {
                [*even, *odd] = *pair;
            }
        }
        let lanes = T::lanes::<S>();
        for row in 0..high {
            let rows = &phases[4 * row * phase..][..8 * phase];
            for at in (0..wide).step_by(lanes) {
                let mut columns = [[Wide::splat(simd, T::ZERO); 4]; 4];
                unroll!(I in 0 1 2 3 => {
                    let (even, odd) = rows[2 * I * phase + at..].split_at(phase);
                    let (a, b) = (Wide::load(simd, even), Wide::load(simd, odd));
                    let (c, d) = (Wide::load(simd, &even[1..]), Wide::load(simd, &odd[1..]));
                    columns[I] = spread([a, b, c, d]);
                });
                unroll!(J in 0 1 2 3 => {
                    let column = spread([columns[0][J], columns[1][J], columns[2][J], columns[3][J]]);
                    unroll!(I in 0 1 2 3 => {
                        column[I].store(&mut out[4 * I + J][start + row * wide + at..]);
                    });
                });
            }
        }
    }
}

#[inline(always)]
fn spread<S: Simd, T: Scalar>([a, b, c, d]: [Wide<S, T>; 4]) -> [Wide<S, T>; 4] {
    [a - c, b + c, c - b, b - d]
}

/// Sums over the input channels: for each product, a block of outputs times all tiles.
pub struct Products<'a, T> {
    /// `[product][channel][width]`, products `weights_step` apart.
    pub weights: &'a [T],
    pub width: usize,
    pub weights_step: usize,
    /// Product `p` starts at `p * step`, its channels are `pitch` apart.
    pub inputs: &'a [T],
    pub step: usize,
    pub pitch: usize,
    pub channels: usize,
    /// Tiles.
    pub len: usize,
    /// Outputs, a multiple of [`BLOCK`].
    pub outputs: usize,
    /// `[product][output][pitch]`.
    pub out: &'a mut [T],
    /// Whether to add to `out` rather than to fill it.
    pub add: bool,
}

impl<T: Scalar> WithSimd for Products<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = T::lanes::<S>();
        // 32 registers with the widest ones, else 16.
        let many = lanes * size_of::<T>() == 64;
        let p = &mut self;
        for product in 0..PRODUCTS {
            let mut at = 0;
            while at < p.len {
                let left = (p.len - at).div_ceil(lanes);
                // Two and two cost less than three and one.
                let registers = if left == 4 { 2 } else { left.min(3) };
                for o in (0..p.outputs).step_by(BLOCK) {
                    match (registers, many) {
                        (3, true) => block::<T, S, 8, 3>(p, simd, product, o, at),
                        (2, true) => block::<T, S, 8, 2>(p, simd, product, o, at),
                        (3, false) => {
                            block::<T, S, 4, 3>(p, simd, product, o, at);
                            block::<T, S, 4, 3>(p, simd, product, o + 4, at);
                        }
                        (2, false) => {
                            block::<T, S, 4, 2>(p, simd, product, o, at);
                            block::<T, S, 4, 2>(p, simd, product, o + 4, at);
                        }
                        _ => block::<T, S, 8, 1>(p, simd, product, o, at),
                    }
                }
                at += registers * lanes;
            }
        }
    }
}

/// Outputs from `o` on times the `V` registers of tiles from `at` on.
#[inline(always)]
fn block<T: Scalar, S: Simd, const O: usize, const V: usize>(
    p: &mut Products<'_, T>,
    simd: S,
    product: usize,
    o: usize,
    at: usize,
) {
    let lanes = T::lanes::<S>();
    let out = &mut p.out[(product * p.outputs + o) * p.pitch + at..];
    let mut acc = [[T::splat(simd, T::ZERO); V]; O];
    if p.add {
        unroll!(K in 0 1 2 3 4 5 6 7 => {
            if K < O {
                unroll!(L in 0 1 2 => {
                    if L < V {
                        acc[K][L] = T::load::<S>(&out[K * p.pitch + L * lanes..]);
                    }
                });
            }
        });
    }
    let inputs = p.inputs[product * p.step + at..].chunks(p.pitch);
    let weights = p.weights[product * p.weights_step..][..p.channels * p.width].chunks_exact(p.width);
    for (x, w) in inputs.zip(weights) {
        let x = &T::registers::<S>(&x[..V * lanes])[..V];
        let w = &w[o..][..O];
        unroll!(K in 0 1 2 3 4 5 6 7 => {
            if K < O {
                let w = T::splat(simd, w[K]);
                unroll!(L in 0 1 2 => {
                    if L < V {
                        acc[K][L] = T::fma(simd, w, x[L], acc[K][L]);
                    }
                });
            }
        });
    }
    unroll!(K in 0 1 2 3 4 5 6 7 => {
        if K < O {
            unroll!(L in 0 1 2 => {
                if L < V {
                    T::store::<S>(&mut out[K * p.pitch + L * lanes..], acc[K][L]);
                }
            });
        }
    });
}

/// Rows of tiles of one output plane: `A' m A` with `A' = [1 1 1 0; 0 1 -1 -1]` of the 16 products of every tile.
pub struct Outputs<'a, T> {
    /// The output's first tile; products are `step` apart, tiles follow each other, with a register's space behind the last one.
    pub products: &'a [T],
    pub step: usize,
    /// Columns of tiles.
    pub tiles: usize,
    pub bias: T,
    /// [`Outputs::scratch`] elements.
    pub scratch: &'a mut [T],
    /// Rows of `width`, two to a row of tiles; the last one may be missing.
    pub out: &'a mut [T],
    pub width: usize,
}

impl<T: Scalar> Outputs<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }

    /// Elements of scratch.
    pub fn scratch(tiles: usize) -> usize {
        4 * phase_len(tiles)
    }
}

impl<T: Scalar> WithSimd for Outputs<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = T::lanes::<S>();
        let Outputs { products, step, tiles, bias, scratch, out, width } = self;
        let phase = phase_len(tiles);
        let bias = Wide::splat(simd, bias);
        for (row, out) in out.chunks_mut(2 * width).enumerate() {
            for at in (0..tiles).step_by(lanes) {
                let products = &products[row * tiles + at..];
                let mut columns = [[bias; 2]; 4];
                unroll!(J in 0 1 2 3 => {
                    let (a, b) = (Wide::load(simd, &products[J * step..]), Wide::load(simd, &products[(4 + J) * step..]));
                    let (c, d) = (Wide::load(simd, &products[(8 + J) * step..]), Wide::load(simd, &products[(12 + J) * step..]));
                    columns[J] = gather([a, b, c, d]);
                });
                unroll!(I in 0 1 => {
                    let row = gather([columns[0][I], columns[1][I], columns[2][I], columns[3][I]]);
                    (row[0] + bias).store(&mut scratch[2 * I * phase + at..]);
                    (row[1] + bias).store(&mut scratch[(2 * I + 1) * phase + at..]);
                });
            }
            for (out, apart) in out.chunks_exact_mut(width).zip(scratch.chunks_exact(2 * phase)) {
                let (even, odd) = apart.split_at(phase);
                let (pairs, last) = out.as_chunks_mut::<2>();
                for (pair, (&even, &odd)) in pairs.iter_mut().zip(even.iter().zip(odd)) {
                    *pair = [even, odd];
                }
                if let [last] = last {
                    *last = even[width / 2];
                }
            }
        }
    }
}

#[inline(always)]
fn gather<S: Simd, T: Scalar>([a, b, c, d]: [Wide<S, T>; 4]) -> [Wide<S, T>; 2] {
    [a + b + c, b - c - d]
}

impl<T: Scalar> Weights<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> Products<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

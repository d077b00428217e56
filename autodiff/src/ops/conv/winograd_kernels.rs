//! The transforms of Winograd's schemes, each on one thread: of weights, of inputs, and from sums of products back to outputs.

use pulp::{Arch, Simd, WithSimd};

use super::winograd_schemes::{Dense, Kind, MOST, Scheme, Strided, StridedInput, Transforms, WEIGHTS, with_scheme};
use crate::Scalar;
use crate::simd::{Wide, unroll};

/// Planes of transformed weights.
pub const WEIGHT_PLANES: usize = WEIGHTS * WEIGHTS;
/// Most planes of transformed inputs.
pub const INPUT_PLANES: usize = MOST * MOST;
/// Taps of the kernel.
const TAPS: usize = 9;
/// Weights of a group of outputs, transformed.
pub struct Weights<'a, T> {
    pub kind: Kind,
    /// From the group's first output on: tap `t` of output `o`, channel `c` is at `o * steps[0] + c * steps[1] + t`.
    pub w: &'a [T],
    pub steps: [usize; 2],
    /// Whether the last tap is taken for the first one.
    pub turned: bool,
    pub outputs: usize,
    pub channels: usize,
    /// `[plane][strip of outputs][channel][output]`, planes `step` apart; zeros beyond the last output.
    pub out: &'a mut [T],
    pub step: usize,
}

/// Outputs whose weights lie side by side.
pub const STRIP: usize = 16;
/// Input channels whose weights are transformed at one time.
const SOME: usize = 32;

impl<T: Scalar> WithSimd for Weights<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        with_scheme!(self.kind, K => self.transform::<S, K>(simd));
    }
}

impl<T: Scalar> Weights<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }

    #[inline(always)]
    fn transform<S: Simd, K: Transforms>(self, simd: S) {
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
                        let out = &mut self.out[o * self.channels + (c + i) * STRIP + lane..];
                        transform_weights::<S, T, K, _>(simd, &taps, i * STRIP + lane, self.turned, half, out, self.step);
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
fn transform_weights<S: Simd, T: Scalar, K: Transforms, const N: usize>(
    simd: S,
    taps: &[[T; N]; TAPS],
    at: usize,
    turned: bool,
    half: Wide<S, T>,
    out: &mut [T],
    step: usize,
) {
    let mut rows = [[half; WEIGHTS]; 3];
    unroll!(I in 0 1 2 => {
        let [a, b, c] = if turned { [8 - 3 * I, 7 - 3 * I, 6 - 3 * I] } else { [3 * I, 3 * I + 1, 3 * I + 2] };
        let (a, b) = (Wide::load(simd, &taps[a][at..]), Wide::load(simd, &taps[b][at..]));
        rows[I] = K::weights([a, b, Wide::load(simd, &taps[c][at..])], half);
    });
    unroll!(J in 0 1 2 3 => {
        let column = K::weights([rows[0][J], rows[1][J], rows[2][J]], half);
        unroll!(I in 0 1 2 3 => {
            column[I].store(&mut out[(WEIGHTS * I + J) * step..]);
        });
    });
}

/// Rows of tiles of one input plane, transformed.
pub struct Inputs<'a, 'b, T> {
    pub kind: Kind,
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
    /// Where each plane starts; tiles follow each other, with a register's space behind the last one.
    pub out: &'a mut [&'b mut [T]; INPUT_PLANES],
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

    /// Elements of scratch: rows are taken apart into phases, of every so many columns; one more has the whole row.
    pub fn scratch(kind: Kind, [rows, columns]: [usize; 2]) -> usize {
        let Scheme { step, read, .. } = kind.scheme();
        ((rows - 1) * step + read + 1) * step * phase_len(columns)
    }

    #[inline(always)]
    fn transform<S: Simd, K: Transforms>(self, simd: S) {
        let Inputs { x, width, rows, cols, pad, tiles: [high, wide], scratch, out, start, .. } = self;
        let Scheme { step, read, inputs, .. } = K::SCHEME;
        let phase = phase_len(wide);
        let (whole, phases) = scratch.split_at_mut(step * phase);
        for (y, apart) in phases.chunks_exact_mut(step * phase).enumerate() {
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
            // What registers read beyond is not used.
            let whole = &whole[..(wide + 1) * step];
            let (first, second) = apart.split_at_mut(step / 2 * phase);
            if step == 2 {
                halves(whole, first, second);
            } else {
                let ((a, b), (c, d)) = (first.split_at_mut(phase), second.split_at_mut(phase));
                quarters(whole, [a, b, c, d]);
            }
        }
        let lanes = T::lanes::<S>();
        let zero = Wide::splat(simd, T::ZERO);
        for row in 0..high {
            let rows = &phases[row * step * step * phase..][..read * step * phase];
            for at in (0..wide).step_by(lanes) {
                let mut columns = [[zero; MOST]; MOST];
                unroll!(I in 0 1 2 3 4 => {
                    if I < read {
                        let mut values = [zero; MOST];
                        unroll!(J in 0 1 2 3 4 => {
                            if J < read {
                                values[J] = Wide::load(simd, &rows[(I * step + J % step) * phase + at + J / step..]);
                            }
                        });
                        columns[I] = K::inputs(values);
                    }
                });
                unroll!(J in 0 1 2 3 4 => {
                    if J < inputs {
                        let column = K::inputs([columns[0][J], columns[1][J], columns[2][J], columns[3][J], columns[4][J]]);
                        unroll!(I in 0 1 2 3 4 => {
                            if I < inputs {
                                column[I].store(&mut out[inputs * I + J][start + row * wide + at..]);
                            }
                        });
                    }
                });
            }
        }
    }
}

impl<T: Scalar> WithSimd for Inputs<'_, '_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        with_scheme!(self.kind, K => self.transform::<S, K>(simd));
    }
}

/// The even and the odd columns of a row.
#[inline(always)]
fn halves<T: Scalar>(whole: &[T], even: &mut [T], odd: &mut [T]) {
    for ((pair, even), odd) in whole.as_chunks::<2>().0.iter().zip(even).zip(odd) {
        [*even, *odd] = *pair;
    }
}

/// Every fourth column of a row, from each of the first four on.
#[inline(always)]
fn quarters<T: Scalar>(whole: &[T], apart: [&mut [T]; 4]) {
    let [a, b, c, d] = apart;
    for ((((four, a), b), c), d) in whole.as_chunks::<4>().0.iter().zip(a).zip(b).zip(c).zip(d) {
        [*a, *b, *c, *d] = *four;
    }
}

/// Rows of tiles of one output plane, from the sums of every tile.
pub struct Outputs<'a, T> {
    pub kind: Kind,
    /// The output's first tile; sums are `step` apart, tiles follow each other, with a register's space behind the last one.
    pub sums: &'a [T],
    pub step: usize,
    /// Columns of tiles.
    pub tiles: usize,
    /// Rows and columns of the first tiles that are not wanted.
    pub skip: [usize; 2],
    pub bias: T,
    /// [`Outputs::scratch`] elements.
    pub scratch: &'a mut [T],
    /// Rows of `width`; the last ones of the last tiles may be missing.
    pub out: &'a mut [T],
    pub width: usize,
}

impl<T: Scalar> Outputs<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }

    /// Elements of scratch: one row of tiles.
    pub fn scratch(kind: Kind, tiles: usize) -> usize {
        kind.scheme().outputs.pow(2) * phase_len(tiles)
    }

    #[inline(always)]
    fn transform<S: Simd, K: Transforms>(self, simd: S) {
        let lanes = T::lanes::<S>();
        let Outputs { sums, step, tiles, skip, bias, scratch, out, width, .. } = self;
        let (count, outputs) = (K::SCHEME.sums.len(), K::SCHEME.outputs);
        let phase = phase_len(tiles);
        let bias = Wide::splat(simd, bias);
        let mut wanted = out.chunks_exact_mut(width);
        let (mut unwanted, mut tile) = (skip[0], 0);
        while wanted.len() > 0 {
            for at in (0..tiles).step_by(lanes) {
                let sums = &sums[tile * tiles + at..];
                let mut columns = [[bias; MOST]; MOST];
                unroll!(J in 0 1 2 3 4 => {
                    if J < count {
                        let mut column = [bias; MOST];
                        unroll!(I in 0 1 2 3 4 => {
                            if I < count {
                                column[I] = Wide::load(simd, &sums[(count * I + J) * step..]);
                            }
                        });
                        columns[J] = K::outputs(column);
                    }
                });
                unroll!(I in 0 1 2 3 4 => {
                    if I < outputs {
                        let row = K::outputs([columns[0][I], columns[1][I], columns[2][I], columns[3][I], columns[4][I]]);
                        unroll!(J in 0 1 2 3 4 => {
                            if J < outputs {
                                (row[J] + bias).store(&mut scratch[(I * outputs + J) * phase + at..]);
                            }
                        });
                    }
                });
            }
            for (apart, out) in scratch.chunks_exact(outputs * phase).take(outputs).skip(unwanted).zip(&mut wanted) {
                if outputs == 2 {
                    put_together::<T, 2>(apart, phase, skip[1], out);
                } else {
                    put_together::<T, 4>(apart, phase, skip[1], out);
                }
            }
            (unwanted, tile) = (0, tile + 1);
        }
    }
}

impl<T: Scalar> WithSimd for Outputs<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        with_scheme!(self.kind, K => self.transform::<S, K>(simd));
    }
}

/// A row from its phases, but for its first `skip` columns.
#[inline(always)]
fn put_together<T: Scalar, const N: usize>(apart: &[T], phase: usize, skip: usize, out: &mut [T]) {
    // To the first column of a tile, whole tiles, and the rest.
    let (head, out) = out.split_at_mut((skip.next_multiple_of(N) - skip).min(out.len()));
    for (i, head) in head.iter_mut().enumerate() {
        *head = apart[(skip + i) * phase];
    }
    let (tiles, rest) = out.as_chunks_mut::<N>();
    let count = tiles.len();
    let apart = |k: usize| &apart[k * phase + skip.div_ceil(N)..][..count + 1];
    for (k, rest) in rest.iter_mut().enumerate() {
        *rest = apart(k)[count];
    }
    if N == 2 {
        for ((tile, &a), &b) in tiles.iter_mut().zip(apart(0)).zip(apart(1)) {
            (tile[0], tile[1]) = (a, b);
        }
    } else {
        for ((((tile, &a), &b), &c), &d) in tiles.iter_mut().zip(apart(0)).zip(apart(1)).zip(apart(2)).zip(apart(3)) {
            (tile[0], tile[1], tile[2], tile[3]) = (a, b, c, d);
        }
    }
}

//! The three kernels of Winograd's gradient of the weights, each on one thread: tiles of inputs and of output gradients to the 16
//! factors of a tile, the products of the two, and from those to the nine taps.
//!
//! All three have channels in the lanes of a register. No sum over lanes is left at the end, narrow images fill registers as wide
//! ones do, and the products read both factors in the order in which they lie in memory.

use pulp::{Arch, Simd, WithSimd};

use crate::Scalar;
use crate::simd::{Wide, unroll};

/// Products of one tile.
pub const PRODUCTS: usize = 16;

/// Channels that are brought side by side at one time.
pub const STRIP: usize = 16;
/// Those of which a square is turned at one time.
const QUAD: usize = 4;
/// Tiles of a group: all products of the tiles and channels of a group lie together, in few pages of memory.
pub const GROUPED: usize = 16;
/// Elements of a group, `[product][tile][STRIP]`, and a cache line: groups would share one place of the nearest cache otherwise.
pub const GROUP_LEN: usize = (PRODUCTS * GROUPED + 1) * STRIP;
/// Taps of the kernel.
pub const TAPS: usize = 9;

/// A row of tiles of up to [`STRIP`] planes, transformed: `B' d B` of every 4 x 4 patch of inputs, with
/// `B' = [1 0 -1 0; 0 1 1 0; 0 -1 1 0; 0 1 0 -1]`, or `A g A'` of every 2 x 2 patch of gradients, with `A = [1 0; 1 1; 1 -1; 0 1]`.
pub struct Tiles<'a, T> {
    /// Planes of the strip, `plane` elements apart, with rows of `width`.
    pub x: &'a [T],
    pub plane: usize,
    pub width: usize,
    pub channels: usize,
    /// Source row and column of every padded row and column; none is zeros, as is what lies beyond. `pad` columns precede the
    /// image.
    pub rows: &'a [Option<usize>],
    pub cols: &'a [Option<usize>],
    pub pad: usize,
    /// First padded row and column of the first patch.
    pub first: [usize; 2],
    pub tiles: usize,
    /// Rows and columns of a patch: 4 of inputs, 2 of gradients.
    pub size: usize,
    /// Whether `across` holds all but the last two rows already, from the row of tiles above.
    pub known: bool,
    /// The patches' rows with channels side by side, `[row][column][STRIP]`: [`Tiles::across`] elements. A row has its place by the
    /// remainder of its number.
    pub across: &'a mut [T],
    /// Groups of [`GROUP_LEN`], to be filled from tile `at` on; zeros beyond the last channel.
    pub out: &'a mut [T],
    pub at: usize,
}

impl<T: Scalar> Tiles<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }

    /// Elements of `across`.
    pub fn across(tiles: usize, size: usize) -> usize {
        size * Self::row_len(tiles, size)
    }

    /// Those of a row.
    fn row_len(tiles: usize, size: usize) -> usize {
        (2 * tiles + size - 2) * STRIP
    }
}

impl<T: Scalar> WithSimd for Tiles<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let len = Self::row_len(self.tiles, self.size);
        let fresh = if self.known { self.size - 2 } else { 0 };
        for row in self.first[0] + fresh..self.first[0] + self.size {
            let at = row % self.size * len;
            bring_across(&mut self, simd, row, at, len);
        }
        for lane in (0..STRIP).step_by(T::lanes::<S>()) {
            if self.size == 4 {
                transform_inputs(&mut self, simd, lane, len);
            } else {
                transform_gradients(&mut self, simd, lane, len);
            }
        }
    }
}

/// Brings the channels of a padded row side by side.
#[inline(always)]
fn bring_across<S: Simd, T: Scalar>(t: &mut Tiles<'_, T>, simd: S, row: usize, at: usize, len: usize) {
    let out = &mut t.across[at..][..len];
    let source = t.rows.get(row).copied().flatten();
    if source.is_none() || t.channels < STRIP {
        out.fill(T::ZERO);
    }
    let Some(source) = source else { return };
    let x = &t.x[source * t.width..];
    let (first, columns) = (t.first[1], len / STRIP);
    // Where the row reads the image itself, between what padding made up.
    let start = t.pad.saturating_sub(first).min(columns);
    let end = (t.pad + t.width).saturating_sub(first).clamp(start, columns);
    let from = first.max(t.pad) - t.pad;
    let (lanes, square) = (T::lanes::<S>(), turns_squares::<S, T>(simd));
    let quads = t.channels / QUAD;
    for q in 0..quads {
        let planes = [0, 1, 2, 3].map(|k| &x[(q * QUAD + k) * t.plane + from..][..end - start]);
        for i in (start..end).step_by(lanes) {
            let mut rows = [T::splat(simd, T::ZERO); QUAD];
            unroll!(K in 0 1 2 3 => {
                let row = &planes[K][i - start..];
                rows[K] = if row.len() < lanes { T::load_part(simd, row) } else { T::load::<S>(row) };
            });
            turn(simd, square, rows, lanes.min(end - i), &mut out[i * STRIP + q * QUAD..], STRIP);
        }
    }
    let (o, done) = (quads * QUAD, end);
    for (k, column) in out.chunks_exact_mut(STRIP).enumerate() {
        let inside = (start..done).contains(&k);
        // Whole groups of four channels are there already.
        let some = if inside { o } else { 0 };
        if some == t.channels {
            continue;
        }
        match t.cols.get(first + k).copied().flatten() {
            Some(c) => (some..t.channels).for_each(|o| column[o] = x[o * t.plane + c]),
            None => column.fill(T::ZERO),
        }
    }
}

/// The places of all products of a tile: the first one, those of others are [`GROUPED`] apart.
#[inline(always)]
fn places<T>(out: &mut [T], tile: usize) -> &mut [[T; STRIP]; (PRODUCTS - 1) * GROUPED + 1] {
    let group = out[tile / GROUPED * GROUP_LEN..].first_chunk_mut::<GROUP_LEN>().expect("there is room for all tiles");
    group.as_chunks_mut::<STRIP>().0[tile % GROUPED..].first_chunk_mut().expect("a group has all products")
}

/// Whether `apart` turns squares of four rows and columns, each in a quarter of a register or so.
#[inline(always)]
fn turns_squares<S: Simd, T: Scalar>(simd: S) -> bool {
    let lanes = T::lanes::<S>();
    let mut numbers = [[T::ZERO; STRIP]; QUAD];
    for (k, row) in numbers.iter_mut().enumerate() {
        for (i, number) in row[..lanes].iter_mut().enumerate() {
            *number = T::from_f64((k * lanes + i) as f64);
        }
    }
    let turned = T::apart(simd, [0, 1, 2, 3].map(|k| T::load::<S>(&numbers[k])));
    let mut order = [T::ZERO; STRIP];
    T::store::<S>(&mut order, turned[0]);
    (0..lanes).all(|i| order[i] == T::from_f64((i % QUAD * lanes + i / QUAD * QUAD) as f64))
}

/// Writes some columns of four rows, `pitch` apart.
#[inline(always)]
fn turn<S: Simd, T: Scalar>(simd: S, square: bool, x: [T::Reg<S>; QUAD], columns: usize, out: &mut [T], pitch: usize) {
    let x = if square { T::apart(simd, x) } else { x };
    let mut turned = [[[T::ZERO; QUAD]; STRIP / QUAD]; QUAD];
    unroll!(K in 0 1 2 3 => {
        T::store::<S>(turned[K].as_flattened_mut(), x[K]);
    });
    if square {
        for (k, first) in (0..columns).step_by(QUAD).enumerate() {
            unroll!(K in 0 1 2 3 => {
                if first + K < columns {
                    out[(first + K) * pitch..][..QUAD].copy_from_slice(&turned[K][k]);
                }
            });
        }
    } else {
        for column in 0..columns {
            unroll!(K in 0 1 2 3 => {
                out[column * pitch + K] = turned[K][column / QUAD][column % QUAD];
            });
        }
    }
}

#[inline(always)]
fn transform_inputs<S: Simd, T: Scalar>(t: &mut Tiles<'_, T>, simd: S, lane: usize, len: usize) {
    let top = t.first[0];
    let [a, b, c, d] = [0, 1, 2, 3].map(|k| t.across[(top + k) % 4 * len..][..len].as_chunks::<{ 2 * STRIP }>().0);
    // Neighbours share two columns.
    let mut right = spread_pairs(simd, [&a[0], &b[0], &c[0], &d[0]], lane);
    let pairs = a[1..].iter().zip(&b[1..]).zip(c[1..].iter().zip(&d[1..]));
    for (tile, ((a, b), (c, d))) in (0..t.tiles).zip(pairs) {
        let left = right;
        right = spread_pairs(simd, [a, b, c, d], lane);
        let out = places(t.out, t.at + tile);
        unroll!(I in 0 1 2 3 => {
            let [a, b, c, d] = [left[0][I], left[1][I], right[0][I], right[1][I]];
            (a - c).store(&mut out[4 * I * GROUPED][lane..]);
            (b + c).store(&mut out[(4 * I + 1) * GROUPED][lane..]);
            (c - b).store(&mut out[(4 * I + 2) * GROUPED][lane..]);
            (b - d).store(&mut out[(4 * I + 3) * GROUPED][lane..]);
        });
    }
}

/// Two columns of four rows, transformed.
#[inline(always)]
fn spread_pairs<S: Simd, T: Scalar>(simd: S, x: [&[T; 2 * STRIP]; 4], lane: usize) -> [[Wide<S, T>; 4]; 2] {
    [spread(simd, x, lane), spread(simd, x, STRIP + lane)]
}

#[inline(always)]
fn spread<S: Simd, T: Scalar>(simd: S, x: [&[T; 2 * STRIP]; 4], at: usize) -> [Wide<S, T>; 4] {
    let (a, b) = (Wide::load(simd, &x[0][at..]), Wide::load(simd, &x[1][at..]));
    let (c, d) = (Wide::load(simd, &x[2][at..]), Wide::load(simd, &x[3][at..]));
    [a - c, b + c, c - b, b - d]
}

#[inline(always)]
fn transform_gradients<S: Simd, T: Scalar>(t: &mut Tiles<'_, T>, simd: S, lane: usize, len: usize) {
    let (above, below) = t.across[..2 * len].split_at(len);
    let pairs = above.as_chunks::<{ 2 * STRIP }>().0.iter().zip(below.as_chunks::<{ 2 * STRIP }>().0);
    for (tile, (above, below)) in (0..t.tiles).zip(pairs) {
        let (a, b) = (Wide::load(simd, &above[lane..]), Wide::load(simd, &above[STRIP + lane..]));
        let (c, d) = (Wide::load(simd, &below[lane..]), Wide::load(simd, &below[STRIP + lane..]));
        let out = places(t.out, t.at + tile);
        let rows = [[a, b], [a + c, b + d], [a - c, b - d], [c, d]];
        unroll!(I in 0 1 2 3 => {
            let [a, b] = rows[I];
            a.store(&mut out[4 * I * GROUPED][lane..]);
            (a + b).store(&mut out[(4 * I + 1) * GROUPED][lane..]);
            (a - b).store(&mut out[(4 * I + 2) * GROUPED][lane..]);
            b.store(&mut out[(4 * I + 3) * GROUPED][lane..]);
        });
    }
}

/// Transformed tiles of some strips of channels.
#[derive(Clone, Copy)]
pub struct Factors<'a, T> {
    /// `[strip][group]`, strips `strip` apart.
    pub values: &'a [T],
    pub strip: usize,
    /// Channels, a multiple of [`STRIP`].
    pub channels: usize,
}

impl<'a, T> Factors<'a, T> {
    /// The groups of a channel's strip.
    #[inline(always)]
    fn groups(&self, channel: usize) -> &'a [[T; GROUP_LEN]] {
        self.values[channel / STRIP * self.strip..][..self.strip].as_chunks().0
    }
}

/// Some tiles of a group and a product.
#[inline(always)]
fn of_product<T>(group: &[T; GROUP_LEN], product: usize, tiles: usize) -> &[[T; STRIP]] {
    &group.as_chunks().0[product * GROUPED..][..tiles]
}

/// Sums over tiles: for each product, all outputs times all input channels.
pub struct Sums<'a, T> {
    /// Transformed gradients and inputs.
    pub gradients: Factors<'a, T>,
    pub inputs: Factors<'a, T>,
    pub tiles: usize,
    /// `[product][output][channel]`.
    pub out: &'a mut [T],
    /// Whether to add to `out` rather than to fill it.
    pub add: bool,
}

impl<T: Scalar> Sums<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Sums<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = T::lanes::<S>();
        // 32 registers with the widest ones, else 16.
        let many = lanes * size_of::<T>() == 64;
        let s = &mut self;
        for product in 0..PRODUCTS {
            let mut at = 0;
            while at < s.inputs.channels {
                let registers = ((s.inputs.channels - at) / lanes).min(2);
                let mut o = 0;
                while o < s.gradients.channels {
                    o += match (registers, many) {
                        (2, true) => block::<T, S, 2, 8>(s, simd, product, o, at),
                        (2, false) => block::<T, S, 2, 4>(s, simd, product, o, at),
                        (_, true) => block::<T, S, 1, 16>(s, simd, product, o, at),
                        _ => block::<T, S, 1, 8>(s, simd, product, o, at),
                    };
                }
                at += registers * lanes;
            }
        }
    }
}

/// `O` outputs from `o` on times the `V` registers of input channels from `at` on. Returns the number of outputs.
#[inline(always)]
fn block<T: Scalar, S: Simd, const V: usize, const O: usize>(
    s: &mut Sums<'_, T>,
    simd: S,
    product: usize,
    o: usize,
    at: usize,
) -> usize {
    let lanes = T::lanes::<S>();
    let mut acc = [[T::splat(simd, T::ZERO); V]; O];
    let gradients = s.gradients.groups(o);
    let inputs: [&[[T; GROUP_LEN]]; V] = std::array::from_fn(|l| s.inputs.groups(at + l * lanes));
    let first = o % STRIP;
    for (group, from) in (0..s.tiles).step_by(GROUPED).enumerate() {
        let tiles = GROUPED.min(s.tiles - from);
        let gradients = of_product(&gradients[group], product, tiles);
        let inputs: [&[[T; STRIP]]; V] = inputs.map(|groups| of_product(&groups[group], product, tiles));
        for tile in 0..tiles {
            let g = &gradients[tile][first..][..O];
            let mut x = [T::splat(simd, T::ZERO); V];
            unroll!(L in 0 1 => {
                if L < V {
                    x[L] = T::load::<S>(&inputs[L][tile][(at + L * lanes) % STRIP..]);
                }
            });
            unroll!(K in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 => {
                if K < O {
                    let g = T::splat(simd, g[K]);
                    unroll!(L in 0 1 => {
                        if L < V {
                            acc[K][L] = T::fma(simd, g, x[L], acc[K][L]);
                        }
                    });
                }
            });
        }
    }
    let channels = s.inputs.channels;
    let out = &mut s.out[(product * s.gradients.channels + o) * channels + at..];
    unroll!(K in 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 => {
        if K < O {
            unroll!(L in 0 1 => {
                if L < V {
                    let out = &mut out[K * channels + L * lanes..];
                    if s.add {
                        acc[K][L] = T::plus(simd, acc[K][L], T::load::<S>(out));
                    }
                    T::store::<S>(out, acc[K][L]);
                }
            });
        }
    });
    O
}

/// From the summed products to the taps: `G' m G` with `G' = [1 1/2 1/2 0; 0 1/2 -1/2 0; 0 1/2 1/2 -1]`.
pub struct Taps<'a, T> {
    /// `[product][output][pitch]`, products `step` apart.
    pub sums: &'a [T],
    pub step: usize,
    pub pitch: usize,
    pub channels: usize,
    /// `[output][channel][tap]`.
    pub out: &'a mut [T],
}

impl<T: Scalar> Taps<'_, T> {
    /// Runs the kernel on the processor's widest registers.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Scalar> WithSimd for Taps<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = T::lanes::<S>();
        let half = Wide::<S, T>::splat(simd, T::from_f64(0.5));
        let square = turns_squares::<S, T>(simd);
        let mut last = [T::ZERO; STRIP];
        for (o, out) in self.out.chunks_exact_mut(self.channels * TAPS).enumerate() {
            for (i, out) in out.chunks_mut(lanes * TAPS).enumerate() {
                let sums = &self.sums[o * self.pitch + i * lanes..];
                let mut columns = [[half; 3]; 4];
                unroll!(J in 0 1 2 3 => {
                    let (a, b) = (Wide::load(simd, &sums[J * self.step..]), Wide::load(simd, &sums[(4 + J) * self.step..]));
                    let (c, d) = (Wide::load(simd, &sums[(8 + J) * self.step..]), Wide::load(simd, &sums[(12 + J) * self.step..]));
                    columns[J] = gather([a, b, c, d], half);
                });
                let mut taps = [half.reg(); TAPS];
                unroll!(I in 0 1 2 => {
                    let row = gather([columns[0][I], columns[1][I], columns[2][I], columns[3][I]], half);
                    unroll!(J in 0 1 2 => {
                        taps[3 * I + J] = row[J].reg();
                    });
                });
                let [a, b, c, d, e, f, g, h, i] = taps;
                let columns = out.len() / TAPS;
                turn(simd, square, [a, b, c, d], columns, out, TAPS);
                turn(simd, square, [e, f, g, h], columns, &mut out[QUAD..], TAPS);
                T::store::<S>(&mut last, i);
                out[TAPS - 1..].iter_mut().step_by(TAPS).zip(last).for_each(|(out, last)| *out = last);
            }
        }
    }
}

#[inline(always)]
fn gather<S: Simd, T: Scalar>([a, b, c, d]: [Wide<S, T>; 4], half: Wide<S, T>) -> [Wide<S, T>; 3] {
    let (sum, difference) = (half * (b + c), half * (b - c));
    [a + sum, difference, sum - d]
}

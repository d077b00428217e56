//! Sizes of a convolution and the padded, phase-split planes that its kernels read.
//!
//! With stride `s` the padded input is split into `s x s` phase planes (every `s`-th row and column), so that each kernel tap
//! reads one phase plane at a constant offset: every convolution becomes a stride-1 sum of shifted planes.

use super::weight_outer::STRIP;
use crate::{Conv2d, PadMode, Pool, Scalar, Shape, par};

/// Elements behind the last plane that a kernel may read (never use).
pub const SLACK: usize = 64;

/// All sizes of one convolution.
#[derive(Clone, Debug)]
pub struct Layout {
    pub input: Shape,
    pub output: Shape,
    pub groups: usize,
    /// Input and output channels of one group.
    pub cin: usize,
    pub cout: usize,
    /// Kernel taps, row-major.
    pub taps: usize,
    /// Strides.
    pub stride: (usize, usize),
    /// What lies outside the image.
    pub pad_mode: PadMode,
    /// Rows and columns of one phase plane.
    pub phase_h: usize,
    pub phase_w: usize,
    /// Phases that some tap reads, `(row, column)`.
    pub phases: Vec<(usize, usize)>,
    /// For each tap: index into `phases`, rows and columns of offset.
    pub tap_at: Vec<(usize, usize, usize)>,
    /// Source row and column of every padded row and column; `None` is zero padding.
    pub rows: Vec<Option<usize>>,
    pub cols: Vec<Option<usize>>,
}

impl Layout {
    /// Sizes for an input and weights `[out, in / groups, kh, kw]`, already checked to fit.
    pub fn new(input: Shape, weight: Shape, output: Shape, conv: &Conv2d) -> Self {
        let (sh, sw) = conv.stride;
        let (dh, dw) = conv.dilation;
        let mut phases = Vec::new();
        let mut tap_at = Vec::new();
        for ky in 0..weight.h() {
            for kx in 0..weight.w() {
                let (y, x) = (ky * dh, kx * dw);
                let phase = (y % sh, x % sw);
                let index = phases.iter().position(|&p| p == phase).unwrap_or_else(|| {
                    phases.push(phase);
                    phases.len() - 1
                });
                tap_at.push((index, y / sh, x / sw));
            }
        }
        Layout {
            input,
            output,
            groups: conv.groups,
            cin: weight.c(),
            cout: weight.n() / conv.groups,
            taps: weight.plane(),
            stride: conv.stride,
            pad_mode: conv.pad_mode,
            phase_h: (input.h() + 2 * conv.padding.0).div_ceil(sh),
            phase_w: (input.w() + 2 * conv.padding.1).div_ceil(sw),
            phases,
            tap_at,
            rows: source_indices(input.h(), conv.padding.0, conv.pad_mode),
            cols: source_indices(input.w(), conv.padding.1, conv.pad_mode),
        }
    }

    /// Rows and columns added on each side.
    pub fn padding(&self) -> (usize, usize) {
        ((self.rows.len() - self.input.h()) / 2, (self.cols.len() - self.input.w()) / 2)
    }

    /// Whether one phase holds all of the padded input.
    pub fn is_dense(&self) -> bool {
        self.stride == (1, 1)
    }

    /// Whether Winograd's scheme fits: a kernel of 3 x 3 taps next to each other, stride 1, one group, at most the full padding.
    pub fn is_winograd(&self) -> bool {
        self.is_dense() && self.is_three_by_three() && self.reach() == (2, 2)
    }

    /// Whether that of stride 2 does, in both directions.
    pub fn is_winograd_strided(&self) -> bool {
        self.stride == (2, 2) && self.is_three_by_three() && self.reach() == (1, 1) && self.phases.len() == 4
    }

    fn is_three_by_three(&self) -> bool {
        let (above, before) = self.padding();
        self.groups == 1 && self.taps == 9 && above.max(before) <= 2
    }

    /// Elements of one phase plane.
    pub fn phase_len(&self) -> usize {
        self.phase_h * self.phase_w
    }

    /// Elements of all phase planes of one channel.
    pub fn channel_len(&self) -> usize {
        self.phases.len() * self.phase_len()
    }

    /// Flat positions of the output in the row pitch of a phase plane, junk columns included.
    pub fn flat_len(&self) -> usize {
        (self.output.h() - 1) * self.phase_w + self.output.w()
    }

    /// Offset of each tap from an output's flat position, within a channel's phase planes.
    pub fn tap_offsets(&self) -> Vec<usize> {
        self.tap_at.iter().map(|&(phase, y, x)| phase * self.phase_len() + y * self.phase_w + x).collect()
    }

    /// Whether every three taps read side by side.
    pub fn taps_in_threes(&self) -> bool {
        let threes =
            |taps: &[(usize, usize, usize)]| matches!(*taps, [(a, b, c), y, z] if y == (a, b, c + 1) && z == (a, b, c + 2));
        self.tap_at.chunks(3).all(threes)
    }

    /// Largest row and column offset of a tap.
    pub fn reach(&self) -> (usize, usize) {
        let rows = self.tap_at.iter().map(|t| t.1).max().unwrap_or(0);
        let cols = self.tap_at.iter().map(|t| t.2).max().unwrap_or(0);
        (rows, cols)
    }

    /// The input as padded phase planes `[n][c][phase][row][column]`, with slack behind.
    pub fn pack_input<T: Scalar>(&self, x: &[T], pool: &Pool<T>) -> Vec<T> {
        let planes = self.input.planes();
        let channel = self.channel_len();
        let mut packed = pool.take(planes * channel + SLACK);
        let group = (par::CHUNK / channel).max(1);
        par::for_each_chunk(&mut packed, group * channel, |chunk, out| {
            for (j, out) in out.chunks_mut(channel).enumerate() {
                let plane = chunk * group + j;
                if plane < planes {
                    let len = self.input.plane();
                    self.pack_plane(&x[plane * len..][..len], out);
                } else {
                    out.fill(T::ZERO);
                }
            }
        });
        packed
    }

    /// One plane as padded phase planes.
    pub fn pack_plane<T: Scalar>(&self, x: &[T], out: &mut [T]) {
        let width = self.input.w();
        for (&(a, b), plane) in self.phases.iter().zip(out.chunks_exact_mut(self.phase_len())) {
            for (y, row) in plane.chunks_exact_mut(self.phase_w).enumerate() {
                match self.rows.get(y * self.stride.0 + a).copied().flatten() {
                    Some(r) => self.pack_row(&x[r * width..][..width], b, row),
                    None => row.fill(T::ZERO),
                }
            }
        }
    }

    fn pack_row<T: Scalar>(&self, x: &[T], phase: usize, row: &mut [T]) {
        let pad = (self.cols.len() - x.len()) / 2;
        if self.stride.1 == 1 {
            row[pad..pad + x.len()].copy_from_slice(x);
            for i in (0..pad).chain(pad + x.len()..row.len()) {
                row[i] = self.cols.get(i).copied().flatten().map_or(T::ZERO, |c| x[c]);
            }
        } else {
            // Where the row reads the image itself, between what padding made up.
            let step = self.stride.1;
            let first = pad.saturating_sub(phase).div_ceil(step).min(row.len());
            let from = first * step + phase - pad;
            let last = (first + x.len().saturating_sub(from).div_ceil(step)).min(row.len());
            let (inner, x_inner) = (&mut row[first..last], &x[from.min(x.len())..]);
            if step == 2 {
                // The step of nearly all convolutions, in whole pairs: the compiler makes vectors of it.
                let pairs = x_inner.as_chunks::<2>().0;
                inner.iter_mut().zip(pairs).for_each(|(o, pair)| *o = pair[0]);
                if inner.len() > pairs.len() {
                    inner[pairs.len()] = x_inner[2 * pairs.len()];
                }
            } else {
                inner.iter_mut().zip(x_inner.chunks(step)).for_each(|(o, x)| *o = x[0]);
            }
            for i in (0..first).chain(last..row.len()) {
                row[i] = self.cols.get(i * step + phase).copied().flatten().map_or(T::ZERO, |c| x[c]);
            }
        }
    }

    /// Output gradients in the row pitch of a phase plane, zeros in the junk columns: `[n][o][flat]`, `pitch` elements each.
    pub fn pack_flat_grad<T: Scalar>(&self, g: &[T], pitch: usize, pool: &Pool<T>) -> Vec<T> {
        let (ho, wo) = (self.output.h(), self.output.w());
        let mut packed = pool.take(self.output.planes() * pitch);
        let group = (par::CHUNK / pitch).max(1);
        par::for_each_chunk(&mut packed, group * pitch, |chunk, out| {
            for (j, out) in out.chunks_mut(pitch).enumerate() {
                let plane = &g[(chunk * group + j) * ho * wo..][..ho * wo];
                out.fill(T::ZERO);
                for (y, row) in plane.chunks_exact(wo).enumerate() {
                    out[y * self.phase_w..][..wo].copy_from_slice(row);
                }
            }
        });
        packed
    }

    /// The strips of a group's output channels: first channel and width, [`STRIP`] or half of it.
    pub fn strips(&self) -> Vec<(usize, usize)> {
        let width = |first| if self.cout - first <= STRIP / 2 { STRIP / 2 } else { STRIP };
        (0..self.cout).step_by(STRIP).map(|first| (first, width(first))).collect()
    }

    /// Output gradients of one group with strips of channels side by side: `[n][row][column][width]` for each strip, zeros beyond
    /// the last channel. A strip starts at its first channel times all positions.
    pub fn pack_strips<T: Scalar>(&self, g: &[T], group: usize, pool: &Pool<T>) -> Vec<T> {
        /// Positions at which all channels of a strip meet in the nearest cache.
        const POSITIONS: usize = 128;
        /// Positions of a task.
        const SOME: usize = 16 * POSITIONS;
        let (plane, images) = (self.output.plane(), self.output.n());
        let strips = self.strips();
        let channels = strips.last().map_or(0, |(first, width)| first + width);
        let mut packed = pool.take(channels * images * plane);
        let mut rest = &mut packed[..];
        let mut tasks = Vec::new();
        for &(first, width) in &strips {
            for n in 0..images {
                let (head, tail) = rest.split_at_mut(width * plane);
                let some = head.chunks_mut(SOME * width).enumerate();
                tasks.extend(some.map(|(i, out)| (n, first, width, i * SOME, out)));
                rest = tail;
            }
        }
        par::for_each_item(tasks, |_, (n, first, width, from, out)| {
            let real = width.min(self.cout - first);
            if real < width {
                out.fill(T::ZERO);
            }
            let g = &g[(n * self.output.c() + group * self.cout + first) * plane..][..real * plane];
            for (tile, out) in out.chunks_mut(POSITIONS * width).enumerate() {
                for (o, g) in g.chunks_exact(plane).enumerate() {
                    for (out, &g) in out.chunks_exact_mut(width).zip(&g[from + tile * POSITIONS..]) {
                        out[o] = g;
                    }
                }
            }
        });
        packed
    }

    /// Output gradients with a border of zeros above and left as wide as the reach of the taps: `[n][o][row][column]` and the
    /// row pitch.
    pub fn pack_bordered_grad<T: Scalar>(&self, g: &[T], pool: &Pool<T>) -> (Vec<T>, usize, usize) {
        let (up, left) = self.reach();
        let (ho, wo) = (self.output.h(), self.output.w());
        let pitch = self.phase_w + left;
        let len = (self.phase_h + up) * pitch;
        let planes = self.output.planes();
        let mut packed = pool.take(planes * len + SLACK);
        let group = (par::CHUNK / len).max(1);
        par::for_each_chunk(&mut packed, group * len, |chunk, out| {
            out.fill(T::ZERO);
            for (j, out) in out.chunks_exact_mut(len).enumerate() {
                let plane = chunk * group + j;
                if plane >= planes {
                    break;
                }
                for (y, row) in g[plane * ho * wo..][..ho * wo].chunks_exact(wo).enumerate() {
                    out[(y + up) * pitch + left..][..wo].copy_from_slice(row);
                }
            }
        });
        (packed, pitch, len)
    }
}

/// Which source index each padded position reads.
pub fn source_indices(len: usize, pad: usize, mode: PadMode) -> Vec<Option<usize>> {
    (0..len + 2 * pad)
        .map(|i| {
            let i = i as isize - pad as isize;
            let last = len as isize - 1;
            match mode {
                _ if (0..=last).contains(&i) => Some(i as usize),
                PadMode::Zero => None,
                PadMode::Replicate => Some(i.clamp(0, last) as usize),
                PadMode::Reflect => Some((if i < 0 { -i } else { 2 * last - i }) as usize),
            }
        })
        .collect()
}

//! Both passes over the pixels, in bands of rows that do not depend on the number of threads.

use dimode_autodiff::simd::{Arch, Simd, WithSimd};
use dimode_autodiff::{Pool, Scalar, Tensor, par};

use super::aligned::{self, Given};
use super::plan::{Gathered, Plan, Upstream};
use super::rows::{Rows, SEGMENT, Sample, Sums};
use super::sampling::Grid;

/// Most bands of one image. In the second pass each has rows of its own to add source gradients to.
const BANDS: usize = 8;
/// Least rows of a band.
const LEAST_ROWS: usize = 8;

/// What both passes read.
pub(super) struct Scene<T: Scalar> {
    pub grid: Grid,
    pub target_depth: Tensor<T>,
    pub source_depth: Tensor<T>,
    pub flow: Tensor<T>,
    pub mask: Tensor<T>,
    pub samples: Vec<(Sample<T>, Plan<T>)>,
}

impl<T: Scalar> Scene<T> {
    /// Rows of a band.
    fn rows(&self) -> usize {
        self.grid.height.div_ceil(BANDS).max(LEAST_ROWS)
    }

    /// Bands of one image.
    fn bands(&self) -> usize {
        self.grid.height.div_ceil(self.rows())
    }

    fn plane(&self) -> usize {
        self.grid.height * self.grid.width
    }

    /// Cuts maps of one channel into bands, sample by sample.
    fn cut<'a>(&self, maps: &'a mut [T]) -> impl Iterator<Item = &'a mut [T]> {
        let rows = self.rows() * self.grid.width;
        maps.chunks_mut(self.plane()).flat_map(move |map| map.chunks_mut(rows))
    }

    /// The given maps on a segment of a row.
    #[inline(always)]
    fn given<'a>(&'a self, n: usize, at: usize, len: usize, source_depth: &'a [T]) -> Given<'a, T> {
        Given {
            target_depth: &self.target_depth.plane(n, 0)[at..at + len],
            source_depth,
            flow: [&self.flow.plane(n, 0)[at..at + len], &self.flow.plane(n, 1)[at..at + len]],
            mask: &self.mask.plane(n, 0)[at..at + len],
        }
    }

    /// The first pass: fills the source depth where the flow ends, and returns the sums of every sample.
    pub(super) fn sum(&self, pool: &Pool<T>, read: &mut [T]) -> Vec<[Sums; 4]> {
        let bands = self.bands();
        let mut sums = vec![[Sums::default(); 4]; self.samples.len() * bands];
        let items: Vec<_> = self.cut(read).zip(&mut sums).collect();
        par::for_each_item(items, |i, (read, sums)| {
            let mut buffer = pool.take(Rows::<T>::len(self.grid.width));
            let (sample, first_row) = (i / bands, i % bands * self.rows());
            Arch::new().dispatch(First { scene: self, sample, first_row, read, sums, buffer: &mut buffer });
            pool.give(buffer);
        });
        sums.chunks(bands).map(|bands| bands.iter().fold(Default::default(), add_all)).collect()
    }

    /// The second pass: writes gradients and returns those of the rotation (9) and `a` (3) of every sample.
    pub(super) fn spread(&self, pool: &Pool<T>, read: &[T], upstream: &[Upstream], out: Gradients<'_, T>) -> Vec<[f64; 12]> {
        let bands = self.bands();
        let mut results = vec![Result::default(); self.samples.len() * bands];
        let mut scattered = match &out.source_depth {
            Some(_) => pool.take(self.samples.len() * bands * self.plane()),
            None => Vec::new(),
        };
        let mut own = scattered.chunks_mut(self.plane());
        let (mut flow, through_reading) = match out.flow {
            Some((flow, through_reading)) => (Some(flow.chunks_mut(self.plane())), through_reading),
            None => (None, false),
        };
        let mut target = self.cut(out.target_depth);
        let mut items = Vec::with_capacity(results.len());
        let mut flows = Vec::new();
        for _ in 0..self.samples.len() {
            if let Some(planes) = &mut flow {
                let rows = self.rows() * self.grid.width;
                let [u, v] = [planes.next(), planes.next()].map(|plane| plane.expect("two channels").chunks_mut(rows));
                flows.extend(u.zip(v).map(|(u, v)| [u, v]));
            }
        }
        let mut flows = flows.into_iter();
        for result in &mut results {
            items.push((result, target.next().expect("a band of every map"), flows.next(), own.next()));
        }
        par::for_each_item(items, |i, (result, to_target_depth, to_flow, own)| {
            let mut buffer = pool.take(Rows::<T>::len(self.grid.width));
            let (sample, first_row) = (i / bands, i % bands * self.rows());
            let upstream = &upstream[sample];
            let second = Second {
                scene: self,
                sample,
                first_row,
                read,
                upstream,
                to_target_depth,
                to_flow,
                through_reading,
                own,
                result,
                buffer: &mut buffer,
            };
            Arch::new().dispatch(second);
            pool.give(buffer);
        });
        if let Some(gradient) = out.source_depth {
            self.merge(&scattered, &results, gradient);
            pool.give(scattered);
        }
        let of_sample = |(n, bands): (usize, &[Result])| {
            let gathered = bands.iter().fold(Gathered::default(), |sum, band| sum.plus(&band.gathered));
            let (sample, plan) = &self.samples[n];
            plan.to_motion(sample, &upstream[n], &gathered)
        };
        results.chunks(bands).enumerate().map(of_sample).collect()
    }

    /// Adds up what the bands sent to the source depth, in their order.
    fn merge(&self, scattered: &[T], results: &[Result], gradient: &mut [T]) {
        let (bands, plane, width) = (self.bands(), self.plane(), self.grid.width);
        par::for_each_item(self.cut(gradient).collect(), |i, out| {
            let (sample, first_row) = (i / bands, i % bands * self.rows());
            out.fill(T::ZERO);
            for band in sample * bands..(sample + 1) * bands {
                let [from, to] = results[band].rows;
                let (from, to) = (from.max(first_row), to.min(first_row + out.len() / width));
                if from < to {
                    let own = &scattered[band * plane + from * width..band * plane + to * width];
                    let out = &mut out[(from - first_row) * width..][..own.len()];
                    for (out, &own) in out.iter_mut().zip(own) {
                        *out += own;
                    }
                }
            }
        });
    }
}

/// Where the second pass writes.
pub(super) struct Gradients<'a, T> {
    pub target_depth: &'a mut [T],
    /// `None` when it is not wanted.
    pub source_depth: Option<&'a mut [T]>,
    /// `None` when it is not wanted; with it, whether it also has a gradient by where the source depth is read.
    pub flow: Option<(&'a mut [T], bool)>,
}

/// What a band of the second pass found.
#[derive(Clone, Copy, Default)]
struct Result {
    gathered: Gathered,
    /// Rows of the source depth with gradients, first and past the last.
    rows: [usize; 2],
}

impl Gathered {
    fn plus(mut self, other: &Self) -> Self {
        self.motion.iter_mut().zip(other.motion).for_each(|(a, b)| *a += b);
        self.to_a.iter_mut().zip(other.to_a).for_each(|(a, b)| *a += b);
        self.to_direction.iter_mut().zip(other.to_direction).for_each(|(a, b)| *a += b);
        self
    }
}

fn add_all(mut sum: [Sums; 4], band: &[Sums; 4]) -> [Sums; 4] {
    sum.iter_mut().flatten().zip(band.iter().flatten()).for_each(|(sum, band)| *sum += band);
    sum
}

/// A band of the first pass.
struct First<'a, T: Scalar> {
    scene: &'a Scene<T>,
    sample: usize,
    first_row: usize,
    read: &'a mut [T],
    sums: &'a mut [Sums; 4],
    buffer: &'a mut [T],
}

impl<T: Scalar> WithSimd for First<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scene, sample: n, first_row, read, sums, buffer } = self;
        let (grid, (sample, plan)) = (&scene.grid, &scene.samples[n]);
        let source = scene.source_depth.plane(n, 0);
        let [u0, v0] = sample.principal_point;
        for start in (0..grid.width).step_by(SEGMENT) {
            let len = SEGMENT.min(grid.width - start);
            let mut rows = Rows::new(buffer, start, len, u0);
            for (i, read) in read.chunks_exact_mut(grid.width).enumerate() {
                let row = first_row + i;
                rows.enter(row, v0);
                let read = &mut read[start..start + len];
                let at = row * grid.width + start;
                let flow = scene.given(n, at, len, &[]).flow;
                grid.find(simd, flow, &mut rows);
                grid.gather(source, len, &mut rows);
                grid.blend(simd, &rows, read);
                aligned::forward(simd, sample, scene.given(n, at, len, read), &mut rows);
                plan.sum(simd, sample, &rows, sums);
            }
        }
    }
}

/// A band of the second pass.
struct Second<'a, T: Scalar> {
    scene: &'a Scene<T>,
    sample: usize,
    first_row: usize,
    read: &'a [T],
    upstream: &'a Upstream,
    to_target_depth: &'a mut [T],
    to_flow: Option<[&'a mut [T]; 2]>,
    through_reading: bool,
    own: Option<&'a mut [T]>,
    result: &'a mut Result,
    buffer: &'a mut [T],
}

impl<T: Scalar> WithSimd for Second<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scene, sample: n, first_row, read, upstream, buffer, result, .. } = self;
        let (mut to_flow, mut own) = (self.to_flow, self.own);
        let (grid, (sample, plan)) = (&scene.grid, &scene.samples[n]);
        let source = scene.source_depth.plane(n, 0);
        let [u0, v0] = sample.principal_point;
        result.rows = [first_row, first_row];
        for start in (0..grid.width).step_by(SEGMENT) {
            let len = SEGMENT.min(grid.width - start);
            let mut rows = Rows::new(buffer, start, len, u0);
            for (i, out) in self.to_target_depth.chunks_exact_mut(grid.width).enumerate() {
                let row = first_row + i;
                rows.enter(row, v0);
                let at = row * grid.width + start;
                let read = &read[n * scene.plane() + at..][..len];
                let given = scene.given(n, at, len, read);
                let cells = grid.find(simd, given.flow, &mut rows);
                aligned::forward(simd, sample, given, &mut rows);
                rows.clear_gradients();
                plan.spread(simd, sample, upstream, &mut rows, &mut result.gathered);
                aligned::backward(simd, sample, given, &mut rows, to_flow.is_some(), &mut result.gathered.motion);
                out[start..start + len].copy_from_slice(&rows.to_target_depth[..len]);
                if let Some([to_u, to_v]) = &mut to_flow {
                    if self.through_reading {
                        grid.gather(source, len, &mut rows);
                        grid.slopes(simd, given.flow, &mut rows);
                    }
                    let at = i * grid.width + start;
                    to_u[at..at + len].copy_from_slice(&rows.to_flow[0][..len]);
                    to_v[at..at + len].copy_from_slice(&rows.to_flow[1][..len]);
                }
                if let Some(own) = &mut own {
                    clear(own, &mut result.rows, grid.rows_of(cells), grid.width);
                    grid.scatter(len, &rows, own);
                }
            }
        }
    }
}

/// Extends the rows that were set to 0 so far by those that are wanted.
fn clear<T: Scalar>(own: &mut [T], cleared: &mut [usize; 2], [from, to]: [usize; 2], width: usize) {
    if cleared[0] == cleared[1] {
        *cleared = [from, from];
    }
    if from < cleared[0] {
        own[from * width..cleared[0] * width].fill(T::ZERO);
        cleared[0] = from;
    }
    if to > cleared[1] {
        own[cleared[1] * width..to * width].fill(T::ZERO);
        cleared[1] = to;
    }
}

//! Census distance of two grey images, as one operation: a window of 49 cells would otherwise keep some hundred maps for the way
//! back.
//!
//! With `d` the difference of a cell from the middle in one image, `d'` in the other, `a = sqrt(0.81 + d^2)`, `a'` likewise and
//! `n = d a' - d' a`, the codes differ by `e = n / (a a')`, and `e^2 / (0.1 + e^2) = n^2 / F`, `F = 0.1 a^2 a'^2 + n^2`: one
//! division for a cell.
//!
//! vjp to the first image: a pair of pixels `p`, `q` stands in the windows of both, with the same `e` but for its sign. So `p`
//! receives `-0.162 sum over q of (g_p + g_q) n a'^3 / F^2`, where pixels outside the image have `g = 0`. Every pixel gathers its
//! own sum; nothing is scattered.

use dimode_autodiff::simd::Wide;
use dimode_autodiff::{GradSink, Pool, Scalar, Shape, Tensor, Var, par};
use pulp::{Arch, Simd, WithSimd};

/// Square of the grey difference at which a code reaches `1 / sqrt 2`.
const SOFTNESS: f64 = 0.81;
/// Square of the code difference at which the distance reaches one half.
const SATURATION: f64 = 0.1;
/// Rows of a band: the unit of parallel work, independent of the number of threads.
const ROWS: usize = 16;
/// Registers have a divisor of this many elements.
const WIDEST: usize = 16;

/// Census distance `h` of grey images `[n, 1, h, w]`, summed over the cells of a window of `2 radius + 1` pixels a side; grey 0
/// outside.
///
/// **Gradient**: to both images; exactly 0 at pixels in whose windows no gradient comes in, whatever is there.
///
/// # Panics
/// When the shapes differ or there is more than one channel.
#[track_caller]
pub fn census_distance<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>, radius: usize) -> Var<'t, T> {
    let (x, y) = (a.value(), b.value());
    let shape = x.shape();
    assert!(shape == y.shape() && shape.c() == 1, "census_distance: two grey images of one shape, got {shape} and {}", y.shape());
    let size = Size { h: shape.h(), w: shape.w(), radius };
    let pool = a.tape().pool().clone();
    let mut out = a.tape().scratch(shape.len());
    for_each_band(&mut out, shape, |n, start, out| {
        let maps = [&x, &y].map(|map| map.plane(n, 0));
        with_margins(&pool, size, maps, start, out, |size, maps, out| Arch::new().dispatch(Distances { size, maps, out }));
    });
    let out = a.tape().tensor(shape, out);
    a.tape().push("census_distance", out, &[a, b], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        for (k, (own, other)) in [(&x, &y), (&y, &x)].into_iter().enumerate() {
            let Some(mut slot) = grads.slot(k) else { continue };
            slot.write(|out| {
                for_each_band(out, shape, |n, start, out| {
                    let maps = [own, other, g].map(|map| map.plane(n, 0));
                    with_margins(&pool, size, maps, start, out, |size, maps, out| {
                        Arch::new().dispatch(Slopes { size, maps, out });
                    });
                });
            });
        }
    })
}

#[derive(Clone, Copy)]
struct Size {
    h: usize,
    w: usize,
    radius: usize,
}

impl Size {
    /// Elements of a row with margins, in which a register may start at every column of a window.
    fn stride(self) -> usize {
        (self.w + 2 * self.radius).next_multiple_of(WIDEST) + WIDEST
    }
}

/// Runs `f(sample, first row, rows)` on bands of rows of maps of one channel.
fn for_each_band<T: Scalar>(out: &mut [T], shape: Shape, f: impl Fn(usize, usize, &mut [T]) + Sync + Send) {
    let planes = out.chunks_mut(shape.plane()).enumerate();
    let bands = planes.flat_map(|(n, plane)| plane.chunks_mut(ROWS * shape.w()).enumerate().map(move |(i, band)| (n, i, band)));
    par::for_each_item(bands.collect(), |_, (n, i, band)| f(n, i * ROWS, band));
}

/// Runs `f` with the rows of the maps that the windows of a band reach, zeros around the image.
fn with_margins<T: Scalar, const N: usize>(
    pool: &Pool<T>,
    size: Size,
    maps: [&[T]; N],
    start: usize,
    out: &mut [T],
    f: impl FnOnce(Size, [&[T]; N], &mut [T]),
) {
    let Size { h, w, radius } = size;
    let (stride, rows) = (size.stride(), out.len() / w + 2 * radius);
    let mut work = pool.take(N * rows * stride);
    for (map, padded) in maps.into_iter().zip(work.chunks_exact_mut(rows * stride)) {
        for (i, row) in padded.chunks_exact_mut(stride).enumerate() {
            row[..radius].fill(T::ZERO);
            row[radius + w..].fill(T::ZERO);
            match (start + i).checked_sub(radius).filter(|&source| source < h) {
                Some(source) => row[radius..radius + w].copy_from_slice(&map[source * w..][..w]),
                None => row[radius..radius + w].fill(T::ZERO),
            }
        }
    }
    let mut padded = work.chunks_exact(rows * stride);
    f(size, std::array::from_fn(|_| padded.next().expect("N maps")), out);
    pool.give(work);
}

/// `[n, a^2, a'^2, a']` of differences from the middle in two images.
#[inline(always)]
fn codes<S: Simd, T: Scalar>(d: Wide<S, T>, other: Wide<S, T>) -> [Wide<S, T>; 4] {
    let softness = d.like(T::from_f64(SOFTNESS));
    let (square, other_square) = (softness + d * d, softness + other * other);
    let (root, other_root) = (square.sqrt(), other_square.sqrt());
    [d * other_root - other * root, square, other_square, other_root]
}

/// Writes a register to a row, as far as the row goes.
#[inline(always)]
fn put<S: Simd, T: Scalar>(value: Wide<S, T>, row: &mut [T], j: usize) {
    if row.len() >= j + Wide::<S, T>::lanes() {
        value.store(&mut row[j..]);
    } else {
        value.store_part(&mut row[j..]);
    }
}

/// The distances in a band.
struct Distances<'a, T> {
    size: Size,
    /// Rows of both images with margins.
    maps: [&'a [T]; 2],
    out: &'a mut [T],
}

impl<T: Scalar> WithSimd for Distances<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (Size { w, radius, .. }, stride) = (self.size, self.size.stride());
        let [x, y] = self.maps;
        let (zero, saturation) = (Wide::<S, T>::splat(simd, T::ZERO), Wide::splat(simd, T::from_f64(SATURATION)));
        for (i, out) in self.out.chunks_exact_mut(w).enumerate() {
            for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                let middle = (i + radius) * stride + j + radius;
                let (x_middle, y_middle) = (Wide::load(simd, &x[middle..]), Wide::load(simd, &y[middle..]));
                let mut sum = zero;
                for row in i..=i + 2 * radius {
                    for at in row * stride + j..=row * stride + j + 2 * radius {
                        // The middle itself adds 0 / 0.0656 = 0.
                        let (d, other) = (Wide::load(simd, &x[at..]) - x_middle, Wide::load(simd, &y[at..]) - y_middle);
                        let [n, square, other_square, _] = codes(d, other);
                        let n = n * n;
                        sum = sum + n / (saturation * (square * other_square) + n);
                    }
                }
                put(sum, out, j);
            }
        }
    }
}

/// The gradient of the first image in a band.
struct Slopes<'a, T> {
    size: Size,
    /// Rows with margins: the image, the other one, the gradient of the distance.
    maps: [&'a [T]; 3],
    out: &'a mut [T],
}

impl<T: Scalar> WithSimd for Slopes<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (Size { w, radius, .. }, stride) = (self.size, self.size.stride());
        let [x, y, g] = self.maps;
        let [zero, one] = [T::ZERO, T::ONE].map(|number| Wide::<S, T>::splat(simd, number));
        let saturation = Wide::splat(simd, T::from_f64(SATURATION));
        let factor = Wide::splat(simd, T::from_f64(-2.0 * SATURATION * SOFTNESS));
        for (i, out) in self.out.chunks_exact_mut(w).enumerate() {
            for j in (0..w).step_by(Wide::<S, T>::lanes()) {
                let middle = (i + radius) * stride + j + radius;
                let (x_middle, y_middle) = (Wide::load(simd, &x[middle..]), Wide::load(simd, &y[middle..]));
                let g_middle = Wide::load(simd, &g[middle..]);
                let mut sum = zero;
                for row in i..=i + 2 * radius {
                    for at in row * stride + j..=row * stride + j + 2 * radius {
                        let (d, other) = (Wide::load(simd, &x[at..]) - x_middle, Wide::load(simd, &y[at..]) - y_middle);
                        let [n, square, other_square, other_root] = codes(d, other);
                        let inverse = one / (saturation * (square * other_square) + n * n);
                        let g = Wide::load(simd, &g[at..]);
                        let slope = (g_middle + g) * (n * inverse) * (other_square * other_root * inverse);
                        // Pixels that no gradient reaches may hold anything.
                        sum = sum + (g_middle.abs() + g.abs()).at_most(zero).choose(zero, slope);
                    }
                }
                put(factor * sum, out, j);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    fn code(d: f64) -> f64 {
        d / (SOFTNESS + d * d).sqrt()
    }

    /// Calls `f(p, cell)` with the flat indices of every pixel and of each cell of its window, `None` outside the image.
    fn for_each_cell(shape: Shape, radius: usize, mut f: impl FnMut(usize, Option<usize>)) {
        let shifted = |i: usize, by: usize, size: usize| (i + by).checked_sub(radius).filter(|&j| j < size);
        for (row, column) in (0..shape.h()).flat_map(|row| (0..shape.w()).map(move |column| (row, column))) {
            for (by_row, by_column) in (0..=2 * radius).flat_map(|i| (0..=2 * radius).map(move |j| (i, j))) {
                let cell = shifted(row, by_row, shape.h()).zip(shifted(column, by_column, shape.w()));
                f(row * shape.w() + column, cell.map(|(r, c)| r * shape.w() + c));
            }
        }
    }

    /// The definition, and its chain rule written out cell by cell: distance, gradients to both images.
    fn by_definition([x, y, g]: [&[f64]; 3], shape: Shape, radius: usize) -> [Vec<f64>; 3] {
        let mut out = [(); 3].map(|()| vec![0.0; x.len()]);
        for_each_cell(shape, radius, |p, cell| {
            let d = [x, y].map(|map| cell.map_or(0.0, |cell| map[cell]) - map[p]);
            let e = code(d[0]) - code(d[1]);
            out[0][p] += e * e / (SATURATION + e * e);
            for (k, sign) in [(0, 1.0), (1, -1.0)] {
                let of_distance = 2.0 * SATURATION * e / (SATURATION + e * e).powi(2);
                let slope = sign * g[p] * of_distance * SOFTNESS / (SOFTNESS + d[k] * d[k]).powf(1.5);
                out[1 + k][p] -= slope;
                if let Some(cell) = cell {
                    out[1 + k][cell] += slope;
                }
            }
        });
        out
    }

    #[test]
    fn it_equals_the_definition_with_its_chain_rule() {
        for ([h, w], radius) in [([5, 7], 1), ([37, 19], 1), ([20, 33], 3), ([1, 1], 2), ([3, 40], 5)] {
            let shape = Shape::new(2, 1, h, w);
            // Greys that saturate the codes and greys that do not.
            let [x, y] = [1, 2].map(|seed| random::<f64>(seed, shape, 0.0, [3.0, 100.0][seed as usize - 1]));
            let g = random::<f64>(3, shape, -1.0, 1.0);
            let tape = Tape::new();
            let (a, b) = (tape.leaf(x.clone()), tape.leaf(y.clone()));
            let distance = census_distance(a, b, radius);
            let grads = tape.backward(distance.mul(tape.constant(g.clone())).sum());
            let found = [distance.value(), grads.wrt(a), grads.wrt(b)];
            for n in 0..2 {
                let wanted = by_definition([&x, &y, &g].map(|map| map.plane(n, 0)), shape, radius);
                for (found, wanted) in found.iter().zip(&wanted) {
                    let signal = wanted.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
                    for (f, w) in found.plane(n, 0).iter().zip(wanted) {
                        assert!((f - w).abs() <= 1e-11 * signal, "{shape} radius {radius}: {f} and {w}");
                    }
                }
            }
        }
    }

    #[test]
    fn worked_distance_of_one_edge() {
        // A step of 0.9 in one image, none in the other: both pixels of a row see d = +-0.9, c = 0.9 / sqrt(1.62), e^2 = 1/2.
        let tape = Tape::<f64>::new();
        let row = |x: &[f64]| tape.constant(Tensor::from_vec(Shape::new(1, 1, 1, 2), x.to_vec()));
        let map = census_distance(row(&[0.0, 0.9]), row(&[0.0, 0.0]), 1).value();
        // The bright pixel sees 0 also in its seven cells outside the image.
        for (h, cells) in map.data().iter().zip([1.0, 8.0]) {
            assert!((h - cells * 0.5 / 0.6).abs() < 1e-12, "{h}");
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(1, 1, 4, 3);
        let greys = [random(3, shape, 0.0, 2.0), random(4, shape, 0.0, 2.0)];
        let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
        gradcheck(&greys, |_, v| weighted_sum(census_distance(v[0], v[1], 2), 5), check).assert_ok();
    }

    #[test]
    fn windows_without_gradient_have_none_whatever_they_hold() {
        let shape = Shape::new(1, 1, 6, 20);
        let tape = Tape::new();
        let image = random::<f64>(1, shape, 0.0, 9.0);
        let a = tape.leaf(Tensor::from_fn(shape, |n, c, h, w| if w == 3 { f64::NAN } else { image.at(n, c, h, w) }));
        let distance = census_distance(a, tape.constant(random(2, shape, 0.0, 9.0)), 1);
        assert!(distance.value().at(0, 0, 2, 2).is_nan());
        let grad = tape.backward(distance.slice(3, 6, 14).sum()).wrt(a);
        let of_column = |w: usize| (0..6).map(|h| grad.at(0, 0, h, w)).collect::<Vec<_>>();
        assert!((0..5).all(|w| of_column(w).iter().all(|&g| g == 0.0)));
        assert!((5..20).all(|w| of_column(w).iter().all(|&g| g != 0.0 && g.is_finite())));
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let shape = Shape::new(2, 1, 67, 33);
        let run = |threads| {
            par::with_threads(threads, || {
                let tape = Tape::new();
                let [a, b] = [1, 2].map(|seed| tape.leaf(random::<f32>(seed, shape, 0.0, 9.0)));
                let distance = census_distance(a, b, 1);
                let grads = tape.backward(weighted_sum(distance, 3));
                [distance.value().to_vec(), grads.wrt(a).to_vec(), grads.wrt(b).to_vec()]
            })
        };
        assert!((2..5).all(|threads| run(threads) == run(1)));
    }
}

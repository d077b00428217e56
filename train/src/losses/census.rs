//! Census losses: each pixel must differ from its neighbours alike in both images, whatever the brightness.
//!
//! **Formula**: with grey values `g` from 0 to 255, for every cell of the window around `p` (grey 0 outside the image)
//! `d = g(cell) - g(p)`, `c = d / sqrt(0.81 + d^2)`; the distance of two images is
//! `h(p) = sum over cells of e^2 / (0.1 + e^2)` with `e = c_1 - c_2`. The forms differ in what they do with `h`:
//!
//! | form | window | loss | source |
//! |---|---|---|---|
//! | [`CensusForm::ArFlow`] | 3x3 | `mean(M h / 9)` | lliuz/ARFlow, `losses/loss_blocks.py` |
//! | [`CensusForm::Smurf`] | 7x7 | `sum(M (h + 0.01)^0.4) / sum(M + 1e-6)` | google-research/google-research, `smurf/` |
//! | [`CensusForm::UnFlow`] | any | `sum(M (h^2 + 0.001^2)^0.45) / (B H W)` | vt-vl-lab/DF-Net, `core/UnFlow/.../losses.py` |
//!
//! `M` is the caller's mask with a frame of the window's radius set to 0: windows there reach over the border.
//!
//! **Gradient**: to both images, none to the mask; 0 where the codes are equal and where `M` is 0. No kinks.

use dimode_autodiff::{Scalar, Shape, Tensor, Var, par};

use super::charbonnier::charbonnier;

/// Weights of red, green and blue in the grey value.
const GREY: [f64; 3] = [0.2989, 0.5870, 0.1140];
/// Square of the grey difference at which a code reaches `1 / sqrt 2`.
const SOFTNESS: f64 = 0.81;
/// Square of the code difference at which the distance reaches one half.
const SATURATION: f64 = 0.1;

/// What becomes of the census distance; see the head of this file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CensusForm {
    /// Mean over the cells of a 3x3 window, plain mean over pixels.
    ArFlow,
    /// 7x7 window, power 0.4, mean over the mask.
    Smurf,
    /// Charbonnier's penalty of the sum over the window, divided by the number of all pixels.
    UnFlow {
        /// Cells on either side of the middle: 3 on the finest of UnFlow's levels, 1 on the coarsest.
        radius: usize,
    },
}

impl CensusForm {
    /// Cells on either side of the window's middle.
    #[must_use]
    pub fn radius(self) -> usize {
        match self {
            Self::ArFlow => 1,
            Self::Smurf => 3,
            Self::UnFlow { radius } => radius,
        }
    }
}

/// Census loss of two images `[n, 3, h, w]` with colours in [0, 1]; `mask` is `[n, 1, h, w]`, 0 or 1 or a weight.
///
/// Without any pixel left the value is 0, with zero gradient.
///
/// # Panics
/// When shapes differ or the images do not have three channels.
#[track_caller]
pub fn census<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>, mask: &Tensor<T>, form: CensusForm) -> Var<'t, T> {
    let tape = a.tape();
    let distance = census_distance(grey(a), grey(b), form.radius());
    let shape = distance.shape();
    assert!(mask.shape() == shape, "census: mask {} does not go with maps {shape}", mask.shape());
    let mask = framed(mask, form.radius());
    let weight: f64 = mask.data().iter().map(|m| m.to_f64()).sum();
    let distance = distance.select(&mask, tape.constant(Tensor::zeros(shape)));
    let (penalty, divisor) = match form {
        CensusForm::ArFlow => (distance.scale(1.0 / 9.0), shape.len() as f64),
        CensusForm::Smurf => (distance.add_scalar(0.01).powf(0.4), weight + 1e-6 * shape.len() as f64),
        CensusForm::UnFlow { .. } => (charbonnier(distance, 1e-3, 0.45), shape.len() as f64),
    };
    penalty.mul(tape.constant(mask)).sum().scale(1.0 / divisor)
}

/// Grey values from 0 to 255 of images `[n, 3, h, w]`, `[n, 1, h, w]`.
///
/// # Panics
/// Unless there are three channels.
#[track_caller]
pub fn grey<T: Scalar>(image: Var<'_, T>) -> Var<'_, T> {
    assert!(image.shape().c() == 3, "grey: images have three channels, got {}", image.shape());
    let channel = |c: usize| image.slice(1, c, 1).scale(255.0 * GREY[c]);
    channel(0).add(channel(1)).add(channel(2))
}

/// The mask with 0 in a frame of `width` pixels.
#[must_use]
pub fn framed<T: Scalar>(mask: &Tensor<T>, width: usize) -> Tensor<T> {
    let s = mask.shape();
    let inside = |i: usize, size: usize| i >= width && i + width < size;
    Tensor::from_fn(s, |n, c, h, w| if inside(h, s.h()) && inside(w, s.w()) { mask.at(n, c, h, w) } else { T::ZERO })
}

/// Census distance `h` of grey images `[n, 1, h, w]`, summed over the cells of a window of `2 radius + 1` pixels a side.
///
/// One fused operation: a window of 49 cells would otherwise keep some hundred maps for the way back.
///
/// # Panics
/// When the shapes differ.
#[track_caller]
pub fn census_distance<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>, radius: usize) -> Var<'t, T> {
    let (x, y) = (a.value(), b.value());
    let shape = x.shape();
    assert!(shape == y.shape() && shape.c() == 1, "census_distance: two grey images of one shape, got {shape} and {}", y.shape());
    let mut out = a.tape().scratch(shape.len());
    par::for_each_chunk(&mut out, shape.plane(), |n, out| forward(x.plane(n, 0), y.plane(n, 0), out, shape, radius));
    let out = a.tape().tensor(shape, out);
    a.tape().push("census_distance", out, &[a, b], move |g, grads| {
        for (k, (own, other)) in [(&x, &y), (&y, &x)].into_iter().enumerate() {
            if let Some(mut slot) = grads.slot(k) {
                par::for_each_chunk(slot.as_mut_slice(), shape.plane(), |n, out| {
                    backward([own, other, g].map(|map| map.plane(n, 0)), out, shape, radius);
                });
            }
        }
    })
}

/// `c = d / sqrt(0.81 + d^2)`.
#[inline(always)]
fn code<T: Scalar>(d: T) -> T {
    d / (T::from_f64(SOFTNESS) + d * d).sqrt()
}

/// Calls `f(p, cell)` with the flat indices of every pixel and of each cell of its window, `None` for a cell outside the image.
#[inline(always)]
fn for_each_cell(shape: Shape, radius: usize, mut f: impl FnMut(usize, Option<usize>)) {
    let (h, w) = (shape.h(), shape.w());
    let shifted = |i: usize, by: usize, size: usize| (i + by).checked_sub(radius).filter(|&j| j < size);
    for by_row in 0..=2 * radius {
        for by_column in 0..=2 * radius {
            for row in 0..h {
                let other_row = shifted(row, by_row, h);
                for column in 0..w {
                    let cell = other_row.zip(shifted(column, by_column, w)).map(|(r, c)| r * w + c);
                    f(row * w + column, cell);
                }
            }
        }
    }
}

fn forward<T: Scalar>(x: &[T], y: &[T], out: &mut [T], shape: Shape, radius: usize) {
    let saturation = T::from_f64(SATURATION);
    out.fill(T::ZERO);
    for_each_cell(shape, radius, |p, cell| {
        let difference = |g: &[T]| cell.map_or(T::ZERO, |cell| g[cell]) - g[p];
        let e = code(difference(x)) - code(difference(y));
        out[p] += e * e / (saturation + e * e);
    });
}

/// Adds the gradient of the first of `[own, other, g]`; the distance is symmetric in its images.
fn backward<T: Scalar>([own, other, g]: [&[T]; 3], out: &mut [T], shape: Shape, radius: usize) {
    let (softness, saturation) = (T::from_f64(SOFTNESS), T::from_f64(SATURATION));
    let twice = T::from_f64(2.0 * SATURATION);
    for_each_cell(shape, radius, |p, cell| {
        // Masked pixels may hold anything.
        if g[p] == T::ZERO {
            return;
        }
        let difference = |g: &[T]| cell.map_or(T::ZERO, |cell| g[cell]) - g[p];
        let d = difference(own);
        let e = code(d) - code(difference(other));
        let (far, size) = (saturation + e * e, softness + d * d);
        let slope = g[p] * (twice * e / (far * far)) * (softness / (size * size.sqrt()));
        out[p] -= slope;
        if let Some(cell) = cell {
            out[cell] += slope;
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    const FORMS: [CensusForm; 3] = [CensusForm::ArFlow, CensusForm::Smurf, CensusForm::UnFlow { radius: 2 }];

    fn image(seed: u64, shape: Shape) -> Tensor<f64> {
        random(seed, shape, 0.4, 0.41)
    }

    #[test]
    fn worked_distance_of_one_edge() {
        // A step of 0.9 in one image, none in the other: both pixels of a row see d = +-0.9, c = 0.9 / sqrt(1.62), e^2 = 1/2.
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 1, 1, 2);
        let a = tape.constant(Tensor::from_vec(shape, vec![0.0, 0.9]));
        let b = tape.constant(Tensor::zeros(shape));
        let h = census_distance(a, b, 1).value();
        // The left pixel is 0 like the seven cells outside; the right one differs from them by -0.9 too.
        let one = 0.5 / 0.6;
        assert!((h.data()[0] - one).abs() < 1e-12, "{h:?}");
        assert!((h.data()[1] - 8.0 * one).abs() < 1e-12, "{h:?}");
    }

    #[test]
    fn brightness_does_not_matter_inside() {
        let shape = Shape::new(1, 3, 9, 10);
        let a = image(1, shape);
        let brighter = Tensor::from_vec(shape, a.data().iter().map(|x| x + 0.2).collect());
        let tape = Tape::<f64>::new();
        let all = Tensor::full(shape.with_c(1), 1.0);
        for form in FORMS {
            let cost = |b: &Tensor<f64>| census(tape.constant(a.clone()), tape.constant(b.clone()), &all, form).value().item();
            assert!((cost(&brighter) - cost(&a)).abs() < 1e-9, "{form:?}");
            assert!(cost(&image(2, shape)) > cost(&a) + 0.1, "{form:?}");
        }
    }

    #[test]
    fn equal_images_have_the_least_value_and_no_gradient() {
        let shape = Shape::new(2, 3, 8, 9);
        let all = Tensor::full(shape.with_c(1), 1.0);
        for (form, least) in FORMS.into_iter().zip([0.0, 0.01_f64.powf(0.4), 1e-6_f64.powf(0.45)]) {
            let tape = Tape::new();
            let (a, b) = (tape.leaf(image(1, shape)), tape.leaf(image(1, shape)));
            let loss = census(a, b, &all, form);
            let inside = framed(&all, form.radius()).data().iter().sum::<f64>() / 144.0;
            let share = if form == CensusForm::Smurf { inside / (inside + 1e-6) } else { inside };
            assert!((loss.value().item() - least * share).abs() < 1e-14, "{form:?}: {loss:?}");
            let grads = tape.backward(loss);
            assert!(grads.wrt(a).data().iter().chain(grads.wrt(b).data()).all(|&g| g == 0.0), "{form:?}");
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(2, 3, 7, 8);
        let mask = Tensor::from_fn(shape.with_c(1), |n, _, h, w| if (n + h + w) % 3 == 0 { 0.0 } else { 1.0 });
        let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
        for form in FORMS {
            gradcheck(&[image(1, shape), image(2, shape)], |_, v| census(v[0], v[1], &mask, form), check).assert_ok();
        }
        let shape = Shape::new(1, 1, 4, 3);
        let greys = [random(3, shape, 0.0, 2.0), random(4, shape, 0.0, 2.0)];
        gradcheck(&greys, |_, v| weighted_sum(census_distance(v[0], v[1], 2), 5), check).assert_ok();
    }

    #[test]
    fn masked_pixels_and_empty_masks_pass_no_gradient() {
        let shape = Shape::new(1, 3, 9, 12);
        // Only the left part counts: windows of radius 1 end at column 5.
        let left = Tensor::from_fn(shape.with_c(1), |_, _, _, w| if w < 5 { 1.0 } else { 0.0 });
        let tape = Tape::new();
        let (a, b) = (tape.leaf(image(1, shape)), tape.leaf(image(2, shape)));
        let grad = tape.backward(census(a, b, &left, CensusForm::ArFlow)).wrt(a);
        let at = |w: usize| (0..9).any(|h| grad.at(0, 0, h, w) != 0.0);
        assert_eq!((0..12).map(at).collect::<Vec<_>>(), [[true; 6], [false; 6]].concat());
        for form in FORMS {
            let loss = census(a, b, &Tensor::zeros(shape.with_c(1)), form);
            assert_eq!(loss.value().item(), 0.0);
            assert!(tape.backward(loss).wrt(a).data().iter().all(|&g| g == 0.0));
        }
    }

    #[test]
    fn the_order_of_the_batch_does_not_matter() {
        let shape = Shape::new(2, 3, 8, 8);
        let swapped = |x: &Tensor<f64>| Tensor::from_fn(shape, |n, c, h, w| x.at(1 - n, c, h, w));
        let (a, b, all) = (image(1, shape), image(2, shape), Tensor::full(shape.with_c(1), 1.0));
        let tape = Tape::<f64>::new();
        let cost = |a: Tensor<f64>, b: Tensor<f64>, form| census(tape.constant(a), tape.constant(b), &all, form).value().item();
        for form in FORMS {
            assert!((cost(a.clone(), b.clone(), form) - cost(swapped(&a), swapped(&b), form)).abs() < 1e-12);
        }
    }
}

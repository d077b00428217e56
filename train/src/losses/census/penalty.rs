//! From census distances to a loss, in one operation: `y = (sum of M f(h)) / divisor` over the pixels whose window lies inside the
//! image, with the forms of the head of the module.
//!
//! vjp: `g M f'(h) / divisor`, exactly 0 where the mask is 0 and in the frame, whatever `h` is there.

use std::ops::Range;

use dimode_autodiff::{GradSink, Scalar, Tensor, Var, par};
use pulp::{Arch, Simd, WithSimd};

use super::CensusForm;

/// Rows that are worked on together, the unit of parallel work.
const ROWS: usize = 32;
/// Partial sums.
const LANES: usize = 8;

impl CensusForm {
    /// `[f(h), f'(h)]`.
    #[inline(always)]
    fn penalty<T: Scalar>(self, h: T) -> [T; 2] {
        let number = T::from_f64;
        match self {
            Self::ArFlow => [h * number(1.0 / 9.0), number(1.0 / 9.0)],
            Self::Smurf => {
                let base = h + number(0.01);
                let power = base.powf(number(0.4));
                [power, number(0.4) * power / base]
            }
            Self::UnFlow { .. } => {
                let base = h * h + number(1e-3 * 1e-3);
                let power = base.powf(number(0.45));
                [power, number(0.9) * h * power / base]
            }
        }
    }
}

/// The loss of census distances under a mask, both `[n, 1, h, w]`.
#[track_caller]
pub(super) fn census_penalty<'t, T: Scalar>(distance: Var<'t, T>, mask: &Tensor<T>, form: CensusForm) -> Var<'t, T> {
    let (tape, x, mask, shape) = (distance.tape(), distance.value(), mask.clone(), distance.shape());
    let inside = |size: usize| form.radius()..size.saturating_sub(form.radius()).max(form.radius());
    let (rows, columns, width) = (inside(shape.h()), inside(shape.w()), shape.w());
    let bands = rows.len().div_ceil(ROWS);
    let parts = par::map_indices(shape.n() * bands, |i| {
        let first = rows.start + i % bands * ROWS;
        let maps = [&x, &mask].map(|map| map.plane(i / bands, 0));
        let rows = first..(first + ROWS).min(rows.end);
        Arch::new().dispatch(Sum { maps, rows, columns: columns.clone(), width, form })
    });
    let [cost, weight] = parts.iter().fold([0.0; 2], |[cost, weight], part| [cost + part[0], weight + part[1]]);
    let divisor = match form {
        CensusForm::Smurf => weight + 1e-6 * shape.len() as f64,
        CensusForm::ArFlow | CensusForm::UnFlow { .. } => shape.len() as f64,
    };
    let y = Tensor::scalar(T::from_f64(cost / divisor));
    tape.push("census_penalty", y, &[distance], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let share = T::from_f64(g.item().to_f64() / divisor);
        let Some(mut slot) = grads.slot(0) else { return };
        slot.write(|out| {
            par::for_each_chunk(out, width, |i, out| {
                let (n, row) = (i / shape.h(), i % shape.h());
                out.fill(T::ZERO);
                if rows.contains(&row) {
                    let maps = [&x, &mask].map(|map| &map.plane(n, 0)[row * width..][columns.clone()]);
                    Arch::new().dispatch(Slopes { maps, share, form, out: &mut out[columns.clone()] });
                }
            });
        });
    })
}

/// `[sum of M f(h), sum of M]` of some rows.
struct Sum<'a, T> {
    /// Distances and mask of a sample.
    maps: [&'a [T]; 2],
    rows: Range<usize>,
    columns: Range<usize>,
    width: usize,
    form: CensusForm,
}

impl<T: Scalar> WithSimd for Sum<'_, T> {
    type Output = [f64; 2];
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 2] {
        let (mut costs, mut weights) = ([0.0; LANES], [0.0; LANES]);
        for row in self.rows {
            let at = row * self.width + self.columns.start..row * self.width + self.columns.end;
            let (distances, mask) = (&self.maps[0][at.clone()], &self.maps[1][at]);
            let ((distances, distances_rest), (mask, mask_rest)) = (distances.as_chunks::<LANES>(), mask.as_chunks::<LANES>());
            for (distances, mask) in distances.iter().zip(mask) {
                for l in 0..LANES {
                    costs[l] += cost(distances[l], mask[l], self.form);
                    weights[l] += mask[l].to_f64();
                }
            }
            for (l, (&distance, &m)) in distances_rest.iter().zip(mask_rest).enumerate() {
                costs[l] += cost(distance, m, self.form);
                weights[l] += m.to_f64();
            }
        }
        [costs.iter().sum(), weights.iter().sum()]
    }
}

#[inline(always)]
fn cost<T: Scalar>(distance: T, mask: T, form: CensusForm) -> f64 {
    let [cost, _] = form.penalty(distance);
    let cost = (mask * cost).to_f64();
    if mask == T::ZERO { 0.0 } else { cost }
}

/// The gradient of a row, inside of the frame.
struct Slopes<'a, T> {
    maps: [&'a [T]; 2],
    share: T,
    form: CensusForm,
    out: &'a mut [T],
}

impl<T: Scalar> WithSimd for Slopes<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let [distances, mask] = self.maps;
        for ((out, &distance), &mask) in self.out.iter_mut().zip(distances).zip(mask) {
            let [_, slope] = self.form.penalty(distance);
            let slope = self.share * mask * slope;
            *out = if mask == T::ZERO { T::ZERO } else { slope };
        }
    }
}

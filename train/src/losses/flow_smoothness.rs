//! Smoothness of optical flow: first or second differences, cheap where the image has an edge.
//!
//! **Formula**: `F_x` and `I_x` are forward differences of flow and image along an axis, `F_xx` differences of differences;
//! means run over all entries, both components alike.
//!
//! | form | loss | source |
//! |---|---|---|
//! | [`FlowSmoothness::Length`] | first order of `F* = \|F\| / (mean_hw \|F\| + 1e-7)`: `mean(\|F*_x\| w_x) + mean(\|F*_y\| w_y)`, `w = exp(-mean_c \|I_x\|)` | Huangying-Zhan/DF-VO, `libs/deep_models/flow/deep_flow.py` |
//! | [`FlowSmoothness::First`] | `(mean(rho(F_x) w_x) + mean(rho(F_y) w_y)) / 2`, `w = exp(-mean_c \|edge I_x\|)` | google-research/google-research, `smurf/` |
//! | [`FlowSmoothness::Second`] | `mean(\|F_xx\| w_x) / 2 + mean(\|F_yy\| w_y) / 2`, `w = exp(-edge mean_c \|I_x\|)` of the second gap | lliuz/ARFlow, `losses/loss_blocks.py` |
//! | [`FlowSmoothness::SecondWide`] | `(mean(rho(F_xx) w_x) + mean(rho(F_yy) w_y)) / 2`, `w` from image differences over two pixels | google-research/google-research, `smurf/` |
//!
//! `rho(x) = sqrt(x^2 + 0.001^2)`.
//!
//! **Gradient**: to the flow, none to the image. The absolute value and the length have slope 0 at 0.

use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::taped::smooth::length;

use super::charbonnier::charbonnier;
use super::smoothness::{edge_weights, smoothness, steps, weighted};

/// Size below which SMURF's penalty is quadratic, pixels.
const TIP: f64 = 1e-3;

/// Which differences are penalised; see the head of this file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FlowSmoothness {
    /// First differences of the flow's length divided by its mean. DF-VO weighs it 0.1.
    Length,
    /// First differences. SMURF: edge 150, weight 2 to 2.5.
    First {
        /// Sharpness of the edge weight.
        edge: f64,
    },
    /// Second differences. ARFlow: edge 10, weight 75 on flow divided by the shorter side.
    Second {
        /// Sharpness of the edge weight.
        edge: f64,
    },
    /// Second differences with the image difference taken across both gaps. SMURF: edge 150, weight 2.
    SecondWide {
        /// Sharpness of the edge weight.
        edge: f64,
    },
}

/// Smoothness of flows `[n, 2, h, w]`, pixels, under images `[n, c, h, w]`; one number.
///
/// # Panics
/// When sizes differ or a side is too short for the differences (2 pixels, or 3 for second ones).
#[track_caller]
pub fn flow_smoothness<'t, T: Scalar>(flow: Var<'t, T>, images: &Tensor<T>, form: FlowSmoothness) -> Var<'t, T> {
    let (f, i) = (flow.shape(), images.shape());
    let least = if matches!(form, FlowSmoothness::Length | FlowSmoothness::First { .. }) { 2 } else { 3 };
    assert!(
        f.n() == i.n() && f.h() == i.h() && f.w() == i.w() && f.h().min(f.w()) >= least,
        "flow_smoothness: flow {f} and images {i} must have equal sizes of at least {least} x {least}"
    );
    let robust = |x: Var<'t, T>| charbonnier(x, TIP, 0.5);
    let both = |penalty: &dyn Fn(usize) -> Var<'t, T>, gap: [usize; 2], edge: f64| {
        let [rows, columns] =
            [2, 3].map(|axis| weighted(penalty(axis), flow.tape().constant(edge_weights(images, axis, gap, edge))));
        rows.add(columns).scale(0.5)
    };
    match form {
        FlowSmoothness::Length => smoothness(length(flow.slice(1, 0, 1), flow.slice(1, 1, 1), 0.0), images),
        FlowSmoothness::First { edge } => both(&|axis| robust(steps(flow, axis)), [0, 1], edge),
        FlowSmoothness::Second { edge } => both(&|axis| second(flow, axis).abs(), [1, 2], edge),
        FlowSmoothness::SecondWide { edge } => both(&|axis| robust(second(flow, axis)), [0, 2], edge),
    }
}

fn second<T: Scalar>(x: Var<'_, T>, axis: usize) -> Var<'_, T> {
    steps(steps(x, axis), axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    const FORMS: [FlowSmoothness; 4] = [
        FlowSmoothness::Length,
        FlowSmoothness::First { edge: 150.0 },
        FlowSmoothness::Second { edge: 10.0 },
        FlowSmoothness::SecondWide { edge: 150.0 },
    ];

    fn cost(flow: &Tensor<f64>, image: &Tensor<f64>, form: FlowSmoothness) -> f64 {
        flow_smoothness(Tape::new().constant(flow.clone()), image, form).value().item()
    }

    #[test]
    fn worked_values_on_a_flat_image() {
        let shape = Shape::new(1, 2, 3, 4);
        let image = Tensor::full(Shape::new(1, 3, 3, 4), 0.4);
        // u = w^2: first differences 1, 3, 5 along rows, second ones 2; v = 0.
        let flow = Tensor::from_fn(shape, |_, c, _, w| if c == 0 { (w * w) as f64 } else { 0.0 });
        let rho = |x: f64| (x * x + 1e-6).sqrt();
        let first = ((rho(1.0) + rho(3.0) + rho(5.0)) / 3.0 + rho(0.0)) / 2.0;
        let expected = [3.0 / 3.5, (first + rho(0.0)) / 2.0, 2.0 / 2.0 / 2.0, ((rho(2.0) + rho(0.0)) / 2.0 + rho(0.0)) / 2.0];
        for (form, expected) in FORMS.into_iter().zip(expected) {
            let found = cost(&flow, &image, form);
            assert!((found - expected).abs() < 1e-6, "{form:?}: {found} against {expected}");
        }
    }

    #[test]
    fn an_edge_of_the_image_excuses_a_step_of_the_flow() {
        let step =
            |low: f64, high: f64, c: usize| Tensor::from_fn(Shape::new(1, c, 4, 6), |_, _, _, w| if w < 3 { low } else { high });
        let flow = step(1.0, 3.0, 2);
        for form in FORMS {
            let (flat, edged) = (cost(&flow, &step(0.5, 0.5, 3), form), cost(&flow, &step(0.0, 1.0, 3), form));
            // The first of the two gaps of a second difference has no edge, and Second looks at the second one only.
            let share = if matches!(form, FlowSmoothness::Second { .. }) { 0.51 } else { 0.4 };
            assert!(edged < share * flat, "{form:?}: {edged} against {flat}");
        }
    }

    #[test]
    fn second_forms_let_a_slope_pass_and_the_length_form_has_no_unit() {
        let shape = Shape::new(1, 2, 5, 6);
        let image = random::<f64>(4, Shape::new(1, 3, 5, 6), 0.0, 1.0);
        let slope = Tensor::from_fn(shape, |_, c, h, w| 0.3 * h as f64 - 0.2 * w as f64 + c as f64);
        assert!(cost(&slope, &image, FORMS[2]) < 1e-12);
        let still = cost(&Tensor::zeros(shape), &image, FORMS[3]);
        assert!((cost(&slope, &image, FORMS[3]) - still).abs() < 1e-12);
        let flow = random::<f64>(5, shape, 1.0, 3.0);
        let doubled = Tensor::from_vec(shape, flow.data().iter().map(|f| 2.0 * f).collect());
        assert!((cost(&flow, &image, FORMS[0]) - cost(&doubled, &image, FORMS[0])).abs() < 1e-7);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let flow = random::<f64>(1, Shape::new(2, 2, 4, 5), -2.0, 2.0);
        let image = random::<f64>(2, Shape::new(2, 3, 4, 5), 0.4, 0.41);
        let check = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };
        for form in FORMS {
            gradcheck(std::slice::from_ref(&flow), |_, v| flow_smoothness(v[0], &image, form), check).assert_ok();
        }
    }

    #[test]
    fn no_flow_has_no_gradient() {
        let image = random::<f64>(2, Shape::new(1, 3, 4, 5), 0.0, 1.0);
        for form in FORMS {
            let tape = Tape::<f64>::new();
            let flow = tape.leaf(Tensor::zeros(Shape::new(1, 2, 4, 5)));
            let loss = flow_smoothness(flow, &image, form);
            assert!(loss.value().item() <= TIP);
            assert!(tape.backward(loss).wrt(flow).data().iter().all(|&g| g == 0.0), "{form:?}");
        }
    }

    #[test]
    #[should_panic(expected = "equal sizes of at least 3 x 3")]
    fn second_differences_of_two_rows_are_refused() {
        cost(&Tensor::zeros(Shape::new(1, 2, 2, 5)), &Tensor::zeros(Shape::new(1, 3, 2, 5)), FORMS[2]);
    }
}

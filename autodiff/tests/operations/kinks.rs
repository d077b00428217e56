//! Every kink: the slope on both sides, and the subgradient that the operation documents for the kink itself.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Shape, Tape, Tensor, Var};

/// A function of one number.
type Function = for<'t> fn(Var<'t, f64>) -> Var<'t, f64>;

/// Distance from the kink to the points at its sides.
const ASIDE: f64 = 0.125;

/// `(operation, place of the kink, function, slopes at the left, at the kink, at the right)`.
type Row = (&'static str, f64, Function, [f64; 3]);

fn constant<'t>(x: Var<'t, f64>, values: &[f64]) -> Var<'t, f64> {
    x.tape().constant(Tensor::from_vec(Shape::new(1, 1, 1, values.len()), values.to_vec()))
}

/// `x` before a constant, side by side.
fn before<'t>(x: Var<'t, f64>, other: f64) -> Var<'t, f64> {
    Var::concat(&[x, constant(x, &[other])], 3)
}

/// `x` after a constant, side by side.
fn after<'t>(x: Var<'t, f64>, other: f64) -> Var<'t, f64> {
    Var::concat(&[constant(x, &[other]), x], 3)
}

/// The row of pixels 4, 1, 3 read at column `u`.
fn sampled<'t>(u: Var<'t, f64>, padding: SamplePadding) -> Var<'t, f64> {
    constant(u, &[4.0, 1.0, 3.0]).bilinear_sample(Var::concat(&[u, constant(u, &[0.0])], 1), padding)
}

fn slope(f: Function, at: f64) -> f64 {
    let tape = Tape::new();
    let x = tape.leaf(Tensor::scalar(at));
    tape.backward(f(x).sum()).wrt(x).item()
}

fn difference(f: Function, at: f64) -> f64 {
    let value = |x| f(Tape::new().constant(Tensor::scalar(x))).sum().value().item();
    (value(at + 1e-5) - value(at - 1e-5)) / 2e-5
}

#[test]
fn slopes_beside_kinks_and_on_them_are_those_documented() {
    let border: Function = |u| sampled(u, SamplePadding::Border);
    let zeros: Function = |u| sampled(u, SamplePadding::Zeros);
    let steep = (-ASIDE).exp();
    let root = 0.5 / (0.25 + ASIDE).sqrt();
    let share = -0.5 / (1.0 + ASIDE + 0.5_f64).powi(2);
    let inverse = |b: f64| -1.0 / (b * b);
    let rows: Vec<Row> = vec![
        ("relu", 0.0, |x| x.relu(), [0.0, 0.0, 1.0]),
        ("elu", 0.0, |x| x.elu(), [steep, 1.0, 1.0]),
        ("abs", 0.0, |x| x.abs(), [-1.0, 0.0, 1.0]),
        ("clamp, below", -1.0, |x| x.clamp(-1.0, 1.0), [0.0, 1.0, 1.0]),
        ("clamp, above", 1.0, |x| x.clamp(-1.0, 1.0), [1.0, 1.0, 0.0]),
        ("sqrt_guarded", 0.25, |x| x.sqrt_guarded(0.25), [0.0, 1.0, root]),
        ("maximum, left", 0.5, |x| x.maximum(constant(x, &[0.5])), [0.0, 0.5, 1.0]),
        ("maximum, right", 0.5, |x| constant(x, &[0.5]).maximum(x), [0.0, 0.5, 1.0]),
        ("minimum, left", 0.5, |x| x.minimum(constant(x, &[0.5])), [1.0, 0.5, 0.0]),
        ("minimum, right", 0.5, |x| constant(x, &[0.5]).minimum(x), [1.0, 0.5, 0.0]),
        ("weighted_l1, left", 0.5, |x| x.weighted_l1(constant(x, &[0.5]), &Tensor::scalar(1.0), 0.0), [-1.0, 0.0, 1.0]),
        ("weighted_l1, right", 0.5, |x| constant(x, &[0.5]).weighted_l1(x, &Tensor::scalar(1.0), 0.0), [-1.0, 0.0, 1.0]),
        ("max_axis, first", 0.5, |x| before(x, 0.5).max_axis(3).values, [0.0, 1.0, 1.0]),
        ("max_axis, second", 0.5, |x| after(x, 0.5).max_axis(3).values, [0.0, 0.0, 1.0]),
        ("min_axis, first", 0.5, |x| before(x, 0.5).min_axis(3).values, [1.0, 1.0, 0.0]),
        ("min_axis, second", 0.5, |x| after(x, 0.5).min_axis(3).values, [1.0, 0.0, 0.0]),
        ("max_pool2d, first", 0.5, |x| before(x, 0.5).broadcast_to(Shape::new(1, 1, 2, 2)).max_pool2d(2, 2, 0), [0.0, 1.0, 1.0]),
        ("max_pool2d, second", 0.5, |x| after(x, 0.5).broadcast_to(Shape::new(1, 1, 2, 2)).max_pool2d(2, 2, 0), [0.0, 0.0, 1.0]),
        // Three entries 0, x, 1 over R = max + 0.5: at x = 1 two are the largest and share what belongs to the maximum.
        (
            "min_max",
            1.0,
            |x| Var::concat(&[constant(x, &[0.0]), x, constant(x, &[1.0])], 3).min_max(0.5),
            [1.0 / 1.5, 1.0 / 1.5 - 0.5 * (4.0 / 3.0) / 1.5, share],
        ),
        ("l2_normalise", 0.5, |x| x.l2_normalise(3, 0.5), [2.0, 2.0, 0.0]),
        ("div_guarded, above", 0.5, |x| constant(x, &[1.0]).div_guarded(x, 0.5), [0.0, -4.0, inverse(0.5 + ASIDE)]),
        ("div_guarded, below", -0.5, |x| constant(x, &[1.0]).div_guarded(x, 0.5), [inverse(0.5 + ASIDE), -4.0, 0.0]),
        ("div_guarded, zero", 0.0, |x| constant(x, &[1.0]).div_guarded(x, 0.5), [0.0, 0.0, 0.0]),
        ("atan2, origin", 0.0, |x| x.atan2(constant(x, &[0.0])), [0.0, 0.0, 0.0]),
        ("bilinear_sample, pixel", 1.0, border, [-3.0, 2.0, 2.0]),
        ("bilinear_sample, left border", 0.0, border, [0.0, 0.0, -3.0]),
        ("bilinear_sample, right border", 2.0, border, [2.0, 0.0, 0.0]),
        ("bilinear_sample, zeros at the left", -1.0, zeros, [0.0, 4.0, 4.0]),
        ("bilinear_sample, zeros at the right", 3.0, zeros, [-3.0, 0.0, 0.0]),
    ];
    for (op, kink, f, expected) in rows {
        for (place, want) in [-1.0, 0.0, 1.0].into_iter().zip(expected) {
            let at = kink + place * ASIDE;
            let found = slope(f, at);
            assert!((found - want).abs() <= 1e-12 * want.abs().max(1.0), "{op} at {at}: slope {found}, documented {want}");
            if place != 0.0 {
                let difference = difference(f, at);
                assert!((found - difference).abs() <= 1e-8, "{op} at {at}: slope {found}, differences {difference}");
            }
        }
    }
}

#[test]
fn infinite_slopes_show() {
    let rows: [(&str, f64, Function, f64); 4] = [
        ("sqrt", 0.0, |x| x.sqrt(), f64::INFINITY),
        ("powf", 0.0, |x| x.powf(0.5), f64::INFINITY),
        ("acos", 1.0, |x| x.acos(), f64::NEG_INFINITY),
        ("acos", -1.0, |x| x.acos(), f64::NEG_INFINITY),
    ];
    for (op, at, f, expected) in rows {
        assert_eq!(slope(f, at), expected, "{op} at {at}");
    }
}

//! L05: the photometric loss.

use dimode_autodiff::proof::{Number, total};
use dimode_autodiff::{Shape, Tensor, Var};

use crate::ledger::{Claim, Draw, Findings, Trial, Verdict, forward, taped};
use crate::photometric::{ALPHA, C1, C2, Moments, channel_error_gradient, dissimilarity, photometric_error};

pub(super) static CLAIM: Claim = Claim {
    id: "L05",
    slug: "photometric",
    place: "eq. photometric_loss",
    statement: "L = alpha (1 - SSIM) / 2 + (1 - alpha) |I' - I|_1 with alpha = 0.85.",
    verdict: Verdict::Exact,
    condition: Some("the first factor is clamped to [0, 1], the norm is the mean over the channels of a pixel"),
    formula: "SSIM = (2 m_x m_y + C_1) (2 s_xy + C_2) / [(m_x^2 + m_y^2 + C_1) (s_x^2 + s_y^2 + C_2)]",
    derivation: "A definition. 2 m_x m_y <= m_x^2 + m_y^2 and 2 |s_xy| <= s_x^2 + s_y^2, so SSIM lies in [-1, 1] and the first \
                 factor in [0, 1]; in floating point it can leave that interval by rounding. For equal windows the loss is 0. \
                 Training computes it in geometry/src/image_losses/photometric.rs.",
    counter_example: None,
    correction: None,
    functions: &[
        "photometric::Moments::of",
        "photometric::Moments::similarity",
        "photometric::similarity_gradient",
        "photometric::channel_error_gradient",
        "photometric::dissimilarity",
        "photometric::photometric_error",
    ],
    taped: &[],
    missing_way: None,
    check,
};

const CHANNELS: usize = 3;
/// Colours of a window of 3 x 3 pixels.
const WINDOW: usize = 9;
const COLOURS: usize = CHANNELS * WINDOW;
/// Place of the pixel in its window.
const CENTRE: usize = 4;

/// Windows of 3 x 3 pixels in three channels: one image, and how the other departs from it.
#[derive(Debug)]
struct Input {
    y: [f64; COLOURS],
    departure: [f64; COLOURS],
    size: f64,
}

impl Input {
    fn draw(draw: &mut Draw) -> Self {
        Self {
            y: std::array::from_fn(|_| draw.uniform(0.0, 1.0)),
            departure: std::array::from_fn(|_| draw.uniform(-1.0, 1.0)),
            size: draw.log_uniform(1e-3, 1.0),
        }
    }

    fn x(&self) -> [f64; COLOURS] {
        std::array::from_fn(|i| (self.y[i] + self.size * self.departure[i]).clamp(0.0, 1.0))
    }
}

fn check(trial: &mut Trial) {
    for _ in 0..trial.samples {
        at(&Input::draw(&mut trial.draw), &mut trial.findings);
    }
    trial.count(trial.samples);
    let similarity = Moments::of(&[0.4; WINDOW], &[0.5; WINDOW]).similarity(C1, C2);
    trial.findings.documented("SSIM of constant windows 0.4 and 0.5, documented", similarity, 0.975615703487, 1e-11);
    let loss = photometric_error(&[similarity], &[0.4 - 0.5], ALPHA);
    trial.findings.documented("loss of constant windows 0.4 and 0.5, documented", loss, 0.025363326018, 1e-11);
    for _ in 0..200 {
        let input = Input { size: 1e-9, ..Input::draw(&mut trial.draw) };
        let factor = dissimilarity(similarities(&input.x(), &input.y)[0]);
        trial.findings.residual("windows that hardly differ: first factor, clamped", factor, 1e-14);
        trial.findings.residual("windows that hardly differ: first factor beyond [0, 1]", factor - factor.clamp(0.0, 1.0), 0.0);
    }
}

/// The windows of the channels.
fn windows(x: &[f64; COLOURS]) -> impl Iterator<Item = &[f64]> {
    x.chunks_exact(WINDOW)
}

fn similarities(x: &[f64; COLOURS], y: &[f64; COLOURS]) -> Vec<f64> {
    windows(x).zip(windows(y)).map(|(x, y)| Moments::of(x, y).similarity(C1, C2)).collect()
}

fn differences(x: &[f64; COLOURS], y: &[f64; COLOURS]) -> Vec<f64> {
    windows(x).zip(windows(y)).map(|(x, y)| x[CENTRE] - y[CENTRE]).collect()
}

fn at(input: &Input, f: &mut Findings) {
    let (x, y) = (input.x(), &input.y);
    let (s, d) = (similarities(&x, y), differences(&x, y));
    let loss = photometric_error(&s, &d, ALPHA);
    for &s in &s {
        f.residual("SSIM beyond [-1, 1]", s - s.clamp(-1.0, 1.0), 1e-14);
    }
    f.residual("loss beyond [0, 1]", loss - loss.clamp(0.0, 1.0), 0.0);
    f.residual("loss of a window with itself", photometric_error(&similarities(&x, &x), &differences(&x, &x), ALPHA), 1e-15);
    let back = photometric_error(&similarities(y, &x), &differences(y, &x), ALPHA);
    f.residual("loss - loss with the images exchanged", loss - back, 1e-14);
    let alone = photometric_error(&s[..1], &d[..1], ALPHA);
    f.residual(
        "loss of a grey pixel - that of its three equal channels",
        photometric_error(&[s[0]; 3], &[d[0]; 3], ALPHA) - alone,
        1e-15,
    );
    f.residual("loss - loss from raw moments", loss - written_out(x, *y), 1e-12);
    // |I' - I| has no slope at equal colours.
    if d.iter().all(|d| d.abs() > 1e-5) {
        slopes(&x, y, loss, f);
    }
}

/// Derivatives by all colours of the warped image.
fn slopes(x: &[f64; COLOURS], y: &[f64; COLOURS], loss: f64, f: &mut Findings) {
    let fixed = forward::fixed(*y);
    let dual = forward::jacobian(*x, |x| [written_out(x, fixed)]);
    let central = forward::central(*x, [1e-6; COLOURS], |x| [written_out(x, *y)]);
    let tensor = |values: &[f64; COLOURS]| Tensor::from_vec(Shape::new(1, CHANNELS, 3, 3), values.to_vec());
    let (taped, rows) = taped::jacobian(&[tensor(x)], |v| on_the_tape(v[0], v[0].tape().constant(tensor(y))));
    f.residual("loss - loss on the tape", loss - taped[0], 1e-12);
    // The largest derivative is at least that of the absolute difference, 0.05 a channel.
    f.derivative("dL/dI'", &gradient(x, y), Some(&dual), Some(&rows[0]), Some(&central), 0.05);
}

/// Derivatives of the loss in closed form, where the clamp is not active.
fn gradient(x: &[f64; COLOURS], y: &[f64; COLOURS]) -> Vec<f64> {
    let slopes = windows(x).zip(windows(y)).flat_map(|(x, y)| channel_error_gradient(x, y, CENTRE, ALPHA));
    slopes.map(|slope| slope / CHANNELS as f64).collect()
}

/// The loss once more, variances as means of squares minus squared means.
fn written_out<N: Number>(x: [N; COLOURS], y: [N; COLOURS]) -> N {
    let c = N::constant;
    let mean = |terms: &mut dyn Iterator<Item = N>| total(terms) / c(WINDOW as f64);
    let channel = |k: usize| {
        let (x, y) = (&x[k * WINDOW..][..WINDOW], &y[k * WINDOW..][..WINDOW]);
        let product = |a: &[N], b: &[N]| mean(&mut a.iter().zip(b).map(|(&a, &b)| a * b));
        let (mx, my) = (mean(&mut x.iter().copied()), mean(&mut y.iter().copied()));
        let spread = product(x, x) - mx * mx + product(y, y) - my * my;
        let above = (c(2.0) * mx * my + c(C1)) * (c(2.0) * (product(x, y) - mx * my) + c(C2));
        let similarity = above / ((mx * mx + my * my + c(C1)) * (spread + c(C2)));
        let structure = ((N::one() - similarity) / c(2.0)).max(N::zero()).min(N::one());
        c(ALPHA) * structure + c(1.0 - ALPHA) * (x[CENTRE] - y[CENTRE]).abs()
    };
    total((0..CHANNELS).map(channel)) / c(CHANNELS as f64)
}

/// The loss from single operations of the tape.
fn on_the_tape<'t>(x: Var<'t, f64>, y: Var<'t, f64>) -> Var<'t, f64> {
    let mean = |v: Var<'t, f64>| v.mean_to(Shape::new(1, CHANNELS, 1, 1));
    let (mx, my) = (mean(x), mean(y));
    let covariance = mean(x.mul(y)).sub(mx.mul(my));
    let spread = mean(x.square()).sub(mx.square()).add(mean(y.square()).sub(my.square()));
    let above = mx.mul(my).scale(2.0).add_scalar(C1).mul(covariance.scale(2.0).add_scalar(C2));
    let below = mx.square().add(my.square()).add_scalar(C1).mul(spread.add_scalar(C2));
    let structure = above.div(below).neg().add_scalar(1.0).scale(0.5).clamp(0.0, 1.0);
    let centre = |v: Var<'t, f64>| v.slice(2, 1, 1).slice(3, 1, 1);
    let colour = centre(x).sub(centre(y)).abs();
    structure.scale(ALPHA).add(colour.scale(1.0 - ALPHA)).mean_channels()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    fn colours(lo: f64, hi: f64) -> impl Strategy<Value = [f64; COLOURS]> {
        prop::collection::vec(lo..hi, COLOURS).prop_map(|v| std::array::from_fn(|i| v[i]))
    }

    fn input() -> impl Strategy<Value = Input> {
        (colours(0.0, 1.0), colours(-1.0, 1.0), -7.0f64..0.0).prop_map(|(y, departure, size)| Input {
            y,
            departure,
            size: size.exp(),
        })
    }

    proptest! {
        #[test]
        fn holds_everywhere(input in input()) {
            holds(|f| at(&input, f))?;
        }

        #[test]
        fn holds_for_equal_and_for_hardly_different_windows(
            input in input(),
            size in prop::sample::select(vec![0.0, 1e-12, 1e-9, 1e-7]),
        ) {
            let input = Input { size, ..input };
            let (x, y) = (input.x(), &input.y);
            let loss = photometric_error(&similarities(&x, y), &differences(&x, y), ALPHA);
            prop_assert!((0.0..1e-6).contains(&loss));
            prop_assert!((loss - written_out(x, *y)).abs() < 1e-12);
        }

        #[test]
        fn flat_windows_differ_by_their_means_alone(a in 0.0f64..1.0, b in 0.0f64..1.0) {
            let expected = (2.0 * a * b + C1) / (a * a + b * b + C1);
            prop_assert!((Moments::of(&[a; WINDOW], &[b; WINDOW]).similarity(C1, C2) - expected).abs() < 1e-13);
        }
    }

    #[test]
    fn windows_that_hardly_differ_need_the_clamp() {
        let mut draw = Draw::new(1, "hardly");
        let drawn = (0..200).map(|_| Input { size: 1e-9, ..Input::draw(&mut draw) });
        let largest = drawn.map(|input| similarities(&input.x(), &input.y)[0]).fold(0.0, f64::max);
        assert!(largest > 1.0 && dissimilarity(largest) == 0.0, "{largest}");
    }
}

//! L04: the warp.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::proof::{Number, total};
use dimode_autodiff::{Shape, Tape, Tensor};
use nalgebra::Vector2;

use crate::ledger::{Claim, Draw, Findings, Trial, Verdict, forward, taped};
use crate::taped::{masks, warp};
use crate::warp::Image;

pub(super) static CLAIM: Claim = Claim {
    id: "L04",
    slug: "warp",
    place: "unnumbered warp equation",
    statement: "The target is made again from the source image by reading it where the flow leads.",
    verdict: Verdict::Exact,
    condition: Some("p + f(p) lies in [0, W - 1] x [0, H - 1]; other pixels are masked, not clamped in silence"),
    formula: "I'_t(p) = I_s(p + f(p)), bilinear between the four pixels around",
    derivation: "A definition. Bilinear reading meets the pixels themselves, so no flow changes nothing and a flow of whole \
                 pixels is a shift; it is linear in the image, and its slope is the difference of the neighbours.",
    counter_example: None,
    correction: None,
    functions: &["warp::Image::read", "warp::Image::slope", "warp::Image::warped"],
    taped: &["taped::warp", "taped::masks::in_view"],
    missing_way: None,
    check,
};

const WIDTH: usize = 6;
const HEIGHT: usize = 5;
const PIXELS: usize = WIDTH * HEIGHT;

/// Images of one size, a flow, and a shift by whole pixels.
#[derive(Debug)]
struct Input {
    image: [f64; PIXELS],
    other: [f64; PIXELS],
    flow: [[f64; 2]; PIXELS],
    shift: [f64; 2],
}

impl Input {
    fn draw(draw: &mut Draw) -> Self {
        Self {
            image: std::array::from_fn(|_| draw.uniform(0.0, 1.0)),
            other: std::array::from_fn(|_| draw.uniform(0.0, 1.0)),
            flow: std::array::from_fn(|_| [draw.uniform(-2.0, 2.0), draw.uniform(-2.0, 2.0)]),
            shift: [draw.uniform(-4.0, 4.0).round(), draw.uniform(-4.0, 4.0).round()],
        }
    }

    fn flow(&self) -> Vec<Vector2<f64>> {
        self.flow.map(Vector2::from).to_vec()
    }
}

fn check(trial: &mut Trial) {
    for _ in 0..trial.samples.div_ceil(PIXELS) {
        at(&Input::draw(&mut trial.draw), &mut trial.findings);
        trial.count(PIXELS);
    }
    let row = [0.2, 0.9];
    let clamped = taped_warp(&row, &[Vector2::new(2.0, 0.0); 2], [1, 2], SamplePadding::Border);
    let outside = Image::new(&row, 2).warped(&[Vector2::new(2.0, 0.0); 2]);
    let bright = if outside == [None, None] { clamped[0] } else { 0.0 };
    trial.findings.gap("colour that clamping would bring in from outside, without a mask", bright, 0.8);
}

fn at(input: &Input, f: &mut Findings) {
    let (image, flow) = (Image::new(&input.image, WIDTH), input.flow());
    let values = image.warped(&flow);
    let mask = mask(&flow);
    for (i, value) in values.iter().enumerate() {
        let p = image.shifted(i, &flow[i]);
        f.residual("mask - pixel is read inside the image", mask.data()[i] - f64::from(u8::from(value.is_some())), 0.0);
        if let Some(value) = value {
            f.residual("bilinear - sum of hat functions", value - hats(&input.image, p.into()), 1e-14);
        }
    }
    for padding in [SamplePadding::Border, SamplePadding::Zeros] {
        for (taped, value) in taped_warp(&input.image, &flow, [HEIGHT, WIDTH], padding).iter().zip(&values) {
            if let Some(value) = value {
                f.residual("bilinear - tape, either padding, inside", value - taped, 1e-14);
            }
        }
    }
    shifts(input, &image, f);
    slopes(input, &image, &mask, f);
}

/// No flow is the identity, whole pixels are a shift.
fn shifts(input: &Input, image: &Image, f: &mut Findings) {
    for (i, value) in image.warped(&[Vector2::zeros(); PIXELS]).iter().enumerate() {
        f.residual("no flow: warped - image", value.unwrap_or(f64::NAN) - input.image[i], 0.0);
    }
    let shift = Vector2::from(input.shift);
    for (i, value) in image.warped(&[shift; PIXELS]).iter().enumerate() {
        let [u, v] = [(i % WIDTH) as f64 + shift.x, (i / WIDTH) as f64 + shift.y];
        let inside = (0.0..WIDTH as f64).contains(&u) && (0.0..HEIGHT as f64).contains(&v);
        let expected = inside.then(|| input.image[v as usize * WIDTH + u as usize]);
        let gap = match (value, expected) {
            (Some(a), Some(b)) => a - b,
            (None, None) => 0.0,
            _ => f64::NAN,
        };
        f.residual("flow of whole pixels: warped - shifted image", gap, 0.0);
    }
}

/// Derivatives of the masked warp by flow and image.
fn slopes(input: &Input, image: &Image, mask: &Tensor<f64>, f: &mut Findings) {
    let flow = input.flow();
    let inputs = [plane(&input.image, [HEIGHT, WIDTH]), flow_tensor(&flow, [HEIGHT, WIDTH])];
    let (_, rows) =
        taped::jacobian(&inputs, |v| warp(v[0], v[1], SamplePadding::Border).mul(v[0].tape().constant(mask.clone())).sum());
    let (by_image, by_flow) = rows[0].split_at(PIXELS);
    for i in 0..PIXELS {
        let (p, tape) = (image.shifted(i, &flow[i]), [by_flow[i], by_flow[PIXELS + i]]);
        let Some(slope) = image.slope(&p) else {
            f.residual("masked pixel: derivative by the flow", tape[0].abs() + tape[1].abs(), 0.0);
            continue;
        };
        // On rows and columns of pixels there are two slopes.
        if p.iter().all(|x| (x - x.round()).abs() > 1e-4) {
            let dual = forward::jacobian(p.into(), |p| [hats(&input.image, p)]);
            let central = forward::central(p.into(), [1e-6; 2], |p| [hats(&input.image, p)]);
            f.derivative("dI'/df, colours of size 1", slope.as_slice(), Some(&dual), Some(&tape), Some(&central), 1.0);
        }
    }
    let sum = |values: Vec<Option<f64>>| values.into_iter().flatten().sum::<f64>();
    let expected = sum(Image::new(&input.other, WIDTH).warped(&flow));
    let found: f64 = by_image.iter().zip(&input.other).map(|(a, b)| a * b).sum();
    f.residual("linear in the image: derivative by the image, times another image - that image warped", found - expected, 1e-12);
}

/// Bilinear reading as a sum over all pixels: weight `max(0, 1 - |u - i|) max(0, 1 - |v - j|)` on pixel `(i, j)`.
fn hats<N: Number>(image: &[f64; PIXELS], [u, v]: [N; 2]) -> N {
    let hat = |x: N, i: usize| N::zero().max(N::one() - (x - N::constant(i as f64)).abs());
    total(image.iter().enumerate().map(|(k, &value)| hat(u, k % WIDTH) * hat(v, k / WIDTH) * N::constant(value)))
}

fn plane(values: &[f64], [h, w]: [usize; 2]) -> Tensor<f64> {
    Tensor::from_vec(Shape::new(1, 1, h, w), values.to_vec())
}

fn flow_tensor(flow: &[Vector2<f64>], [h, w]: [usize; 2]) -> Tensor<f64> {
    let channels = [0, 1].map(|k| flow.iter().map(|f| f[k]).collect::<Vec<_>>());
    Tensor::from_vec(Shape::new(1, 2, h, w), channels.concat())
}

fn taped_warp(image: &[f64], flow: &[Vector2<f64>], size: [usize; 2], padding: SamplePadding) -> Vec<f64> {
    let tape = Tape::new();
    warp(tape.constant(plane(image, size)), tape.constant(flow_tensor(flow, size)), padding).value().to_vec()
}

fn mask(flow: &[Vector2<f64>]) -> Tensor<f64> {
    masks::in_view(&flow_tensor(flow, [HEIGHT, WIDTH]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    fn colours() -> impl Strategy<Value = [f64; PIXELS]> {
        prop::collection::vec(0.0f64..1.0, PIXELS).prop_map(|v| std::array::from_fn(|i| v[i]))
    }

    fn input(size: f64) -> impl Strategy<Value = Input> {
        let flow = prop::collection::vec(prop::array::uniform2(-size..size), PIXELS);
        let shift = prop::array::uniform2(-4i32..=4);
        (colours(), colours(), flow, shift).prop_map(|(image, other, flow, shift)| Input {
            image,
            other,
            flow: std::array::from_fn(|i| flow[i]),
            shift: shift.map(f64::from),
        })
    }

    proptest! {
        #[test]
        fn holds_for_flows_of_pixels(input in input(3.0)) {
            holds(|f| at(&input, f))?;
        }

        #[test]
        fn holds_for_small_and_for_large_flows(small in input(1e-9), large in input(1e6)) {
            holds(|f| at(&small, f))?;
            holds(|f| at(&large, f))?;
        }
    }
}

//! The products of every network at its reference size, in `f32`, against plain loops in `f64`.
//!
//! Blocked kernels and the linear algebra library choose another way for other sizes, so sizes of their own are not enough.
//! Whole plain loops would take hours; entries are drawn, among them the corners.

use dimode_autodiff::gemm::{GemmScalar, View};
use dimode_autodiff::gradcheck::random;
use dimode_autodiff::{Conv2d, PadMode, Shape, Tape, Tensor};

/// A convolution: name, input channels, output channels, kernel, attributes, size of the input.
type Layer = (&'static str, usize, usize, (usize, usize), Conv2d, (usize, usize));

const PLAIN: Conv2d = Conv2d { stride: (1, 1), padding: (1, 1), dilation: (1, 1), groups: 1, pad_mode: PadMode::Zero };
const POINT: Conv2d = Conv2d { padding: (0, 0), ..PLAIN };
const REFLECT: Conv2d = Conv2d { pad_mode: PadMode::Reflect, ..PLAIN };
const STRIDED: Conv2d = Conv2d { stride: (2, 2), ..PLAIN };
const STEM: Conv2d = Conv2d { padding: (3, 3), ..STRIDED };

const fn depthwise(channels: usize, dilation: usize) -> Conv2d {
    Conv2d { padding: (dilation, dilation), dilation: (dilation, dilation), groups: channels, ..PLAIN }
}

/// One layer of every kind and of the narrowest and widest sizes in each network, images of 640 x 192.
const LAYERS: &[Layer] = &[
    // ResNet-18 encoders and Monodepth2 decoders.
    ("resnet stem", 3, 64, (7, 7), STEM, (192, 640)),
    ("resnet stem of a pair", 6, 64, (7, 7), STEM, (192, 640)),
    ("resnet layer1", 64, 64, (3, 3), PLAIN, (48, 160)),
    ("resnet layer2, first", 64, 128, (3, 3), STRIDED, (48, 160)),
    ("resnet layer2, skip", 64, 128, (1, 1), Conv2d { padding: (0, 0), ..STRIDED }, (48, 160)),
    ("resnet layer2", 128, 128, (3, 3), PLAIN, (24, 80)),
    ("resnet layer3, first", 128, 256, (3, 3), STRIDED, (24, 80)),
    ("resnet layer3", 256, 256, (3, 3), PLAIN, (12, 40)),
    ("resnet layer4, first", 256, 512, (3, 3), STRIDED, (12, 40)),
    ("resnet layer4", 512, 512, (3, 3), PLAIN, (6, 20)),
    ("decoder 4, first", 512, 256, (3, 3), REFLECT, (6, 20)),
    ("decoder 4, second", 512, 256, (3, 3), REFLECT, (12, 40)),
    ("decoder 1, second", 96, 32, (3, 3), REFLECT, (96, 320)),
    ("decoder 0, second", 16, 16, (3, 3), REFLECT, (192, 640)),
    ("disparity", 16, 1, (3, 3), REFLECT, (192, 640)),
    ("pose squeeze", 512, 256, (1, 1), POINT, (6, 20)),
    ("pose", 256, 12, (1, 1), POINT, (6, 20)),
    // Lite-Mono.
    ("lite stem", 3, 48, (3, 3), STRIDED, (192, 640)),
    ("lite stem, second", 51, 48, (3, 3), STRIDED, (96, 320)),
    ("lite down 1", 99, 80, (3, 3), STRIDED, (48, 160)),
    ("lite down 2", 163, 128, (3, 3), STRIDED, (24, 80)),
    ("lite dilated 1", 48, 48, (3, 3), depthwise(48, 1), (48, 160)),
    ("lite dilated 2", 48, 48, (3, 3), depthwise(48, 2), (48, 160)),
    ("lite dilated 4", 128, 128, (3, 3), depthwise(128, 4), (12, 40)),
    ("lite dilated 3", 80, 80, (3, 3), depthwise(80, 3), (24, 80)),
    ("lite dilated 6", 128, 128, (3, 3), depthwise(128, 6), (12, 40)),
    ("lite position", 64, 48, (1, 1), POINT, (48, 160)),
    // D-HRNet.
    ("hrnet bottleneck, in", 256, 64, (1, 1), POINT, (48, 160)),
    ("hrnet bottleneck, out", 64, 256, (1, 1), POINT, (48, 160)),
    ("hrnet transition", 256, 18, (3, 3), PLAIN, (48, 160)),
    ("hrnet transition, down", 256, 36, (3, 3), STRIDED, (48, 160)),
    ("hrnet branch 0", 18, 18, (3, 3), PLAIN, (48, 160)),
    ("hrnet branch 1", 36, 36, (3, 3), PLAIN, (24, 80)),
    ("hrnet branch 2", 72, 72, (3, 3), PLAIN, (12, 40)),
    ("hrnet branch 3", 144, 144, (3, 3), PLAIN, (6, 20)),
    ("hrnet fuse", 144, 18, (1, 1), POINT, (6, 20)),
    // SCIPaD.
    ("scipad frozen, in", 256, 64, (1, 1), POINT, (48, 160)),
    ("scipad frozen, skip", 256, 512, (1, 1), Conv2d { padding: (0, 0), ..STRIDED }, (48, 160)),
    ("scipad position", 2, 96, (1, 1), POINT, (48, 160)),
    ("scipad fusion", 64, 128, (3, 3), PLAIN, (48, 160)),
    ("scipad squeeze", 512, 256, (1, 1), POINT, (6, 20)),
    // RAFT, small and full.
    ("raft stem", 3, 32, (7, 7), STEM, (192, 640)),
    ("raft bottleneck", 8, 8, (3, 3), PLAIN, (96, 320)),
    ("raft correlation features, small", 196, 96, (1, 1), POINT, (24, 80)),
    ("raft correlation features, full", 324, 256, (1, 1), POINT, (24, 80)),
    ("raft flow features", 2, 64, (7, 7), Conv2d { padding: (3, 3), ..PLAIN }, (24, 80)),
    ("raft gru, small", 242, 96, (3, 3), PLAIN, (24, 80)),
    ("raft gru, along rows", 384, 128, (1, 5), Conv2d { padding: (0, 2), ..PLAIN }, (24, 80)),
    ("raft gru, along columns", 384, 128, (5, 1), Conv2d { padding: (2, 0), ..PLAIN }, (24, 80)),
    ("raft flow head", 128, 2, (3, 3), PLAIN, (24, 80)),
    ("raft mask", 256, 576, (1, 1), POINT, (24, 80)),
    ("raft residual, full", 96, 128, (3, 3), STRIDED, (48, 160)),
];

/// Samples in a batch: two, so that strides between samples count.
const SAMPLES: usize = 2;
/// Entries that are compared, of each of output, input gradient and weight gradient.
const ENTRIES: usize = 40;

/// Positions of entries: both ends, and some that are drawn.
fn some(seed: u64, shape: Shape) -> Vec<[usize; 4]> {
    let drawn = random::<f64>(seed, Shape::new(1, 1, 1, ENTRIES), 0.0, shape.len() as f64);
    let ends = [0, shape.len() - 1];
    ends.into_iter().chain(drawn.data().iter().map(|&x| x as usize)).map(|i| shape.unravel(i)).collect()
}

/// Row or column of the input under a tap, where the border of the given kind has one.
fn under(
    output: usize,
    tap: usize,
    (stride, dilation, padding): (usize, usize, usize),
    size: usize,
    mode: PadMode,
) -> Option<usize> {
    let at = (output * stride + tap * dilation) as isize - padding as isize;
    let last = size as isize - 1;
    match mode {
        PadMode::Zero => (0..=last).contains(&at).then_some(at as usize),
        PadMode::Reflect => Some(if at < 0 {
            -at
        } else if at > last {
            2 * last - at
        } else {
            at
        } as usize),
        PadMode::Replicate => Some(at.clamp(0, last) as usize),
    }
}

/// What a convolution multiplies.
struct Product {
    x: Tensor<f64>,
    weight: Tensor<f64>,
    g: Tensor<f64>,
    attributes: Conv2d,
}

impl Product {
    /// Calls `visit` with the input's place under each tap of an output.
    fn taps(&self, [_, _, v, u]: [usize; 4], mut visit: impl FnMut([usize; 2], [usize; 2])) {
        let (a, x, w) = (self.attributes, self.x.shape(), self.weight.shape());
        for i in 0..w.h() {
            for j in 0..w.w() {
                let row = under(v, i, (a.stride.0, a.dilation.0, a.padding.0), x.h(), a.pad_mode);
                let column = under(u, j, (a.stride.1, a.dilation.1, a.padding.1), x.w(), a.pad_mode);
                if let (Some(row), Some(column)) = (row, column) {
                    visit([i, j], [row, column]);
                }
            }
        }
    }

    /// First input channel of the group of an output channel.
    fn first_channel(&self, o: usize) -> usize {
        let w = self.weight.shape();
        o / (w.n() / self.attributes.groups) * w.c()
    }

    /// Sum and sum of magnitudes of an entry of the output.
    fn output(&self, at: [usize; 4]) -> (f64, f64) {
        let (mut sum, mut size) = (0.0, 0.0);
        let first = self.first_channel(at[1]);
        self.taps(at, |[i, j], [v, u]| {
            for c in 0..self.weight.shape().c() {
                let term = self.weight.at(at[1], c, i, j) * self.x.at(at[0], first + c, v, u);
                (sum, size) = (sum + term, size + term.abs());
            }
        });
        (sum, size)
    }

    /// The same of an entry of the weights' gradient.
    fn weight_gradient(&self, [o, c, i, j]: [usize; 4]) -> (f64, f64) {
        let (mut sum, mut size) = (0.0, 0.0);
        let (g, first) = (self.g.shape(), self.first_channel(o));
        for n in 0..g.n() {
            for v in 0..g.h() {
                for u in 0..g.w() {
                    let a = self.attributes;
                    let row = under(v, i, (a.stride.0, a.dilation.0, a.padding.0), self.x.shape().h(), a.pad_mode);
                    let column = under(u, j, (a.stride.1, a.dilation.1, a.padding.1), self.x.shape().w(), a.pad_mode);
                    if let (Some(row), Some(column)) = (row, column) {
                        let term = self.g.at(n, o, v, u) * self.x.at(n, first + c, row, column);
                        (sum, size) = (sum + term, size + term.abs());
                    }
                }
            }
        }
        (sum, size)
    }

    /// The same of an entry of the input's gradient: over the outputs near it.
    fn input_gradient(&self, [n, c, row, column]: [usize; 4]) -> (f64, f64) {
        let (mut sum, mut size) = (0.0, 0.0);
        let (a, g, w) = (self.attributes, self.g.shape(), self.weight.shape());
        let near = |at: usize, stride: usize, reach: usize, size: usize| {
            (at.saturating_sub(reach) / stride)..((at + reach) / stride + 1).min(size)
        };
        for v in near(row, a.stride.0, (w.h() - 1) * a.dilation.0 + a.padding.0, g.h()) {
            for u in near(column, a.stride.1, (w.w() - 1) * a.dilation.1 + a.padding.1, g.w()) {
                self.taps([n, 0, v, u], |[i, j], place| {
                    if place != [row, column] {
                        return;
                    }
                    let outputs = w.n() / a.groups;
                    let group = c / w.c();
                    for o in group * outputs..(group + 1) * outputs {
                        let term = self.weight.at(o, c % w.c(), i, j) * self.g.at(n, o, v, u);
                        (sum, size) = (sum + term, size + term.abs());
                    }
                });
            }
        }
        (sum, size)
    }
}

#[track_caller]
fn assert_near(name: &str, what: &str, got: &Tensor<f32>, seed: u64, want: impl Fn([usize; 4]) -> (f64, f64)) {
    for at in some(seed, got.shape()) {
        let [n, c, h, w] = at;
        let (sum, size) = want(at);
        let error = (f64::from(got.at(n, c, h, w)) - sum).abs();
        assert!(error <= 2e-6 * size, "{name}: {what} {at:?} is {}, not {sum} (terms {size})", got.at(n, c, h, w));
    }
}

#[test]
fn convolutions_of_every_network_equal_plain_loops() {
    for (k, &(name, inputs, outputs, (kh, kw), attributes, (h, w))) in LAYERS.iter().enumerate() {
        let seed = 10 * k as u64;
        let tape = Tape::<f32>::new();
        let x = tape.leaf(random(seed, Shape::new(SAMPLES, inputs, h, w), -1.0, 1.0));
        let weight = tape.leaf(random(seed + 1, Shape::new(outputs, inputs / attributes.groups, kh, kw), -1.0, 1.0));
        let y = x.conv2d(weight, None, attributes);
        let g: Tensor<f32> = random(seed + 2, y.shape(), -1.0, 1.0);
        let grads = tape.backward(y.mul(tape.constant(g.clone())).sum());
        let plain = Product { x: x.value().cast(), weight: weight.value().cast(), g: g.cast(), attributes };
        assert_near(name, "output", &y.value(), seed + 3, |at| plain.output(at));
        assert_near(name, "input gradient", &grads.wrt(x), seed + 4, |at| plain.input_gradient(at));
        assert_near(name, "weight gradient", &grads.wrt(weight), seed + 5, |at| plain.weight_gradient(at));
    }
}

/// Products `[rows, inner] x [inner, columns]` of the networks: linear layers of Lite-Mono and their gradients, its attention
/// across channels, all pairs of RAFT, the window product and the head of SCIPaD.
const PRODUCTS: &[(usize, usize, usize)] = &[
    (7680, 48, 288),
    (7680, 288, 48),
    (288, 7680, 48),
    (1920, 80, 480),
    (480, 1920, 80),
    (480, 128, 768),
    (768, 480, 128),
    (480, 128, 384),
    (6, 7680, 6),
    (10, 1920, 10),
    (16, 480, 16),
    (16, 16, 480),
    (1920, 128, 1920),
    (1920, 256, 1920),
    (128, 1920, 1920),
    (1, 512, 49),
    (49, 128, 1),
    (1, 256, 64),
    (1, 64, 6),
    (4, 256, 64),
    (64, 4, 256),
];

#[test]
fn matrix_products_of_every_network_equal_plain_loops() {
    for (k, &(rows, inner, columns)) in PRODUCTS.iter().enumerate() {
        let a: Tensor<f32> = random(2 * k as u64, Shape::new(1, 1, rows, inner), -1.0, 1.0);
        let b: Tensor<f32> = random(2 * k as u64 + 1, Shape::new(1, 1, inner, columns), -1.0, 1.0);
        let transpose = |x: &Tensor<f32>| -> Vec<f32> {
            let s = x.shape();
            (0..s.len()).map(|i| x.at(0, 0, i % s.h(), i / s.h())).collect()
        };
        let (at, bt) = (transpose(&a), transpose(&b));
        let lefts = [View::new(a.data(), rows, inner), View::transpose_of(&at, rows, inner)];
        let rights = [View::new(b.data(), inner, columns), View::transpose_of(&bt, inner, columns)];
        for left in lefts {
            for right in rights {
                let mut out = vec![0.0_f32; rows * columns];
                f32::gemm(&mut out, left, right, false);
                let out = Tensor::from_vec(Shape::new(1, 1, rows, columns), out);
                let orders = (left.transposed, right.transposed);
                assert_near(&format!("{rows} x {inner} x {columns} {orders:?}"), "entry", &out, k as u64, |[_, _, i, j]| {
                    let terms = (0..inner).map(|l| f64::from(a.at(0, 0, i, l)) * f64::from(b.at(0, 0, l, j)));
                    terms.fold((0.0, 0.0), |(sum, size), term| (sum + term, size + term.abs()))
                });
            }
        }
    }
}

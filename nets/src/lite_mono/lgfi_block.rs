//! Local-global features interaction: attention across channels, then a hidden layer.

use dimode_autodiff::{MatMul, Scalar, Shape, Var};

use super::pointwise::{Pointwise, SCALE_START};
use super::positional_code::PositionalCode;
use crate::layers::{LayerNorm, LinearLayer};
use crate::{Binder, Blueprint, Init};

/// Length below which a row of queries or keys is not brought to length 1.
const SHORTEST: f64 = 1e-12;

/// `t = x (+ code)`, `t = t + gamma_xca * XCA(LN(t))`, `x + drop_path(gamma * pwconv2(GELU(pwconv1(LN(t)))))`.
///
/// The sum takes the input of the block: neither the positional code nor the attention goes past the hidden layer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LgfiBlock {
    code: Option<PositionalCode>,
    norm_xca: LayerNorm,
    attention: CrossCovarianceAttention,
    norm: LayerNorm,
    pointwise: Pointwise,
}

impl LgfiBlock {
    /// The block stored under `path`.
    pub(super) fn new(path: &str, channels: usize, heads: usize, expansion: usize, drop_rate: f64) -> Self {
        Self {
            code: None,
            norm_xca: LayerNorm::new(format!("{path}.norm_xca"), channels),
            attention: CrossCovarianceAttention::new(path, channels, heads),
            norm: LayerNorm::new(format!("{path}.norm"), channels),
            pointwise: Pointwise::new(path, channels, expansion, drop_rate),
        }
    }

    /// With a positional code under `path`.
    pub(super) fn with_code(mut self, path: &str, channels: usize) -> Self {
        self.code = Some(PositionalCode::new(&format!("{path}.pos_embd"), channels));
        self
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        if let Some(code) = &self.code {
            code.declare(blueprint);
        }
        self.norm_xca.declare(blueprint);
        self.attention.declare(blueprint);
        self.norm.declare(blueprint);
        self.pointwise.declare(blueprint);
    }

    /// (N, C, H, W) -> the same.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let attended = match &self.code {
            None => self.attend(binder, x),
            Some(code) => code.forward(binder, x.shape()).last_use(|code| x.add(code)).last_use(|t| self.attend(binder, t)),
        };
        let z = attended.last_use(|t| self.norm.forward(binder, t));
        self.pointwise.forward(binder, z, x)
    }

    /// `t + gamma_xca * XCA(LN(t))`.
    fn attend<'t, T: Scalar>(&self, binder: &Binder<'t, T>, t: Var<'t, T>) -> Var<'t, T> {
        let u = self.norm_xca.forward(binder, t);
        u.last_use(|u| self.attention.forward(binder, u)).last_use(|o| t.add(o))
    }
}

/// Attention of every channel of a head to the others, over all pixels:
/// `proj(softmax(temperature q k^T) v)` with every row of `q` and `k` brought to length 1 along the pixels.
#[derive(Clone, Debug, PartialEq)]
struct CrossCovarianceAttention {
    qkv: LinearLayer,
    temperature: String,
    projection: LinearLayer,
    gamma: String,
    channels: usize,
    heads: usize,
}

impl CrossCovarianceAttention {
    fn new(path: &str, channels: usize, heads: usize) -> Self {
        assert!(channels.is_multiple_of(heads), "attention: {channels} channels do not make {heads} heads");
        Self {
            qkv: LinearLayer::new(format!("{path}.xca.qkv"), channels, 3 * channels).kaiming(),
            temperature: format!("{path}.xca.temperature"),
            projection: LinearLayer::new(format!("{path}.xca.proj"), channels, channels).kaiming(),
            gamma: format!("{path}.gamma_xca"),
            channels,
            heads,
        }
    }

    fn declare(&self, blueprint: &mut Blueprint) {
        blueprint.parameter(self.gamma.clone(), &[self.channels], Init::Constant(SCALE_START));
        blueprint.parameter(self.temperature.clone(), &[self.heads, 1, 1], Init::Constant(1.0));
        self.qkv.declare(blueprint);
        self.projection.declare(blueprint);
    }

    /// (N, C, H, W) -> the same, scaled by `gamma_xca`.
    fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let shape = x.shape();
        let width = self.channels / self.heads;
        // Pixels in a row: (N, 3 heads, C / heads, H W), queries, keys, values.
        let pixels = Shape::new(shape.n(), 3 * self.heads, width, shape.plane());
        let qkv = self.qkv.forward(binder, x).last_use(|qkv| qkv.reshape(pixels));
        let part = |i| qkv.slice(1, i * self.heads, self.heads);
        let unit = |i| part(i).last_use(|rows: Var<'t, T>| rows.l2_normalise(3, SHORTEST));
        let (queries, keys, values) = (unit(0), unit(1), part(2));
        qkv.release();
        let transposed = MatMul { transpose_right: true, ..MatMul::default() };
        let products = queries.last_use(|queries| keys.last_use(|keys| queries.matmul_with(keys, transposed)));
        let temperature = binder.param(&self.temperature).broadcast_to(products.shape());
        let weights = products.last_use(|p| p.mul(temperature)).last_use(|logits| logits.softmax(3));
        // Two products of width x width x pixels for each head.
        binder.count_macs(2 * x.shape().len() * width);
        let mixed = weights.last_use(|weights| values.last_use(|values| weights.matmul(values)));
        let gamma = binder.param(&self.gamma);
        mixed.last_use(|mixed| mixed.reshape(shape)).last_use(|mixed| self.projection.scaled(binder, mixed, gamma))
    }
}

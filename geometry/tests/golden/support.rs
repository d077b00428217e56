//! Reading of the stored reference tensors.

use std::path::PathBuf;

use dimode_autodiff::{Shape, Tensor};
use dimode_geometry::Intrinsics;
use safetensors::{Dtype, SafeTensors};

/// One file of reference tensors.
pub struct Golden {
    bytes: Vec<u8>,
}

impl Golden {
    /// Opens `tests/golden/losses/NAME.f64.safetensors`.
    pub fn open(name: &str) -> Self {
        let path: PathBuf =
            [env!("CARGO_MANIFEST_DIR"), "..", "tests", "golden", "losses", &format!("{name}.f64.safetensors")].iter().collect();
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Self { bytes }
    }

    /// Stored sizes and numbers.
    pub fn raw(&self, name: &str) -> (Vec<usize>, Vec<f64>) {
        let file = SafeTensors::deserialize(&self.bytes).expect("a safetensors file");
        let view = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let data = match view.dtype() {
            Dtype::F64 => view.data().chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect(),
            Dtype::U8 => view.data().iter().map(|&b| f64::from(b)).collect(),
            other => panic!("{name}: {other:?}"),
        };
        (view.shape().to_vec(), data)
    }

    /// The numbers alone.
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        self.raw(name).1
    }

    /// A tensor of a given shape.
    pub fn tensor(&self, name: &str, shape: Shape) -> Tensor<f64> {
        Tensor::from_vec(shape, self.numbers(name))
    }

    /// A map (N,C,H,W); three-dimensional ones get one channel.
    pub fn map(&self, name: &str) -> Tensor<f64> {
        let (sizes, data) = self.raw(name);
        let shape = match sizes[..] {
            [n, c, h, w] => Shape::new(n, c, h, w),
            [n, h, w] => Shape::new(n, 1, h, w),
            _ => panic!("{name}: sizes {sizes:?}"),
        };
        Tensor::from_vec(shape, data)
    }

    /// Cameras of `in.K` for 32x24 pixels.
    pub fn cameras(&self) -> Vec<Intrinsics> {
        self.numbers("in.K").chunks_exact(9).map(|k| Intrinsics::new(k[0], k[4], k[2], k[5], 32, 24).unwrap()).collect()
    }
}

/// Largest of `|a - b| / (atol + rtol |b|)`.
pub fn excess(a: &[f64], b: &[f64], atol: f64, rtol: f64) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| if a.is_finite() { (a - b).abs() / (atol + rtol * b.abs()) } else { f64::INFINITY })
        .fold(0.0, f64::max)
}

/// Asserts closeness of two lists.
#[track_caller]
pub fn close(what: &str, a: &[f64], b: &[f64], atol: f64, rtol: f64) {
    let worst = excess(a, b, atol, rtol);
    assert!(worst <= 1.0, "{what}: {worst:.3e} times the tolerance");
}

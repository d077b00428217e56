//! Tensors of one golden file.

use std::collections::BTreeMap;

use dimode_autodiff::{Scalar, Shape, Tensor};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::files::bytes;

/// One tensor as it is stored, widened to `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// Dimensions, rank kept; none for a scalar.
    pub dims: Vec<usize>,
    /// Values, row-major.
    pub values: Vec<f64>,
}

/// The tensors of one safetensors file, by name. All stored types (`F64`, `F32`, `I64`, `I32`, `U8`) are widened to `f64`.
pub struct Golden {
    file: String,
    tensors: BTreeMap<String, Stored>,
}

impl Golden {
    /// Reads a file such as `losses/pose.f64.safetensors`, found as [`crate::find`] does.
    ///
    /// # Panics
    /// When the file is missing, is not a safetensors file or holds another type.
    #[track_caller]
    pub fn open(file: &str) -> Self {
        let bytes = bytes(file);
        let content = SafeTensors::deserialize(&bytes)
            .unwrap_or_else(|e| panic!("golden file {file} is not a safetensors file: {e}; restore it"));
        let mut tensors = BTreeMap::new();
        for (name, view) in content.tensors() {
            let values = widened(&view)
                .unwrap_or_else(|| panic!("{file}: '{name}' is stored as {:?}; store F64, F32, I64, I32 or U8", view.dtype()));
            tensors.insert(name, Stored { dims: view.shape().to_vec(), values });
        }
        Self { file: file.to_owned(), tensors }
    }

    /// All names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// A tensor as it is stored, if the file has it.
    pub fn get(&self, name: &str) -> Option<&Stored> {
        self.tensors.get(name)
    }

    /// The numbers of a tensor, row-major.
    ///
    /// # Panics
    /// When the file does not have it.
    #[track_caller]
    pub fn numbers(&self, name: &str) -> &[f64] {
        &self.stored(name).values
    }

    /// A tensor in a shape that holds as many numbers.
    ///
    /// # Panics
    /// When the file does not have it, or the number of elements differs.
    #[track_caller]
    pub fn tensor<T: Scalar>(&self, name: &str, shape: Shape) -> Tensor<T> {
        let Stored { dims, values } = self.stored(name);
        assert_eq!(values.len(), shape.len(), "{}: '{name}' of dimensions {dims:?} does not fill {shape:?}", self.file);
        Tensor::from_vec(shape, values.iter().map(|&v| T::from_f64(v)).collect())
    }

    /// A map of dimensions (N, C, H, W), (N, H, W) with one channel, or a scalar.
    ///
    /// # Panics
    /// When the file does not have it, or it has another number of dimensions.
    #[track_caller]
    pub fn map<T: Scalar>(&self, name: &str) -> Tensor<T> {
        let shape = match self.stored(name).dims[..] {
            [n, c, h, w] => Shape::new(n, c, h, w),
            [n, h, w] => Shape::new(n, 1, h, w),
            [] => Shape::new(1, 1, 1, 1),
            ref dims => panic!("{}: '{name}' of dimensions {dims:?} is no map; ask for it with a shape", self.file),
        };
        self.tensor(name, shape)
    }

    #[track_caller]
    fn stored(&self, name: &str) -> &Stored {
        self.get(name).unwrap_or_else(|| {
            let names: Vec<&str> = self.names().collect();
            panic!("golden file {} has no tensor '{name}'; it has {}", self.file, names.join(", "))
        })
    }
}

/// The values as `f64`, or `None` for a type that is not expected here.
fn widened(view: &TensorView) -> Option<Vec<f64>> {
    let data = view.data();
    Some(match view.dtype() {
        Dtype::F64 => words(data).map(f64::from_le_bytes).collect(),
        Dtype::F32 => words(data).map(|b| f64::from(f32::from_le_bytes(b))).collect(),
        Dtype::I64 => words(data).map(|b| i64::from_le_bytes(b) as f64).collect(),
        Dtype::I32 => words(data).map(|b| f64::from(i32::from_le_bytes(b))).collect(),
        Dtype::U8 => data.iter().map(|&b| f64::from(b)).collect(),
        _ => return None,
    })
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.as_chunks::<N>().0.iter().copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_integers_and_bytes_are_widened() {
        let reprojection = Golden::open("losses/min_reproj.f64.safetensors");
        let probe = Golden::open("networks/fill_probe.safetensors");
        let bias = probe.get("encoder.bn1.bias|gain=1.0").unwrap();
        assert_eq!(bias.dims, [16]);
        assert!(bias.values.iter().all(|&v| v != 0.0 && v.abs() <= 0.1 && v == f64::from(v as f32)));
        let all = |name: &str, allowed: &[f64]| {
            let values = reprojection.numbers(name);
            assert!(values.iter().all(|v| allowed.contains(v)), "{name}");
            assert!(allowed.iter().all(|v| values.contains(v)), "{name}");
        };
        all("out.automask", &[0.0, 1.0]);
        all("out.argmin", &[0.0, 1.0, 2.0, 3.0]);
        assert_eq!(reprojection.numbers("out.loss").len(), 1);
    }

    #[test]
    fn maps_get_four_dimensions() {
        let golden = Golden::open("losses/min_reproj.f64.safetensors");
        let shape = |name: &str| golden.map::<f64>(name).shape();
        assert_eq!(shape("in.target"), Shape::new(2, 3, 24, 32));
        assert_eq!(shape("out.min"), Shape::new(2, 1, 24, 32));
        assert_eq!(shape("out.loss"), Shape::new(1, 1, 1, 1));
    }

    #[test]
    #[should_panic(expected = "golden file losses/pose.f64.safetensors has no tensor 'in.R'; it has grad.axisangle, ")]
    fn a_missing_tensor_is_named_with_those_that_are_there() {
        Golden::open("losses/pose.f64.safetensors").numbers("in.R");
    }

    #[test]
    #[should_panic(expected = "'in.axisangle' of dimensions [5, 1, 3] does not fill")]
    fn a_shape_of_another_size_is_refused() {
        Golden::open("losses/pose.f64.safetensors").tensor::<f64>("in.axisangle", Shape::new(5, 3, 1, 2));
    }

    #[test]
    #[should_panic(expected = "golden file losses/README.md is not a safetensors file")]
    fn a_file_of_another_form_is_named() {
        Golden::open("losses/README.md");
    }
}

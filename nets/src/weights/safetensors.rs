//! The safetensors form.

use ::safetensors::tensor::{Dtype, SafeTensors, TensorView};
use dimode_autodiff::Scalar;

use super::names::is_counter;
use super::{ElementType, Form, StoredTensor, WeightError, WeightFile};
use crate::Params;

/// All tensors of a file, by name.
pub(super) fn parse(bytes: &[u8], origin: &str) -> Result<WeightFile, WeightError> {
    let file = SafeTensors::deserialize(bytes).map_err(|source| WeightError::Format { origin: origin.to_owned(), source })?;
    let mut tensors = file.tensors();
    let all = tensors.len();
    tensors.retain(|(name, _)| !is_counter(name));
    let counters = all - tensors.len();
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    let tensors = tensors.into_iter().map(|(name, view)| decode(name, &view, origin)).collect::<Result<_, _>>()?;
    Ok(WeightFile { form: Form::Safetensors, under: None, tensors, counters, ignored: Vec::new() })
}

fn decode(name: String, view: &TensorView, origin: &str) -> Result<StoredTensor, WeightError> {
    let element = match view.dtype() {
        Dtype::F64 => ElementType::F64,
        Dtype::F32 => ElementType::F32,
        Dtype::F16 => ElementType::F16,
        Dtype::BF16 => ElementType::BF16,
        Dtype::I64 => ElementType::I64,
        Dtype::I32 => ElementType::I32,
        Dtype::I16 => ElementType::I16,
        Dtype::I8 => ElementType::I8,
        Dtype::U8 => ElementType::U8,
        Dtype::BOOL => ElementType::Bool,
        other => {
            return Err(WeightError::ElementType { origin: origin.to_owned(), name, dtype: format!("{other:?}") });
        }
    };
    let mut values = Vec::with_capacity(view.data().len() / element.size());
    element.decode(view.data(), &mut values);
    Ok(StoredTensor { name, element, dims: view.shape().to_vec(), values })
}

/// The bytes of a file that holds `params`, in the precision of `T`.
pub(super) fn to_bytes<T: Scalar>(params: &Params<T>) -> Result<Vec<u8>, WeightError> {
    let double = T::NAME == "f64";
    let dtype = if double { Dtype::F64 } else { Dtype::F32 };
    let encode = |v: &T| {
        let v = v.to_f64();
        if double { v.to_le_bytes().to_vec() } else { (v as f32).to_le_bytes().to_vec() }
    };
    let buffers: Vec<Vec<u8>> = params.iter().map(|(_, e)| e.tensor().data().iter().flat_map(encode).collect()).collect();
    let format = |source| WeightError::Format { origin: "the set of parameters".to_owned(), source };
    let views =
        params.iter().zip(&buffers).map(|((name, e), bytes)| Ok((name, TensorView::new(dtype, e.dims().to_vec(), bytes)?)));
    let views = views.collect::<Result<Vec<_>, _>>().map_err(format)?;
    ::safetensors::serialize(views, None).map_err(format)
}

//! Tests of reading and writing weights.

use std::fs;
use std::path::PathBuf;

use ::safetensors::tensor::{Dtype, TensorView};
use dimode_autodiff::{Scalar, Tensor};

use super::*;
use crate::params::shape_of;
use crate::{Blueprint, Init, Kind, ParamSet, Params};

fn blueprint() -> Blueprint {
    let mut b = Blueprint::new();
    b.parameter("net:conv.weight".into(), &[4, 3, 3, 3], Init::fan_in(27));
    b.parameter("net:fc.weight".into(), &[5, 4], Init::fan_in(4));
    b.buffer("net:bn.running_mean".into(), &[4], Init::fan_in(1));
    b.parameter("head:scale".into(), &[2], Init::fan_in(1));
    b
}

fn values<T: Scalar>(set: &ParamSet<T>) -> Vec<(String, Vec<usize>, Vec<f64>)> {
    let values = |e: &crate::Entry<T>| e.tensor().data().iter().map(|v| v.to_f64()).collect();
    set.iter().map(|(path, e)| (path, e.dims().to_vec(), values(e))).collect()
}

fn scratch(name: &str) -> PathBuf {
    let directory = std::env::temp_dir().join(format!("dimode-nets-{}-{name}", std::process::id()));
    fs::create_dir_all(&directory).unwrap();
    directory
}

fn round_trip<T: Scalar>(name: &str) {
    let directory = scratch(name);
    let saved = blueprint().init::<T>(1);
    let mut loaded = blueprint().init::<T>(2);
    assert_ne!(values(&saved), values(&loaded));
    save_directory(&directory, &saved).unwrap();
    load_directory(&directory, &mut loaded).unwrap();
    assert_eq!(values(&saved), values(&loaded));
    let names: Vec<String> = fs::read_dir(&directory).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert_eq!(names.len(), 2, "no temporary file stays: {names:?}");
    fs::remove_dir_all(&directory).unwrap();
}

#[test]
fn saved_weights_come_back_bit_for_bit() {
    round_trip::<f32>("f32");
    round_trip::<f64>("f64");
}

#[test]
fn all_differences_are_kept_and_nothing_changes() {
    let mut params = blueprint().init::<f64>(1).file("net").unwrap().clone();
    let before = params.get("conv.weight").unwrap().tensor().to_vec();
    let stored = |name: &str, dims: &[usize]| StoredTensor {
        name: name.to_owned(),
        element: ElementType::F32,
        dims: dims.to_vec(),
        values: vec![0.0; dims.iter().product()],
    };
    let given = vec![stored("conv.weight", &[4, 3, 3, 3]), stored("fc.weight", &[4, 5]), stored("surplus", &[1])];
    let error = assign(&mut params, given, "test.safetensors").unwrap_err();
    let text = error.to_string();
    let WeightError::Mismatch { differences, .. } = error else {
        panic!("wrong kind: {text}");
    };
    assert_eq!(
        differences.list(),
        "missing: bn.running_mean\nnot known: surplus\nof another size: fc.weight [4, 5] instead of [5, 4]\n"
    );
    let Differences { missing, extra, misshapen } = differences;
    assert_eq!(missing, ["bn.running_mean"]);
    assert_eq!(extra, ["surplus"]);
    assert_eq!(misshapen[0].expected, [5, 4]);
    assert_eq!(misshapen[0].found, [4, 5]);
    for part in ["test.safetensors", "bn.running_mean", "surplus", "[4, 5]"] {
        assert!(text.contains(part), "{text}");
    }
    assert_eq!(params.get("conv.weight").unwrap().tensor().to_vec(), before);
}

#[test]
fn a_message_counts_the_differences_and_names_the_first_three() {
    let names = |count: usize| -> Vec<String> { (0..count).map(|i| format!("w{i}")).collect() };
    let wrong = |name| Misshapen { name, expected: vec![2], found: vec![3] };
    let misshapen = names(1).into_iter().map(wrong).collect();
    let differences = Differences { missing: names(120), extra: names(3), misshapen };
    let error = WeightError::Mismatch { origin: "a file".into(), differences };
    let expected = "a file does not fit the network, tensors: 120 missing (w0, w1, w2, ...), 3 not known (w0, w1, w2), \
                    1 of another size (w0 [3] instead of [2])";
    assert_eq!(error.to_string(), expected);
}

#[test]
fn values_that_are_not_finite_are_refused_by_name_and_nothing_changes() {
    for value in [f64::NAN, f64::NEG_INFINITY, 1e300] {
        let mut broken = blueprint().init::<f64>(1).file("net").unwrap().clone();
        let entry = broken.get_mut("fc.weight").unwrap();
        let mut values = entry.tensor().to_vec();
        values[7] = value;
        entry.set(Tensor::from_vec(entry.tensor().shape(), values));
        let bytes = to_bytes(&broken).unwrap();
        let mut params = blueprint().init::<f32>(2).file("net").unwrap().clone();
        let before = params.get("conv.weight").unwrap().tensor().to_vec();
        let text = assign(&mut params, parse(&bytes, "memory").unwrap(), "memory").unwrap_err().to_string();
        assert!(text.starts_with(&format!("memory: 'fc.weight' holds {value:e} at index 7; ")), "{text}");
        assert_eq!(params.get("conv.weight").unwrap().tensor().to_vec(), before);
    }
}

#[test]
fn wrapper_prefix_and_counters_are_accepted() {
    let one = 1i64.to_le_bytes();
    let value = 2.5f32.to_le_bytes();
    let views = vec![
        ("module.scale", TensorView::new(Dtype::F32, vec![1], &value).unwrap()),
        ("module.bn.num_batches_tracked", TensorView::new(Dtype::I64, vec![], &one).unwrap()),
    ];
    let bytes = ::safetensors::serialize(views, None).unwrap();
    let mut params = Params::<f64>::new();
    let zero = Tensor::zeros(shape_of(&[1]));
    params.insert("scale", crate::Entry::new(vec![1], Kind::Parameter, zero));
    assign(&mut params, parse(&bytes, "memory").unwrap(), "memory").unwrap();
    assert_eq!(params.get("scale").unwrap().tensor().item(), 2.5);
}

#[test]
fn other_element_types_are_refused_by_name() {
    let one = 1i64.to_le_bytes();
    let stored = |dtype| {
        let view = TensorView::new(dtype, vec![1], &one).unwrap();
        ::safetensors::serialize(vec![("count", view)], None).unwrap()
    };
    let text = parse(&stored(Dtype::U64), "memory").unwrap_err().to_string();
    assert!(text.contains("'count'") && text.contains("U64"), "{text}");
    // Whole numbers are read, for they may stand beside weights, but they are not weights.
    let tensors = parse(&stored(Dtype::I64), "memory").unwrap();
    assert_eq!((tensors[0].element, tensors[0].values.as_slice()), (ElementType::I64, &[1.0][..]));
    let mut params = Params::<f64>::new();
    params.insert("count", crate::Entry::new(vec![1], Kind::Parameter, Tensor::zeros(shape_of(&[1]))));
    let text = assign(&mut params, tensors, "memory").unwrap_err().to_string();
    assert_eq!(text, "memory: 'count' is stored as I64, which holds no weights; convert it to F32 or F64");
}

#[test]
fn damaged_files_are_errors() {
    let bytes = to_bytes(blueprint().init::<f32>(1).file("net").unwrap()).unwrap();
    for cut in [0, 4, 20, bytes.len() - 1] {
        let result = parse(&bytes[..cut], "cut");
        assert!(matches!(result, Err(WeightError::Format { .. })), "{cut}");
    }
}

#[test]
fn partial_loading_takes_what_fits_and_tells_the_rest() {
    let mut params = blueprint().init::<f64>(1).file("net").unwrap().clone();
    let before = params.clone();
    let stored = |name: &str, dims: &[usize], value: f64| StoredTensor {
        name: name.to_owned(),
        element: ElementType::F32,
        dims: dims.to_vec(),
        values: vec![value; dims.iter().product()],
    };
    let misfits = || vec![stored("fc.weight", &[4, 5], 0.5), stored("surplus", &[1], f64::NAN)];
    let given = [misfits(), vec![stored("module.conv.weight", &[4, 3, 3, 3], 0.5)]].concat();
    let skipped = assign_partial(&mut params, given, "file").unwrap();
    assert_eq!((skipped.missing, skipped.extra), (vec!["bn.running_mean".to_owned()], vec!["surplus".to_owned()]));
    assert_eq!(skipped.misshapen.len(), 1);
    let of = |params: &Params<f64>, name: &str| params.get(name).unwrap().tensor().to_vec();
    assert_eq!(of(&params, "conv.weight"), [0.5; 108]);
    for name in ["fc.weight", "bn.running_mean"] {
        assert_eq!(of(&params, name), of(&before, name));
    }
    let now = params.clone();
    assert!(matches!(assign_partial(&mut params, misfits(), "file"), Err(WeightError::Mismatch { .. })));
    let broken = vec![stored("conv.weight", &[4, 3, 3, 3], f64::NAN), stored("bn.running_mean", &[4], 1.0)];
    assert!(matches!(assign_partial(&mut params, broken, "file"), Err(WeightError::NonFinite { .. })));
    assert!(now.names().all(|name| of(&params, name) == of(&now, name)));
}

#[test]
fn a_norm_that_is_registered_twice_is_found_under_either_name() {
    let mut blueprint = Blueprint::new();
    for name in ["layer2.0.norm3.weight", "layer2.0.downsample.0.bias", "res.0.downsample.1.weight"] {
        blueprint.parameter(format!("net:{name}"), &[1], Init::Constant(0.0));
    }
    let assigned = |stored: &[(&str, f64)]| {
        let mut params = blueprint.init::<f64>(1).file("net").unwrap().clone();
        let tensor = |&(name, value): &(&str, f64)| StoredTensor {
            name: name.into(),
            element: ElementType::F32,
            dims: vec![1],
            values: vec![value],
        };
        assign(&mut params, stored.iter().map(tensor).collect(), "memory")?;
        Ok(params.iter().map(|(_, e)| e.tensor().item()).collect::<Vec<_>>())
    };
    let (first, second) = (("layer2.0.norm3.weight", 1.0), ("module.layer2.0.downsample.1.weight", 9.0));
    let others = [("layer2.0.downsample.0.bias", 2.0), ("res.0.downsample.1.weight", 3.0)];
    let with = |more: &[(&'static str, f64)]| assigned(&[&others[..], more].concat());
    assert_eq!(with(&[first]).unwrap(), [1.0, 2.0, 3.0]);
    assert_eq!(with(&[second]).unwrap(), [9.0, 2.0, 3.0]);
    assert_eq!(with(&[second, first]).unwrap(), [1.0, 2.0, 3.0]);
    let error: WeightError = with(&[]).unwrap_err();
    assert!(error.to_string().contains("1 missing (layer2.0.norm3.weight)"), "{error}");
}

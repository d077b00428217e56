//! Files that PyTorch wrote, value for value.

use dimode_autodiff::{Shape, Tensor};
use dimode_nets::weights::{self, ElementType, Form, Ignored, WeightError, WeightFile};
use dimode_nets::{Entry, Kind, Params};

use crate::{bytes, path, ramp, read, refusal, tensor};

/// The tensors of the plain state, under names that begin with `prefix`.
#[track_caller]
fn assert_plain(file: &WeightFile, prefix: &str) {
    let expected: [(&str, &[usize], Vec<f64>); 3] =
        [("conv.weight", &[2, 3, 1, 2], ramp(12)), ("bn.running_mean", &[4], ramp(4)), ("scale", &[], vec![2.5])];
    assert_eq!((file.form, file.under.as_deref(), file.counters), (Form::PyTorch, None, 1));
    let names: Vec<&str> = file.tensors.iter().map(|tensor| tensor.name.as_str()).collect();
    assert_eq!(names, expected.each_ref().map(|(name, ..)| format!("{prefix}{name}")));
    for (found, (_, dims, values)) in file.tensors.iter().zip(&expected) {
        assert_eq!((found.element, found.dims.as_slice(), &found.values), (ElementType::F32, *dims, values));
    }
}

#[test]
fn a_dictionary_of_tensors_is_read_in_its_order() {
    for name in ["plain.pth", "protocol_4.pth"] {
        let file = read(name);
        assert_plain(&file, "");
        assert_eq!(file.ignored, []);
    }
}

#[test]
fn the_state_of_a_module_is_read() {
    let file = read("ordered.pth");
    let names: Vec<&str> = file.tensors.iter().map(|tensor| tensor.name.as_str()).collect();
    assert_eq!(names, ["conv.weight", "conv.bias", "bn.weight", "bn.bias", "bn.running_mean", "bn.running_var"]);
    assert_eq!((&tensor(&file, "conv.weight").dims, file.counters), (&vec![2, 1, 3, 3], 1));
    assert_eq!(tensor(&file, "conv.weight").values, ramp(18));
}

#[test]
fn sizes_of_images_are_told_and_left_out() {
    let file = read("with_sizes.pth");
    assert_plain(&file, "");
    let ignored = [("height", "192"), ("width", "640"), ("use_stereo", "false")];
    assert_eq!(file.ignored, ignored.map(|(name, what)| Ignored { name: name.into(), what: what.into() }));
}

#[test]
fn the_state_is_found_among_what_a_training_saves() {
    let file = read("trained.pth");
    assert_eq!((file.under.as_deref(), file.tensors.len(), file.counters), (Some("state_dict"), 6, 1));
    assert_eq!(tensor(&file, "conv.weight").values, ramp(18));
    let told: Vec<String> = file.ignored.iter().map(|entry| format!("{}={}", entry.name, entry.what)).collect();
    let expected =
        ["epoch=3", "best=0.25", "note='a run'", "optimizer=a dictionary of 2", "args=settings of a program"].map(String::from);
    assert_eq!(told, expected);
}

#[test]
fn every_type_of_numbers_is_widened() {
    let file = read("types.pth");
    let whole = [-8.0, -7.0, -6.0, -5.0, -4.0];
    for (name, element) in [
        ("float64", ElementType::F64),
        ("float32", ElementType::F32),
        ("float16", ElementType::F16),
        ("bfloat16", ElementType::BF16),
        ("int64", ElementType::I64),
        ("int32", ElementType::I32),
        ("int16", ElementType::I16),
        ("int8", ElementType::I8),
    ] {
        let found = tensor(&file, name);
        assert_eq!((found.element, found.values.as_slice()), (element, &whole[..]), "{name}");
    }
    assert_eq!(tensor(&file, "uint8").values, [250.0, 251.0, 252.0, 253.0, 254.0]);
    assert_eq!(tensor(&file, "bool").values, [1.0, 0.0, 1.0]);
    // Subnormal, negative zero, the largest half, pi to 11 bits.
    let special = &tensor(&file, "float16_special").values;
    assert_eq!(special[..], [2f64.powi(-24), 0.0, 65504.0, 3.140_625]);
    assert!(special[1].is_sign_negative());
}

#[test]
fn views_take_their_values_from_the_places_they_name() {
    let file = read("views.pth");
    let base = ramp(24);
    let expect = |name: &str, dims: &[usize], places: Vec<usize>| {
        let found = tensor(&file, name);
        let values: Vec<f64> = places.into_iter().map(|place| base[place]).collect();
        assert_eq!((found.dims.as_slice(), &found.values), (dims, &values), "{name}");
    };
    // 4 rows of 6, read by columns.
    expect("transposed", &[6, 4], (0..6).flat_map(|column| (0..4).map(move |row| 6 * row + column)).collect());
    let last = |h: usize, w: usize| (0..2).map(move |c| 12 * c + 4 * h + w);
    expect("channels_last", &[1, 3, 4, 2], (0..3).flat_map(|h| (0..4).flat_map(move |w| last(h, w))).collect());
    expect("offset", &[4], (5..9).collect());
    expect("stepped", &[5], (0..5).map(|i| 1 + 5 * i).collect());
    expect("expanded", &[2, 3], vec![2, 2, 2, 3, 3, 3]);
    expect("whole", &[24], (0..24).collect());
}

#[test]
fn a_parameter_is_its_tensor() {
    assert_eq!(tensor(&read("parameter.pth"), "weight").values, ramp(3));
}

/// A place for the plain state.
fn params() -> Params<f32> {
    let mut params = Params::new();
    for (name, dims) in [("conv.weight", vec![2, 3, 1, 2]), ("bn.running_mean", vec![4]), ("scale", vec![])] {
        let shape = match dims.as_slice() {
            &[n, c, h, w] => Shape::new(n, c, h, w),
            sides => Shape::new(1, sides.iter().product(), 1, 1),
        };
        params.insert(name, Entry::new(dims, Kind::Parameter, Tensor::full(shape, 7.0)));
    }
    params
}

#[test]
fn files_of_pytorch_load_into_parameters_whatever_their_names_end_with() {
    let place = tempfile::tempdir().unwrap();
    for name in ["plain.pth", "wrapped.pth", "with_sizes.pth"] {
        let mut params = params();
        let copy = place.path().join("weights.safetensors");
        std::fs::copy(path(name), &copy).unwrap();
        weights::load(&copy, &mut params).unwrap();
        let loaded: Vec<f64> = params.get("conv.weight").unwrap().tensor().data().iter().map(|&v| f64::from(v)).collect();
        assert_eq!(loaded, ramp(12), "{name}");
        assert_eq!(params.get("scale").unwrap().tensor().item(), 2.5);
    }
    assert_plain(&read("wrapped.pth"), "_orig_mod.module.module.");
}

#[test]
fn a_wrong_file_changes_nothing_and_tells_every_difference() {
    let mut params = params();
    let error = weights::load(&path("ordered.pth"), &mut params).unwrap_err();
    let WeightError::Mismatch { differences, .. } = &error else { panic!("{error}") };
    assert_eq!(differences.missing, ["scale"]);
    assert_eq!(differences.extra, ["bn.bias", "bn.running_var", "bn.weight", "conv.bias"]);
    assert_eq!(differences.misshapen.len(), 2);
    for name in ["malicious.pth", "types.pth", "list.pth", "no such file"] {
        weights::load(&path(name), &mut params).unwrap_err();
    }
    assert!(params.iter().all(|(_, entry)| entry.tensor().data().iter().all(|&value| value == 7.0)));
}

#[test]
fn what_is_no_file_of_weights_is_refused_with_a_way_out() {
    for (name, parts) in [
        ("legacy.pth", &["PyTorch 1.5 and older", "torch.load(", "torch.save("][..]),
        ("script.pt", &["TorchScript program", "state_dict()"]),
        ("module.pth", &["names '__main__.Net'", "executable content is refused", "torch.save(model.state_dict()"]),
        ("list.pth", &["no dictionary of tensors: a list of 2"]),
        ("complex.pth", &["names 'torch.ComplexFloatStorage'"]),
        ("bare.pkl", &["a pickle that torch.save did not write"]),
    ] {
        let message = refusal(&bytes(name));
        for part in parts {
            assert!(message.contains(part), "{name}: '{part}' is not in: {message}");
        }
        assert!(
            message.starts_with("file is ") || message.starts_with("file names ") || message.starts_with("file holds "),
            "{message}"
        );
    }
}

#[test]
fn a_command_in_a_pickle_is_named_and_not_run() {
    let message = refusal(&bytes("malicious.pth"));
    assert!(message.contains("names 'posix.system': executable content is refused"), "{message}");
    assert!(!std::path::Path::new("executed").exists());
}

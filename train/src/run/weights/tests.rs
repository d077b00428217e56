//! Tests of looking at, converting and comparing weights.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use dimode_autodiff::Tensor;
use dimode_nets::{NetKind, ParamSet, weights};

use super::*;

/// A file that PyTorch wrote.
fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../nets/tests/data/weights").join(name)
}

fn net(name: &str) -> NetKind {
    name.parse().unwrap()
}

/// Start values of a network in a folder.
fn saved(place: &Path, name: &str, seed: u64) -> (PathBuf, ParamSet<f32>) {
    let set = net(name).blueprint().init::<f32>(seed);
    let folder = place.join(format!("{name}-{seed}").replace(':', "-"));
    weights::save_directory(&folder, &set).unwrap();
    (folder, set)
}

fn request(name: &str, inputs: &[PathBuf], out: &Path) -> ConvertRequest {
    let inputs = inputs.iter().map(|path| path.to_str().unwrap().parse().unwrap()).collect();
    ConvertRequest { network: net(name), inputs, out: out.to_owned(), partial: false, force: false, seed: 1 }
}

fn error(result: Result<Conversion>) -> (ConvertError, String) {
    let error = result.unwrap_err();
    let text = error.to_string();
    (error.downcast().unwrap(), text)
}

fn bits(set: &ParamSet<f32>) -> Vec<(String, Vec<u32>)> {
    set.iter().map(|(path, entry)| (path, entry.tensor().data().iter().map(|value| value.to_bits()).collect())).collect()
}

#[test]
fn every_network_is_told_by_its_own_files() {
    let place = tempfile::tempdir().unwrap();
    for kind in NetKind::all().filter(|kind| kind.name().starts_with("nano")) {
        let (folder, set) = saved(place.path(), &kind.to_string(), 1);
        for (file, params) in set.files() {
            let found = inspect(&folder.join(format!("{file}.safetensors"))).unwrap();
            let own = |fit: &&Fit| (fit.network.as_str(), fit.file.as_str()) == (kind.to_string().as_str(), file);
            assert!(found.fits.iter().any(|fit| own(&fit)), "{kind} {file}: {:?}", found.fits);
            assert_eq!((found.tensors.len(), found.nearest.len()), (params.len(), 0));
        }
    }
}

#[test]
fn a_file_that_fits_nothing_tells_what_is_near() {
    let place = tempfile::tempdir().unwrap();
    let (_, set) = saved(place.path(), "depth:nano_resnet", 1);
    let mut params = set.file("depth").unwrap().clone();
    let one = params.iter().next().unwrap().1.clone();
    params.insert("surplus", one);
    let path = place.path().join("x");
    weights::save(&path, &params).unwrap();
    let found = inspect(&path).unwrap();
    assert!(found.fits.is_empty());
    let nearest = &found.nearest[0];
    assert_eq!((nearest.network.as_str(), nearest.file.as_str(), nearest.extra), ("depth:nano_resnet", "depth", 1));
    assert_eq!(nearest.differences(), 1);
    let text = found.render();
    assert!(text.contains("fits      no network here\nnearest   depth:nano_resnet, file depth: 1 not known\n"), "{text}");
    let found = inspect(&fixture("plain.pth")).unwrap();
    assert!(found.fits.is_empty() && found.nearest.is_empty());
}

#[test]
fn statistics_are_those_of_the_values() {
    let found = inspect(&fixture("plain.pth")).unwrap();
    let conv = &found.tensors[0];
    assert_eq!((conv.name.as_str(), conv.element.as_str(), conv.dims.as_slice()), ("conv.weight", "F32", &[2, 3, 1, 2][..]));
    // 12 values from -1 in steps of 1/8: variance (12^2 - 1) / 12 steps squared.
    assert_eq!((conv.mean, conv.min, conv.max), (Some(-0.3125), Some(-1.0), Some(0.375)));
    assert!((conv.std.unwrap() - (143f64 / 12.0).sqrt() / 8.0).abs() < 1e-15);
    assert_eq!((found.counters, found.values), (1, 17));
    let trained = inspect(&fixture("trained.pth")).unwrap();
    assert_eq!(trained.under.as_deref(), Some("state_dict"));
    assert!(trained.render().contains("left out  epoch: 3\n"));
}

#[test]
fn a_file_of_pytorch_becomes_a_file_of_the_network() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("out");
    // Neither its name nor the option says which file it is: its tensors do.
    let mut request = request("nano_lite_mono", &[fixture("nano_lite_mono_depth.pth")], &out);
    let (refused, text) = error(convert(&request));
    assert!(refused.is_usage() && text.contains("also needs encoder"), "{text}");
    request.partial = true;
    let converted = convert(&request).unwrap();
    assert_eq!((converted.files.len(), converted.absent.as_slice()), (1, &["encoder".to_owned()][..]));
    assert_eq!((converted.files[0].taken, converted.files[0].skipped.is_empty()), (18, true));
    let mut params = net("nano_lite_mono").blueprint().init::<f32>(5).file("depth").unwrap().clone();
    weights::load(&out.join("depth.safetensors"), &mut params).unwrap();
    for (name, entry) in params.iter() {
        let expected = (0..entry.tensor().shape().len()).map(|i| (i % 16) as f32 / 8.0 - 1.0);
        assert!(entry.tensor().data().iter().copied().eq(expected), "{name}");
    }
    let text = converted.render(&request);
    assert!(text.contains("18 tensors of F16 widened to F32"), "{text}");
    assert!(text.contains("not written: encoder"), "{text}");
    assert!(!out.join("encoder.safetensors").exists());
    let same = diff(&DiffRequest { a: fixture("nano_lite_mono_depth.pth"), b: out.join("depth.safetensors"), tolerance: 0.0 });
    assert!(same.unwrap().equal);
}

#[test]
fn converting_a_networks_own_files_changes_nothing() {
    let place = tempfile::tempdir().unwrap();
    for name in ["depth:nano_d_hrnet", "pose:nano", "nano_scipad", "nano_raft"] {
        let (folder, set) = saved(place.path(), name, 3);
        let inputs: Vec<PathBuf> = set.files().map(|(file, _)| folder.join(format!("{file}.safetensors"))).collect();
        let out = place.path().join("out").join(name.replace(':', "-"));
        let converted = convert(&request(name, &inputs, &out)).unwrap();
        assert!(converted.absent.is_empty() && converted.files.iter().all(|file| file.skipped.is_empty()));
        let mut read = net(name).blueprint().init::<f32>(4);
        weights::load_directory(&out, &mut read).unwrap();
        assert!(bits(&read) == bits(&set), "{name}");
    }
}

#[test]
fn wrong_tensors_are_told_for_all_files_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    let (folder, _) = saved(place.path(), "depth:nano_resnet", 1);
    let inputs = ["encoder", "depth"].map(|file| folder.join(format!("{file}.safetensors")));
    let out = place.path().join("out");
    let (refused, text) = error(convert(&request("depth:nano_lite_mono", &inputs, &out)));
    let ConvertError::Misfit { misfits, .. } = &refused else { panic!("{text}") };
    assert_eq!(misfits.iter().map(|misfit| misfit.file.as_str()).collect::<Vec<_>>(), ["encoder", "depth"]);
    assert!(misfits.iter().all(|misfit| misfit.differences.len() > 3));
    assert!(!refused.is_usage() && text.ends_with("or take what fits with --partial") && text.len() < 1000, "{text}");
    assert!(!out.exists());
}

#[test]
fn a_partial_conversion_says_exactly_what_it_skipped() {
    let place = tempfile::tempdir().unwrap();
    let (_, set) = saved(place.path(), "depth:nano_resnet", 3);
    let mut given = set.clone();
    let mut few = dimode_nets::Params::new();
    for (name, entry) in given.file("depth").unwrap().iter().skip(2) {
        few.insert(name, entry.clone());
    }
    let one = few.iter().next().unwrap().1.clone();
    few.insert("surplus", one);
    *given.file_mut("depth") = few;
    let folder = place.path().join("given");
    weights::save_directory(&folder, &given).unwrap();
    let out = place.path().join("out");
    let inputs = ["encoder", "depth"].map(|file| folder.join(format!("{file}.safetensors")));
    let request = ConvertRequest { partial: true, seed: 8, ..request("depth:nano_resnet", &inputs, &out) };
    let converted = convert(&request).unwrap();
    let depth = &converted.files[1];
    let total = set.file("depth").unwrap().len();
    assert_eq!(
        (depth.taken, depth.skipped.missing.len(), depth.skipped.extra.as_slice()),
        (total - 2, 2, &["surplus".to_owned()][..])
    );
    let text = converted.render(&request);
    let first = set.file("depth").unwrap().names().next().unwrap();
    for line in [format!("depth skipped, missing: {first}"), "depth skipped, not known: surplus".to_owned(), "seed 8".to_owned()]
    {
        assert!(text.contains(&line), "{line} is not in {text}");
    }
    let mut read = net("depth:nano_resnet").blueprint().init::<f32>(4);
    weights::load_directory(&out, &mut read).unwrap();
    let fresh = net("depth:nano_resnet").blueprint().init::<f32>(8);
    let of = |set: &ParamSet<f32>, path: &str| -> Tensor<f32> { set.get(path).unwrap().tensor().clone() };
    for (i, name) in set.file("depth").unwrap().names().enumerate() {
        let path = format!("depth:{name}");
        assert_eq!(of(&read, &path), of(if i < 2 { &fresh } else { &set }, &path), "{path}");
    }
}

#[test]
fn which_file_is_which_can_be_said_or_guessed_but_not_twice() {
    let place = tempfile::tempdir().unwrap();
    let (folder, _) = saved(place.path(), "pose:nano", 1);
    let [encoder, pose] = ["pose_encoder", "pose"].map(|file| folder.join(format!("{file}.safetensors")));
    let (odd_encoder, odd_pose) = (place.path().join("a"), place.path().join("b.bin"));
    fs::copy(&encoder, &odd_encoder).unwrap();
    fs::copy(&pose, &odd_pose).unwrap();
    convert(&request("pose:nano", &[odd_encoder.clone(), odd_pose.clone()], &place.path().join("by tensors"))).unwrap();
    let said = |file: &str, path: &Path| PathBuf::from(format!("{file}={}", path.display()));
    let inputs = [said("pose", &odd_pose), said("pose_encoder", &odd_encoder)];
    convert(&request("pose:nano", &inputs, &place.path().join("said"))).unwrap();

    let out = place.path().join("out");
    let refused = |inputs: &[PathBuf]| error(convert(&request("pose:nano", inputs, &out)));
    assert!(matches!(refused(&[encoder.clone(), odd_encoder.clone(), pose.clone()]).0, ConvertError::Twice { .. }));
    assert!(matches!(refused(&[said("encoder", &encoder)]).0, ConvertError::UnknownFile { .. }));
    assert!(matches!(refused(&[fixture("plain.pth")]).0, ConvertError::Unclear { .. }));
    assert!(refused(&[encoder]).1.contains("pose:nano also needs pose;"));
    assert!(!out.exists());
}

#[test]
fn a_folder_is_replaced_on_request_alone() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("out");
    let (first, _) = saved(place.path(), "nano_raft", 1);
    let (second, set) = saved(place.path(), "nano_raft", 2);
    let request =
        |folder: &Path, force| ConvertRequest { force, ..request("nano_raft", &[folder.join("raft.safetensors")], &out) };
    convert(&request(&first, false)).unwrap();
    assert!(convert(&request(&second, false)).is_err());
    convert(&request(&second, true)).unwrap();
    let mut read = net("nano_raft").blueprint().init::<f32>(4);
    weights::load_directory(&out, &mut read).unwrap();
    assert!(bits(&read) == bits(&set));
}

#[test]
fn differences_are_found_and_bounded_by_the_tolerance() {
    let place = tempfile::tempdir().unwrap();
    let (a, set) = saved(place.path(), "pose:nano", 1);
    let (b, mut other) = saved(place.path(), "pose:nano", 1);
    assert_eq!(a, b);
    let b = place.path().join("b");
    let path = "pose:net.0.weight";
    let scaled = other.get(path).unwrap().tensor();
    let scaled = Tensor::from_vec(scaled.shape(), scaled.data().iter().map(|value| value * 1.01).collect());
    other.set(path, scaled);
    weights::save_directory(&b, &other).unwrap();
    let compare = |tolerance| diff(&DiffRequest { a: a.clone(), b: b.clone(), tolerance }).unwrap();
    let found = compare(0.0);
    let apart: Vec<&TensorDifference> = found.tensors.iter().filter(|tensor| !tensor.within).collect();
    assert_eq!((found.equal, found.tensors.len(), apart.len(), apart[0].name.as_str()), (false, set.len(), 1, path));
    assert!((apart[0].relative.unwrap() - 0.01 / 1.01).abs() < 1e-6, "{apart:?}");
    assert!(found.render().contains(path));
    assert!(!compare(0.0098).equal && compare(0.01).equal);
}

#[test]
fn folders_and_files_and_missing_tensors_are_told() {
    let place = tempfile::tempdir().unwrap();
    let (folder, _) = saved(place.path(), "pose:nano", 1);
    let between = |a: PathBuf, b: PathBuf| diff(&DiffRequest { a, b, tolerance: 0.0 });
    let error = between(folder.clone(), fixture("plain.pth")).unwrap_err();
    assert!(error.downcast_ref::<ConvertError>().unwrap().is_usage(), "{error}");
    let empty = place.path().join("empty");
    fs::create_dir(&empty).unwrap();
    assert!(between(folder, empty).unwrap_err().to_string().contains(".safetensors, .pth, .pt"));

    let wrapped = between(fixture("plain.pth"), fixture("wrapped.pth")).unwrap();
    assert!(wrapped.equal && wrapped.tensors.len() == 3);
    let found = between(fixture("plain.pth"), fixture("ordered.pth")).unwrap();
    assert_eq!(found.missing_in_b, ["scale"]);
    assert_eq!(found.missing_in_a, ["bn.bias", "bn.running_var", "bn.weight", "conv.bias"]);
    assert_eq!(found.misshapen.len(), 2);
    let text = found.render();
    assert!(text.contains("of another size: conv.weight [2, 3, 1, 2] and [2, 1, 3, 3]"), "{text}");
    assert!(text.contains("0 of 7 tensors equal, exactly"), "{text}");
}

use std::fs;

use proptest::prelude::*;

use super::*;

fn sample() -> Checkpoint {
    let values = [1.5, -0.0, f32::NAN, f32::INFINITY, 1e-42, 3.0];
    let matrix = Tensor::from_vec(Shape::new(1, 1, 2, 3), values.to_vec());
    let vector = Tensor::from_vec(Shape::new(1, 2, 1, 1), vec![0.25, 0.5]);
    let state = json!({ "step": 17, "generator": [1, 2, u64::MAX], "b": { "z": 1, "a": -1 } });
    Checkpoint { tensors: vec![("pose:w".to_owned(), vec![2, 3], matrix), ("depth:b".to_owned(), vec![2], vector)], state }
}

fn bits(checkpoint: &Checkpoint) -> Vec<(String, Vec<usize>, Vec<u32>)> {
    let convert = |(name, dims, tensor): &(String, Vec<usize>, Tensor<f32>)| {
        (name.clone(), dims.clone(), tensor.data().iter().map(|v| v.to_bits()).collect())
    };
    let mut all: Vec<_> = checkpoint.tensors.iter().map(convert).collect();
    all.sort();
    all
}

#[test]
fn round_trip_keeps_every_bit_and_the_state() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    sample().write(&path).unwrap();
    let back = Checkpoint::read(&path).unwrap();
    assert_eq!(bits(&back), bits(&sample()));
    assert_eq!(back.state, sample().state);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays");
}

#[test]
fn equal_content_gives_equal_bytes_in_any_order() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    sample().write(&a).unwrap();
    let mut turned = sample();
    turned.tensors.reverse();
    turned.write(&b).unwrap();
    assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap());
    assert_eq!(hash(&a).unwrap(), hash(&b).unwrap());
    turned.state["step"] = json!(18);
    turned.write(&b).unwrap();
    assert_ne!(hash(&a).unwrap(), hash(&b).unwrap());
}

#[test]
fn every_truncation_is_refused() {
    let path = Path::new("cut");
    let bytes = sample().to_bytes(path).unwrap();
    for len in 0..bytes.len() {
        let message = Checkpoint::parse(&bytes[..len], path).unwrap_err().to_string();
        assert!(message.starts_with("cut: not a usable checkpoint"), "{message}");
    }
}

#[test]
fn short_and_foreign_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c");
    let refusal = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        Checkpoint::read(&path).unwrap_err().to_string()
    };
    assert!(refusal(b"abc").contains("only 3 bytes long"));
    assert!(refusal(b"\x89PNG\r\n\x1a\nxxxxxxxxxxxx").contains("no believable header"));
    assert!(refusal(&[0, 1, 0, 0, 0, 0, 0, 0, b'{']).contains("cut short"));
    let data = 1.0_f32.to_le_bytes();
    let view = TensorView::new(Dtype::F32, vec![1], &data).unwrap();
    let foreign = safetensors::serialize([("w", view)], None).unwrap();
    assert!(refusal(&foreign).contains("without training state"));
    assert!(Checkpoint::read(folder.path()).is_err());
    let missing = Checkpoint::read(&folder.path().join("none")).unwrap_err().to_string();
    assert!(missing.contains("name the folder of a run"), "{missing}");
}

#[test]
fn a_full_disk_keeps_the_previous_checkpoint() {
    let full = Path::new("/dev/full");
    if !full.exists() {
        eprintln!("skipped: no /dev/full here");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    sample().write(&path).unwrap();
    let before = hash(&path).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink(full, folder.path().join(".checkpoint.safetensors.dimode.tmp")).unwrap();
    let mut next = sample();
    next.state["step"] = json!(18);
    let message = next.write(&path).unwrap_err().to_string();
    assert!(message.contains("free some space"), "{message}");
    assert_eq!(hash(&path).unwrap(), before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file is gone");
}

#[test]
fn a_file_where_the_folder_should_be_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "x").unwrap();
    let message = sample().write(&file.join("checkpoint.safetensors")).unwrap_err().to_string();
    assert!(message.contains("cannot be written"), "{message}");
}

#[test]
#[should_panic(expected = "two tensors are called")]
fn equal_names_are_a_programming_error() {
    let mut twice = sample();
    twice.tensors.push(twice.tensors[0].clone());
    let _ = twice.to_bytes(Path::new("x"));
}

proptest! {
    #[test]
    fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Checkpoint::parse(&bytes, Path::new("x")).is_err());
    }

    #[test]
    fn one_changed_byte_is_noticed(at in 0_usize..2000, flip in 1_u8..=255) {
        let mut bytes = sample().to_bytes(Path::new("x")).unwrap();
        let at = at % bytes.len();
        bytes[at] ^= flip;
        if let Ok(read) = Checkpoint::parse(&bytes, Path::new("x")) {
            // White space in the header is the one thing without meaning.
            prop_assert_eq!(bits(&read), bits(&sample()));
            prop_assert_eq!(read.state, sample().state);
        }
    }

    #[test]
    fn numbers_of_the_state_keep_their_bits(value in any::<f64>(), count in any::<i64>()) {
        let state = json!({ "value": value.to_bits(), "count": count });
        let checkpoint = Checkpoint { tensors: Vec::new(), state: state.clone() };
        let bytes = checkpoint.to_bytes(Path::new("x")).unwrap();
        prop_assert_eq!(Checkpoint::parse(&bytes, Path::new("x")).unwrap().state, state);
    }
}

#[test]
#[should_panic(expected = "the state holds a fraction")]
fn fractions_in_the_state_are_a_programming_error() {
    let checkpoint = Checkpoint { tensors: Vec::new(), state: json!({ "rate": [0.1] }) };
    let _ = checkpoint.to_bytes(Path::new("x"));
}

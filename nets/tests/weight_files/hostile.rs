//! Files that are cut, damaged or made to harm: an error each time, and no memory beyond the size of the file.

use dimode_nets::weights;

use crate::archive::{Archive, Pickle};
use crate::{bytes, refusal};

/// A vector of three values in storage 0.
fn vector(pickle: Pickle, name: &str) -> Pickle {
    pickle.tensor(name, ("0", 3), 0, &[3], &[1])
}

fn archive(pickle: Vec<u8>) -> Archive {
    Archive::of(&pickle, &[&[1.0, 2.0, 3.0]])
}

fn good() -> Archive {
    archive(vector(Pickle::dictionary(), "a").end())
}

#[track_caller]
fn refused(pickle: Vec<u8>, part: &str) {
    let message = refusal(&archive(pickle).bytes());
    assert!(message.contains(part), "'{part}' is not in: {message}");
}

#[test]
fn archives_made_by_hand_are_read_also_in_the_form_for_large_files() {
    for large in [false, true] {
        let file = weights::parse_file(&Archive { large, ..good() }.bytes(), "file").unwrap();
        assert_eq!((file.tensors[0].name.as_str(), file.tensors[0].values.as_slice()), ("a", &[1.0, 2.0, 3.0][..]));
    }
}

#[test]
fn files_cut_anywhere_are_errors() {
    for name in ["plain.pth", "trained.pth", "malicious.pth", "legacy.pth"] {
        let whole = bytes(name);
        for length in 0..whole.len() {
            assert!(weights::parse_file(&whole[..length], "cut").is_err(), "{name}: {length}");
        }
    }
    let whole = Archive { large: true, ..good() }.bytes();
    assert!((0..whole.len()).all(|length| weights::parse_file(&whole[..length], "cut").is_err()));
}

#[test]
fn one_changed_byte_of_a_storage_or_of_the_pickle_is_noticed() {
    let whole = good().bytes();
    let place = |part: &[u8]| whole.windows(part.len()).position(|window| window == part).unwrap();
    for at in [place(&2f32.to_le_bytes()), place(b"cpu")] {
        let mut changed = whole.clone();
        changed[at] ^= 1;
        let message = refusal(&changed);
        assert!(message.contains("checksum"), "{message}");
    }
}

#[test]
fn archives_that_torch_does_not_write_are_refused() {
    let message = |change: fn(Archive) -> Archive| refusal(&change(good()).bytes());
    let first = |change: fn(&mut crate::archive::Entry)| {
        let mut archive = good();
        change(&mut archive.entries[0]);
        refusal(&archive.bytes())
    };
    assert!(first(|entry| entry.method = 8).contains("'x/data.pkl' is compressed"));
    assert!(first(|entry| entry.flags = 1).contains("'x/data.pkl' is encrypted"));
    assert!(first(|entry| entry.name = "y.txt".into()).contains("no entry '*/data.pkl'"));
    assert!(message(|archive| archive.with("x/data/0", b"")).contains("'x/data/0' comes twice"));
    assert!(message(|archive| archive.with("x/code/a.py", b"")).contains("TorchScript"));
    let big = |mut archive: Archive| {
        archive.entries[1].data = b"big".to_vec();
        archive
    };
    assert!(message(big).contains("most significant byte first"));
    let shorter = |mut archive: Archive| {
        archive.entries[2].data.truncate(8);
        archive
    };
    assert!(message(shorter).contains("'x/data/0' has another length than the pickle says"));
    let without = |mut archive: Archive| {
        archive.entries.truncate(2);
        archive
    };
    assert!(message(without).contains("no entry 'x/data/0'"));
}

#[test]
fn entries_longer_than_the_file_are_refused() {
    let whole = good().bytes();
    let list = whole.windows(4).position(|window| window == b"PK\x01\x02").unwrap();
    for length in [1u32 << 31, u32::MAX - 1] {
        let mut changed = whole.clone();
        for at in [list + 20, list + 24] {
            changed[at..at + 4].copy_from_slice(&length.to_le_bytes());
        }
        assert!(refusal(&changed).contains("is longer than the file"));
    }
}

#[test]
fn tensors_that_claim_more_than_their_storage_holds_are_refused() {
    let huge = 1i64 << 40;
    for (offset, dims, strides) in [
        (0, &[4i64][..], &[1i64][..]),
        (1, &[3], &[1]),
        (0, &[2], &[3]),
        (0, &[huge], &[0]),
        (0, &[huge, huge], &[0, 0]),
        (0, &[1, i64::MAX, i64::MAX], &[1, 1, 1]),
        (i64::MAX, &[1], &[1]),
        (i64::MAX, &[2], &[i64::MAX]),
    ] {
        let pickle = Pickle::dictionary().tensor("a", ("0", 3), offset, dims, strides).end();
        refused(pickle, "'a' of dimensions");
    }
    // Nothing is held by an empty tensor, however long its other sides are.
    let empty = Pickle::dictionary().tensor("a", ("0", 3), 0, &[0, huge, huge], &[huge, huge, 1]).end();
    assert!(weights::parse_file(&archive(empty).bytes(), "file").unwrap().tensors[0].values.is_empty());
    let described =
        |offset, dims: &[i64], strides: &[i64]| Pickle::dictionary().tensor("a", ("0", 3), offset, dims, strides).end();
    for pickle in [described(-1, &[1], &[1]), described(0, &[-3], &[1]), described(0, &[3], &[-1]), described(0, &[3], &[1, 1])] {
        refused(pickle, "a tensor that is not described as one");
    }
    refused(Pickle::dictionary().tensor("a", ("0", huge), 0, &[3], &[1]).end(), "another length than the pickle says");
    // Nothing has no place that could be outside.
    let empty = Pickle::dictionary().tensor("a", ("0", 3), 9, &[0, huge], &[1, 1]).end();
    assert_eq!(weights::parse(&archive(empty).bytes(), "file").unwrap()[0].dims, [0, 1 << 40]);
}

#[test]
fn many_names_of_one_storage_may_not_fill_the_memory() {
    let values = vec![1f32; 4000];
    let named = |count: usize| {
        let all = (0..count).fold(Pickle::dictionary(), |pickle, i| pickle.tensor(&i.to_string(), ("0", 4000), 0, &[4000], &[1]));
        Archive::of(&all.end(), &[&values]).bytes()
    };
    assert_eq!(weights::parse(&named(2), "file").unwrap().len(), 2);
    assert!(refusal(&named(40)).contains("number of values in all tensors together over the limit"));
}

#[test]
fn names_outside_the_list_end_the_reading() {
    for (code, name) in [
        (&b"cos\nsystem\nX\x02\0\0\0ls\x85R"[..], "os.system"),
        (b"cbuiltins\neval\n", "builtins.eval"),
        (b"X\x02\0\0\0osX\x06\0\0\0system\x93", "os.system"),
        (b"ctorch._utils\n_rebuild_tensor\n", "torch._utils._rebuild_tensor"),
        (b"cnumpy.core.multiarray\nscalar\n", "numpy.core.multiarray.scalar"),
        (b"ctorch\nload\n", "torch.load"),
    ] {
        refused(Pickle::dictionary().text("a").raw(code).end(), &format!("names '{name}': executable content is refused"));
    }
    // Whatever a file holds, a message is one line of moderate length.
    let long = [b"c", "\u{1b}[2J\u{7}".repeat(5000).as_bytes(), b"\nx\n"].concat();
    let message = refusal(&archive(Pickle::dictionary().raw(&long).end()).bytes());
    assert!(message.len() < 400 && !message.contains('\u{1b}'), "{message}");
}

#[test]
fn instructions_that_weights_do_not_need_end_the_reading() {
    for code in [b'i', b'o', b'P', 0x82, 0x83, 0x84, 0x92, b'2', b'1', b'V', b'S', b'I', b'L', b'p', b'g', 0x96, 0x97, 0xff] {
        refused(Pickle::dictionary().raw(&[code]).end(), &format!("instruction {code:#04x} at byte 4"));
    }
}

#[test]
fn calls_that_do_not_fit_end_the_reading() {
    let after = |code: &[u8]| Pickle::dictionary().text("a").raw(code).end();
    for (code, part) in [
        (&b"ccollections\nOrderedDict\nK\x01\x85R"[..], "arguments that do not fit"),
        (b"ctorch\nFloatStorage\n)R", "arguments that do not fit"),
        (b"ctorch._utils\n_rebuild_tensor_v2\n)\x81", "arguments that do not fit"),
        (b"ctorch._utils\n_rebuild_parameter\n(NNNtR", "arguments that do not fit"),
        (b"cargparse\nNamespace\n)R", "arguments that do not fit"),
        (b"ccollections\nOrderedDict\nK\x01R", "arguments that are no tuple"),
        (b"K\x01)R", "a call of something that is no name"),
        (b"K\x01Q", "a reference that names no storage"),
        (b"K\x01}b", "attributes that weights do not have"),
        (b"}}X\x04\0\0\0evilK\x01sb", "attributes that weights do not have"),
        (b"}K\x01b", "attributes that are no dictionary"),
        (b"K\x01K\x02a", "items for something that takes none"),
        (b"]K\x01K\x02s", "items for something that takes none"),
        (b"}(K\x01u", "a key without a value"),
        (b"h\x07", "a value that was not kept"),
        (b"\x80\x06", "a protocol of pickles that is not known"),
        (b"X\x01\0\0\0\xff", "text that is not UTF-8"),
    ] {
        refused(after(code), part);
    }
    refused(b"\x80\x02t.".to_vec(), "no mark on the stack");
    refused(b"\x80\x02}(0.".to_vec(), "nothing on the stack");
    refused(b"\x80\x02q\0.".to_vec(), "nothing to keep");
    refused(b"\x80\x02}".to_vec(), "it ends within its pickle");
    refused(b"\x80\x02X\xff\xff\xff\x7fabc".to_vec(), "it ends within its pickle");
    refused(b"\x80\x04\x8d\xff\xff\xff\xff\xff\xff\xff\xffabc".to_vec(), "it ends within its pickle");
}

#[test]
fn names_no_module_can_have_are_refused() {
    refused(vector(Pickle::dictionary(), "a\u{1b}[2J").end(), "holds an entry 'a?[2J'");
    refused(vector(Pickle::dictionary(), &"x".repeat(2000)).end(), "xxx...', a name that is too long");
}

#[test]
fn dictionaries_without_tensors_tell_what_they_hold() {
    refused(Pickle::dictionary().text("epoch").number(3).text("best").number(4).end(), "its keys are epoch, best;");
    refused(Pickle::dictionary().end(), "no dictionary of tensors: it is empty;");
    refused(b"\x80\x02N.".to_vec(), "no dictionary of tensors: None;");
    // A list in itself has no end, but is no dictionary either.
    refused(b"\x80\x02]q\0h\0a.".to_vec(), "a list of 1");
}

#[test]
fn a_key_that_comes_twice_has_the_later_value() {
    let pickle = vector(Pickle::dictionary().text("a").number(1), "a").text("epoch").number(1).text("epoch").number(2).end();
    let file = weights::parse_file(&archive(pickle).bytes(), "file").unwrap();
    assert_eq!((file.tensors.len(), file.ignored.len(), file.ignored[0].what.as_str()), (1, 1, "2"));
}

#[test]
fn depth_and_number_of_values_are_bounded() {
    // A hundred thousand lists in each other are as flat as any other values.
    let deep = [&b"\x80\x02"[..], &b"]".repeat(100_000), &b"a".repeat(99_999), b"."].concat();
    refused(deep, "a list of 1");
    let many = [&b"\x80\x02"[..], &b"]".repeat((1 << 20) + 1), b"."].concat();
    refused(many, "number of values in its pickle over the limit of 1048576");
    let open = [&b"\x80\x02"[..], &b"(".repeat(1025), b"."].concat();
    refused(open, "number of open containers in its pickle over the limit of 1024");
    let kept = [&b"\x80\x04]"[..], &[0x94].repeat((1 << 20) + 1), b"."].concat();
    refused(kept, "number of values kept in its pickle over the limit");
    let stacked = [&b"\x80\x02]q\0"[..], &b"h\0".repeat(1 << 20), b"."].concat();
    refused(stacked, "number of values on the stack of its pickle over the limit");
    let long = [&b"\x80\x02"[..], &vec![b'0'; 17 << 20], b"."].concat();
    refused(long, "pickle in bytes over the limit");
}

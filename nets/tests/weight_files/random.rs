//! Random bytes and random changes: an error or a value, never a panic.

use dimode_nets::weights;
use proptest::collection::vec;
use proptest::prelude::*;

use crate::archive::{Archive, Pickle};
use crate::bytes;

/// The instructions that the reader knows, and a few that it does not.
const CODES: &[u8] = b".NJKMGXBC(])}tldaesuqrhjcQRb0\x80\x81\x85\x86\x87\x88\x89\x8a\x8b\x8c\x8d\x8e\x8f\x90\x91\x93\x94\x95i2";

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn random_bytes_behind_any_beginning(start in 0..5usize, rest in vec(any::<u8>(), 0..300)) {
        let starts: [&[u8]; 5] = [b"", b"PK\x03\x04", b"\x80\x02", b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19", b"\x20\0\0\0\0\0\0\0{"];
        let _ = weights::parse_file(&[starts[start], &rest].concat(), "random");
    }

    #[test]
    fn changed_bytes_of_a_real_file(changes in vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let mut whole = bytes("trained.pth");
        for (place, value) in changes {
            let place = place.index(whole.len());
            whole[place] = value;
        }
        let _ = weights::parse_file(&whole, "changed");
    }

    /// Pickles behind a right checksum, as a hostile writer makes them.
    #[test]
    fn random_programs(code in vec((prop::sample::select(CODES), vec(0..4u8, 0..5)), 0..60)) {
        let program: Vec<u8> = code.into_iter().flat_map(|(code, rest)| [vec![code], rest].concat()).collect();
        let pickle = Pickle::dictionary().tensor("a", ("0", 3), 0, &[3], &[1]).raw(&program).end();
        let _ = weights::parse_file(&Archive::of(&pickle, &[&[1.0, 2.0, 3.0]]).bytes(), "program");
    }

    #[test]
    fn changed_bytes_of_a_real_pickle(changes in vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let mut pickle = (0..4).fold(Pickle::dictionary(), |p, i| p.tensor(&i.to_string(), ("0", 6), i, &[2, 1], &[3, 1])).end();
        for (place, value) in changes {
            let place = place.index(pickle.len());
            pickle[place] = value;
        }
        let _ = weights::parse_file(&Archive::of(&pickle, &[&[1.0; 6]]).bytes(), "changed");
    }

    /// Views with any offset, dimensions and strides: inside the storage they are what indexing says, outside an error.
    #[test]
    fn views_are_what_indexing_says(offset in 0..12i64, axes in vec((0..4i64, 0..8i64), 0..4)) {
        let (dims, strides): (Vec<i64>, Vec<i64>) = axes.iter().copied().unzip();
        let pickle = Pickle::dictionary().tensor("a", ("0", 24), offset, &dims, &strides).end();
        let base: Vec<f32> = (0..24u8).map(f32::from).collect();
        let places = axes.iter().rev().fold(vec![0], |inner, &(side, stride)| {
            (0..side).flat_map(|i| inner.iter().map(move |place| place + i * stride)).collect::<Vec<i64>>()
        });
        let places: Vec<i64> = places.into_iter().map(|place| place + offset).collect();
        let inside = places.len() <= 24 && places.iter().all(|&place| place < 24);
        match weights::parse(&Archive::of(&pickle, &[&base]).bytes(), "view") {
            Ok(read) => {
                prop_assert!(inside);
                prop_assert_eq!(&read[0].values, &places.iter().map(|&place| place as f64).collect::<Vec<_>>());
            }
            Err(error) => prop_assert!(!inside, "{}", error),
        }
    }
}

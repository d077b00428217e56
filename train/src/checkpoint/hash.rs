//! A small hash to compare files and to notice damage; not a defence against intent.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::CheckpointError;

/// 64-bit FNV-1a over 8-byte words (the last one padded with zeros), then the length: one multiplication per word.
///
/// Each call of [`Fnv::add`] is hashed as one piece, so that moving a byte from one piece to the next changes the result.
#[derive(Clone, Copy, Debug)]
pub struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    /// Adds one piece.
    pub fn add(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        for word in words {
            self.mix(u64::from_le_bytes(*word));
        }
        let mut last = [0_u8; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.mix(u64::from_le_bytes(last));
        self.mix(bytes.len() as u64);
    }

    fn mix(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3);
        // A product moves bits upwards only; the rotation lets high bits reach low ones.
        self.0 = self.0.rotate_left(29);
    }

    /// The hash so far.
    pub fn value(&self) -> u64 {
        self.0
    }

    /// The hash so far as sixteen hexadecimal digits.
    pub fn hex(&self) -> String {
        format!("{:016x}", self.0)
    }
}

/// Hash of a file's bytes as sixteen hexadecimal digits: equal runs have equal ones.
///
/// **Errors** [`CheckpointError::Read`].
pub fn hash(path: &Path) -> Result<String, CheckpointError> {
    let fail = |source| CheckpointError::read(path, source);
    let mut file = File::open(path).map_err(fail)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(fail)?;
    let mut hash = Fnv::default();
    hash.add(&bytes);
    Ok(hash.hex())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pieces: &[&[u8]]) -> u64 {
        let mut hash = Fnv::default();
        for piece in pieces {
            hash.add(piece);
        }
        hash.value()
    }

    #[test]
    fn every_bit_and_every_border_counts() {
        let base = [7_u8; 37];
        let first = of(&[&base]);
        for bit in 0..base.len() * 8 {
            let mut changed = base;
            changed[bit / 8] ^= 1 << (bit % 8);
            assert_ne!(of(&[&changed]), first, "bit {bit}");
        }
        assert_ne!(of(&[b"ab", b"c"]), of(&[b"a", b"bc"]));
        assert_ne!(of(&[b"a"]), of(&[b"a\0"]));
    }
}

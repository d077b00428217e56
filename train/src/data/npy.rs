//! Maps as NPY files, the form of arrays of 32-bit floats that Python programs read.

use std::path::Path;

use super::{DataError, Map, write_atomic};

/// First bytes of the form, version 1.0.
const MAGIC: [u8; 8] = *b"\x93NUMPY\x01\x00";
/// What the header's length, magic included, is a multiple of.
const ALIGNMENT: usize = 64;

/// A map as the bytes of an NPY file: version 1.0, little-endian 32-bit floats, rows from the top, shape (height, width).
pub fn encode_npy(map: &Map) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}), }}", map.height, map.width);
    // Two bytes of length, and a line end that is part of the header.
    let used = MAGIC.len() + 2 + header.len() + 1;
    header.extend(std::iter::repeat_n(' ', used.next_multiple_of(ALIGNMENT) - used));
    header.push('\n');
    let length = u16::try_from(header.len()).expect("two numbers make a short header");
    let mut bytes = Vec::with_capacity(MAGIC.len() + 2 + header.len() + 4 * map.data.len());
    bytes.extend(MAGIC);
    bytes.extend(length.to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(map.data.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// Writes a map in the form of [`encode_npy`], whole or not at all.
///
/// **Errors** [`DataError::Write`].
pub fn write_npy(path: &Path, map: &Map) -> Result<(), DataError> {
    write_atomic(path, &encode_npy(map))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_as_published() {
        let bytes = encode_npy(&Map::from_vec(2, 3, vec![1.0, -2.0, 0.5, 3.0, 4.0, f32::INFINITY]));
        assert_eq!(bytes[..10], *b"\x93NUMPY\x01\x00\x76\x00");
        assert_eq!(bytes.len(), 128 + 24);
        let header = std::str::from_utf8(&bytes[10..128]).unwrap();
        assert_eq!(header.trim_end(), "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }");
        assert!(header.ends_with(" \n"));
        assert_eq!(bytes[128..136], [0, 0, 0x80, 0x3F, 0, 0, 0, 0xC0]);
        assert_eq!(bytes[148..], f32::INFINITY.to_le_bytes());
    }

    #[test]
    fn data_begin_at_a_multiple_of_64_whatever_the_size() {
        for (height, width) in [(1, 1), (9, 10), (99, 1000), (12_345, 1)] {
            let bytes = encode_npy(&Map::from_vec(height, width, vec![0.0; height * width]));
            assert_eq!((bytes.len() - 4 * height * width) % ALIGNMENT, 0, "{height}x{width}");
        }
    }
}

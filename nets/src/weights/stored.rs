//! What a file of weights holds.

use std::fmt;

/// How a file stores its tensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A header of names, dimensions and places, then the numbers.
    Safetensors,
    /// The zip file that `torch.save` writes.
    PyTorch,
}

impl fmt::Display for Form {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Safetensors => "safetensors",
            Self::PyTorch => "PyTorch zip file",
        })
    }
}

/// Everything that was read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightFile {
    /// How the file stores its tensors.
    pub form: Form,
    /// The key under which the dictionary of tensors was found, when it is not the whole file.
    pub under: Option<String>,
    /// The tensors without the counters of batches.
    pub tensors: Vec<StoredTensor>,
    /// How many counters of batches (`num_batches_tracked`) were left out; no network here uses them.
    pub counters: usize,
    /// Entries that are no tensors of the network: sizes of images, states of optimisers.
    pub ignored: Vec<Ignored>,
}

/// An entry of a file that was not read as a tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ignored {
    /// Its key.
    pub name: String,
    /// Its value, or what it is.
    pub what: String,
}

/// One tensor of a file, widened to f64.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTensor {
    /// Name inside the file, as written.
    pub name: String,
    /// The type that the values are stored in.
    pub element: ElementType,
    /// Dimensions, rank kept.
    pub dims: Vec<usize>,
    /// Values, row-major.
    pub values: Vec<f64>,
}

/// The type that values are stored in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElementType {
    /// IEEE double precision.
    F64,
    /// IEEE single precision.
    F32,
    /// IEEE half precision.
    F16,
    /// The upper half of single precision.
    BF16,
    /// Signed, 8 bytes; widened exactly up to 2^53.
    I64,
    /// Signed, 4 bytes.
    I32,
    /// Signed, 2 bytes.
    I16,
    /// Signed, 1 byte.
    I8,
    /// Unsigned, 1 byte.
    U8,
    /// One byte, 0 or 1.
    Bool,
}

impl ElementType {
    /// Bytes of one value.
    pub fn size(self) -> usize {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 | Self::I32 => 4,
            Self::F16 | Self::BF16 | Self::I16 => 2,
            Self::I8 | Self::U8 | Self::Bool => 1,
        }
    }

    /// Whether it can hold weights.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F64 | Self::F32 | Self::F16 | Self::BF16)
    }

    /// Appends the values of little-endian bytes; what is left after the last whole value is not looked at.
    pub(super) fn decode(self, bytes: &[u8], values: &mut Vec<f64>) {
        match self {
            Self::F64 => values.extend(words(bytes).map(f64::from_le_bytes)),
            Self::F32 => values.extend(words(bytes).map(|b| f64::from(f32::from_le_bytes(b)))),
            Self::F16 => values.extend(words(bytes).map(|b| half(u16::from_le_bytes(b)))),
            Self::BF16 => values.extend(words(bytes).map(|b| f64::from(f32::from_bits(u32::from(u16::from_le_bytes(b)) << 16)))),
            Self::I64 => values.extend(words(bytes).map(|b| i64::from_le_bytes(b) as f64)),
            Self::I32 => values.extend(words(bytes).map(|b| f64::from(i32::from_le_bytes(b)))),
            Self::I16 => values.extend(words(bytes).map(|b| f64::from(i16::from_le_bytes(b)))),
            Self::I8 => values.extend(words(bytes).map(|b| f64::from(i8::from_le_bytes(b)))),
            Self::U8 | Self::Bool => values.extend(bytes.iter().map(|&b| f64::from(b))),
        }
    }
}

impl fmt::Display for ElementType {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            Self::F64 => "F64",
            Self::F32 => "F32",
            Self::F16 => "F16",
            Self::BF16 => "BF16",
            Self::I64 => "I64",
            Self::I32 => "I32",
            Self::I16 => "I16",
            Self::I8 => "I8",
            Self::U8 => "U8",
            Self::Bool => "BOOL",
        })
    }
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.as_chunks::<N>().0.iter().copied()
}

/// The value of an IEEE half: one sign bit, five of exponent (bias 15), ten of mantissa.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, mantissa) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    sign * match exponent {
        0 => mantissa * 2f64.powi(-24),
        31 if mantissa == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + mantissa) * 2f64.powi(exponent - 25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_widened_exactly() {
        let worked = [
            (0x0000, 0.0),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0400, 2f64.powi(-14)),
            (0x03ff, 1023.0 / 1024.0 * 2f64.powi(-14)),
            (0x0001, 2f64.powi(-24)),
            (0x3555, 0.333_251_953_125),
            (0xfc00, f64::NEG_INFINITY),
        ];
        for (bits, value) in worked {
            assert_eq!(half(bits), value, "{bits:#06x}");
        }
        assert!(half(0x8000).is_sign_negative() && half(0x7e00).is_nan());
    }

    #[test]
    fn every_type_reads_little_endian_values() {
        let read = |element: ElementType, bytes: &[u8]| {
            assert_eq!(bytes.len(), element.size());
            let mut values = Vec::new();
            element.decode(bytes, &mut values);
            assert_eq!(values.len(), 1);
            values[0]
        };
        assert_eq!(read(ElementType::F64, &(-2.5f64).to_le_bytes()), -2.5);
        assert_eq!(read(ElementType::F32, &0.1f32.to_le_bytes()), f64::from(0.1f32));
        assert_eq!(read(ElementType::BF16, &[0x49, 0x40]), 3.140_625);
        assert_eq!(read(ElementType::I64, &(-(1i64 << 53)).to_le_bytes()), -9_007_199_254_740_992.0);
        assert_eq!(read(ElementType::I32, &(-7i32).to_le_bytes()), -7.0);
        assert_eq!(read(ElementType::I16, &(-7i16).to_le_bytes()), -7.0);
        assert_eq!(read(ElementType::I8, &[0xff]), -1.0);
        assert_eq!(read(ElementType::U8, &[0xff]), 255.0);
        assert_eq!(read(ElementType::Bool, &[1]), 1.0);
    }
}

//! The zip files that `torch.save` writes: a pickle of the structure, and one entry of raw numbers for each storage.
//!
//! The file is a stranger's: [`zip`] finds entries and compares their checksums, [`machine`] runs the pickle on an allow-list of
//! instructions and names, [`state`] finds the dictionary of tensors, and [`storage`] reads the numbers. Memory stays within a few
//! times the length of the file: lengths are compared with what is there before anything is made.

mod bytes;
mod error;
mod machine;
mod names;
mod state;
mod storage;
mod value;
mod zip;

pub use error::PthError;

use super::WeightFile;
use zip::Archive;

/// Begins every zip file, before its first entry.
const ZIP: &[u8] = b"PK\x03\x04";
/// Begins every pickle of protocol 2 and later, before the number of the protocol.
const PICKLE: u8 = 0x80;
/// Begins the files of `torch.save` before there were zip files: a pickle of the number 0x1950a86a20f9469cfc6c.
const OLD: &[u8] = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19";
/// Longest pickle that is read; that of a network with thousands of tensors has half a megabyte.
const LONGEST_PICKLE: usize = 16 << 20;

/// Whether bytes begin as files of PyTorch do, of today or older.
pub(super) fn is_one(bytes: &[u8]) -> bool {
    // A safetensors file begins with the length of its header in eight bytes, which may look like the first two of a pickle.
    let safetensors = matches!(bytes, [_, _, _, _, 0, 0, 0, 0, b'{', ..]);
    bytes.starts_with(ZIP) || matches!(bytes, [PICKLE, 2..=5, ..]) && !safetensors
}

/// The dictionary of tensors of a file.
pub(super) fn parse(bytes: &[u8]) -> Result<WeightFile, PthError> {
    if bytes.starts_with(OLD) {
        return Err(PthError::Old);
    }
    if !bytes.starts_with(ZIP) {
        return Err(PthError::BarePickle);
    }
    let archive = Archive::open(bytes)?;
    let root = archive.root()?;
    if archive.has(&format!("{root}/constants.pkl")) || archive.has_under(&format!("{root}/code/")) {
        return Err(PthError::TorchScript);
    }
    let order = format!("{root}/byteorder");
    if archive.has(&order) && archive.data(&order)? != b"little" {
        return Err(PthError::ByteOrder);
    }
    let pickle = archive.data(&format!("{root}/data.pkl"))?;
    if pickle.len() > LONGEST_PICKLE {
        return Err(PthError::TooLarge { what: "pickle in bytes", limit: LONGEST_PICKLE });
    }
    state::read(&machine::run(pickle)?, &mut storage::Storages::new(&archive, &root))
}

//! Files that appear whole or not at all, with the data's errors.

use std::path::Path;

use dimode_nets::replace_file;

use super::DataError;

/// Writes `bytes` to `path` by [`replace_file`], so that a reader (or an interruption) sees the old file or the new one, never a
/// part.
///
/// **Errors** [`DataError::Write`] when the system refuses; an old file stays as it was.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    replace_file(path, bytes).map_err(|error| DataError::write(path, error))
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::Write;

    use super::*;

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none").join("a.txt");
        let message = write_atomic(&path, b"x").unwrap_err().to_string();
        assert!(message.contains("a.txt: cannot be written"), "{message}");
        assert!(message.contains("create the parent folder"), "{message}");
    }

    #[test]
    fn a_full_disk_is_told_as_such() {
        let full = Path::new("/dev/full");
        if !full.exists() {
            eprintln!("skipped: no /dev/full here");
            return;
        }
        let error = File::options().write(true).open(full).and_then(|mut file| file.write_all(b"x")).unwrap_err();
        let message = DataError::write(full, error).to_string();
        assert!(message.contains("free some space"), "{message}");
    }
}

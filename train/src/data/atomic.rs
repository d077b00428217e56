//! Files that appear whole or not at all.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use super::DataError;

/// Writes `bytes` to `path`: first to a temporary file in the same folder, then by a rename, so that a reader (or an
/// interruption) sees the old file or the new one, never a part.
///
/// **Errors** [`DataError::Write`] when the system refuses; the temporary file is removed and an old file stays as it was.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    let temporary = temporary_beside(path);
    let result = write_synced(&temporary, bytes).and_then(|()| fs::rename(&temporary, path));
    result.map_err(|error| {
        // Nothing more can be done when even the removal fails; the first error is the one to tell.
        let _ = fs::remove_file(&temporary);
        DataError::write(path, error)
    })
}

fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// A file that says that a folder was made by this program and may be replaced by it.
const MARKER: &str = ".dimode";

/// Makes a folder that [`is_ours`] tells from others.
///
/// **Errors** [`DataError::Write`] when the system refuses.
pub(crate) fn make_ours(folder: &Path) -> Result<(), DataError> {
    let marked =
        fs::create_dir_all(folder).and_then(|()| fs::write(folder.join(MARKER), "Written by dimode, may be replaced by it.\n"));
    marked.map_err(|error| DataError::write(folder, error))
}

/// Whether a folder was made by [`make_ours`].
pub(crate) fn is_ours(folder: &Path) -> bool {
    folder.join(MARKER).is_file()
}

/// The folder beside `path` in which its content is prepared. One that an interrupted command left is removed.
///
/// **Errors** [`DataError::Occupied`] when something else has that name, [`DataError::Write`] when the system refuses.
pub(crate) fn free_staging(path: &Path) -> Result<PathBuf, DataError> {
    let path = std::path::absolute(path).map_err(|error| DataError::write(path, error))?;
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let staging = path.with_file_name(format!("{name}.partial"));
    if staging.exists() {
        if !is_ours(&staging) {
            return Err(DataError::Occupied { path: staging });
        }
        fs::remove_dir_all(&staging).map_err(|error| DataError::write(&staging, error))?;
    }
    Ok(staging)
}

/// A name in the same folder that no other writer uses: process number and a counter.
fn temporary_beside(path: &Path) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!(".{name}.{}-{number}.tmp", std::process::id()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_whole_files_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_atomic(&path, b"old and long").unwrap();
        write_atomic(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn only_our_own_staging_folder_is_removed() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("out");
        let staging = free_staging(&path).unwrap();
        make_ours(&staging).unwrap();
        assert_eq!(free_staging(&path).unwrap(), staging);
        assert!(!staging.exists());
        fs::create_dir(&staging).unwrap();
        let message = free_staging(&path).unwrap_err().to_string();
        assert!(message.contains("out.partial") && staging.exists(), "{message}");
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none").join("a.txt");
        let message = write_atomic(&path, b"x").unwrap_err().to_string();
        assert!(message.contains("a.txt: cannot be written"), "{message}");
        assert!(message.contains("create the parent folder"), "{message}");
    }

    #[test]
    fn a_folder_in_the_way_is_an_error_and_no_temporary_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::create_dir(&path).unwrap();
        assert!(write_atomic(&path, b"x").is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
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

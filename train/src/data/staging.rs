//! Folders that appear whole or not at all.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::DataError;

/// A file that says that a folder was made by this program and may be replaced by it.
const MARKER: &str = ".dimode";

/// What becomes of a folder that is at the place already.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Earlier<'a> {
    /// Only an empty one gives way.
    Keep,
    /// One that an earlier [`Staging::fill`] made is replaced if it holds nothing but these entries and it was asked for.
    Replace {
        /// Names of the entries.
        entries: &'a [&'a str],
        /// Whether it was asked for.
        asked: bool,
    },
}

/// A place for a folder whose content is prepared beside it, in `NAME.partial`.
#[derive(Debug)]
pub(crate) struct Staging<'a> {
    /// The place as the user names it.
    named: PathBuf,
    /// The same, absolute.
    place: PathBuf,
    earlier: Earlier<'a>,
}

impl<'a> Staging<'a> {
    /// A place that must be free: nothing there, an empty folder, or an earlier one that may be replaced. Touches nothing.
    ///
    /// **Errors** [`DataError::Occupied`], [`DataError::NotOurs`] or [`DataError::NotEmpty`] when the place is taken,
    /// [`DataError::StagingTaken`] when `NAME.partial` or `NAME.replaced` is something else, [`DataError::Write`] when a file is there or the system refuses.
    pub fn new(place: &Path, earlier: Earlier<'a>) -> Result<Self, DataError> {
        let named = place.to_owned();
        let place = std::path::absolute(place).map_err(|error| DataError::write(&named, error))?;
        let staging = Self { named, place, earlier };
        staging.check_place()?;
        staging.check_names_beside()?;
        Ok(staging)
    }

    /// Lets `content` write into the folder that then takes the place. What was begun is removed after an error.
    ///
    /// **Errors** those of `content` and of [`Staging::new`].
    pub fn fill<R, E: From<DataError>>(&self, content: impl FnOnce(&Path) -> Result<R, E>) -> Result<R, E> {
        self.check_names_beside()?;
        let partial = self.beside("partial");
        remove_leftover(&partial)?;
        let filled = make_ours(&partial).map_err(E::from).and_then(|()| content(&partial)).and_then(|filled| {
            self.put_in_place(&partial)?;
            Ok(filled)
        });
        if filled.is_err() {
            // The first error is the one to tell.
            let _ = fs::remove_dir_all(&partial);
        }
        filled
    }

    fn check_place(&self) -> Result<(), DataError> {
        let names = match entries(&self.place) {
            Ok(names) => names,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(DataError::write(&self.named, error)),
        };
        let path = self.named.clone();
        match self.earlier {
            _ if names.is_empty() => Ok(()),
            Earlier::Keep => Err(DataError::NotEmpty { path }),
            Earlier::Replace { entries, asked } => {
                let known = |name: &String| name == MARKER || entries.contains(&name.as_str());
                match is_ours(&self.place) && names.iter().all(known) {
                    true if asked => Ok(()),
                    true => Err(DataError::Occupied { path }),
                    false => Err(DataError::NotOurs { path }),
                }
            }
        }
    }

    /// What an interrupted command left may stand there, nothing else.
    fn check_names_beside(&self) -> Result<(), DataError> {
        match ["partial", "replaced"].map(|suffix| self.beside(suffix)).into_iter().find(|path| path.exists() && !is_ours(path)) {
            Some(path) => Err(DataError::StagingTaken { path }),
            None => Ok(()),
        }
    }

    /// Moves the finished folder to its name; an old one steps aside first and is removed last.
    fn put_in_place(&self, partial: &Path) -> Result<(), DataError> {
        let failed = |error| DataError::write(&self.named, error);
        // The work took time: somebody may have put something there.
        self.check_place()?;
        match fs::remove_dir(&self.place) {
            Ok(()) => return fs::rename(partial, &self.place).map_err(failed),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return fs::rename(partial, &self.place).map_err(failed),
            Err(_) => {}
        }
        let old = self.beside("replaced");
        remove_leftover(&old)?;
        fs::rename(&self.place, &old).map_err(|error| DataError::write(&old, error))?;
        if let Err(error) = fs::rename(partial, &self.place) {
            let _ = fs::rename(&old, &self.place);
            return Err(failed(error));
        }
        fs::remove_dir_all(&old).map_err(|error| DataError::write(&old, error))
    }

    fn beside(&self, suffix: &str) -> PathBuf {
        let name = self.place.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        self.place.with_file_name(format!("{name}.{suffix}"))
    }
}

/// Names of everything in a folder, hidden files too.
fn entries(folder: &Path) -> io::Result<Vec<String>> {
    fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect()
}

/// Removes a folder, if there is one, that an interrupted command left.
fn remove_leftover(folder: &Path) -> Result<(), DataError> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(DataError::write(folder, error)),
        _ => Ok(()),
    }
}

/// Makes a folder that [`is_ours`] tells from others.
fn make_ours(folder: &Path) -> Result<(), DataError> {
    let marked =
        fs::create_dir_all(folder).and_then(|()| fs::write(folder.join(MARKER), "Written by dimode, may be replaced by it.\n"));
    marked.map_err(|error| DataError::write(folder, error))
}

fn is_ours(folder: &Path) -> bool {
    folder.join(MARKER).is_file()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORM: &[&str] = &["a"];

    /// Writes `a/TEXT` to `out`, where an earlier folder of that form may be replaced if asked for.
    fn write(out: &Path, text: &str, asked: bool) -> Result<(), DataError> {
        Staging::new(out, Earlier::Replace { entries: FORM, asked })?.fill(|folder| {
            fs::create_dir(folder.join("a")).unwrap();
            fs::write(folder.join("a").join(text), "x").unwrap();
            Ok(())
        })
    }

    fn count(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn a_free_place_or_an_empty_folder_is_taken() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("deep/out");
        write(&out, "1", false).unwrap();
        assert!(out.join("a/1").is_file());
        let empty = place.path().join("empty");
        fs::create_dir(&empty).unwrap();
        write(&empty, "1", false).unwrap();
        assert!(empty.join("a/1").is_file());
        assert_eq!(count(place.path()), 2);
    }

    #[test]
    fn only_a_folder_of_the_same_form_is_replaced_and_only_on_request() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("out");
        write(&out, "1", false).unwrap();
        assert!(matches!(write(&out, "2", false), Err(DataError::Occupied { .. })));
        write(&out, "2", true).unwrap();
        assert!(out.join("a/2").is_file() && !out.join("a/1").exists());
        fs::write(out.join("thesis.txt"), "precious").unwrap();
        assert!(matches!(write(&out, "3", true), Err(DataError::NotOurs { .. })));
        assert!(out.join("thesis.txt").exists());
        assert_eq!(count(place.path()), 1);
    }

    #[test]
    fn hidden_files_of_others_are_kept() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("out");
        fs::create_dir_all(out.join(".git")).unwrap();
        for replace in [false, true] {
            assert!(matches!(write(&out, "1", replace), Err(DataError::NotOurs { .. })));
        }
        assert!(matches!(Staging::new(&out, Earlier::Keep), Err(DataError::NotEmpty { .. })));
        assert!(out.join(".git").exists());
    }

    #[test]
    fn what_came_in_the_meantime_is_kept() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("out");
        let staging = Staging::new(&out, Earlier::Keep).unwrap();
        let filled = staging.fill(|_| {
            fs::create_dir(&out).unwrap();
            fs::write(out.join("mine.txt"), "x").unwrap();
            Ok::<_, DataError>(())
        });
        assert!(matches!(filled, Err(DataError::NotEmpty { .. })));
        assert!(out.join("mine.txt").exists());
        assert_eq!(count(place.path()), 1);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let place = tempfile::tempdir().unwrap();
        let staging = Staging::new(&place.path().join("out"), Earlier::Keep).unwrap();
        let failure = staging.fill(|_| Err::<(), _>(DataError::malformed(Path::new("x"), "fails", "nothing")));
        assert!(failure.is_err());
        assert_eq!(count(place.path()), 0);
    }

    #[test]
    fn only_our_own_leftovers_are_removed() {
        let place = tempfile::tempdir().unwrap();
        let (out, partial) = (place.path().join("out"), place.path().join("out.partial"));
        make_ours(&partial).unwrap();
        fs::create_dir_all(partial.join("a/deep")).unwrap();
        write(&out, "1", false).unwrap();
        assert_eq!(count(place.path()), 1);
        fs::create_dir(&partial).unwrap();
        let message = write(&out, "2", true).unwrap_err().to_string();
        assert!(message.contains("out.partial") && partial.exists(), "{message}");
    }

    #[test]
    fn a_place_that_cannot_be_written_is_named() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("file");
        fs::write(&file, "x").unwrap();
        let message = write(&file, "1", true).unwrap_err().to_string();
        assert!(message.contains("file: cannot be written"), "{message}");
        let message = write(&file.join("out"), "1", false).unwrap_err().to_string();
        assert!(message.contains("cannot be written"), "{message}");
        assert!(message.contains("a file is in the way"), "{message}");
    }
}

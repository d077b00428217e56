//! Where trained weights go. Whether they can go there is better known before the training than after it.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use dimode_nets::{ParamSet, weights};
use thiserror::Error;

use crate::data::DataError;
use crate::data::staging::{Earlier, Staging};

/// The files that hold the weights of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// One file, of any name, with the tensors of this file of the network.
    File(&'static str),
    /// A folder with all files that the network has, of these; a folder of nothing else may be replaced.
    Folder(&'static [&'static str]),
}

/// Why weights cannot be written to a place.
#[derive(Debug, Error)]
pub enum TargetError {
    /// Something is there and may not be replaced.
    #[error("{}: already written; name another file, or add --force to replace this one", path.display())]
    AlreadyThere {
        /// The place.
        path: PathBuf,
    },
    /// A folder is there, or the path cannot be that of a file.
    #[error("{}: a folder, but the weights are one file; name a file", path.display())]
    Folder {
        /// The place.
        path: PathBuf,
    },
    /// Something else than a file is there, a device for instance.
    #[error("{}: there, but no ordinary file; name another file", path.display())]
    NotAFile {
        /// The place.
        path: PathBuf,
    },
    /// A path that ends with no name, `..` for instance.
    #[error("{}: does not end with a name; name a folder", path.display())]
    Nameless {
        /// The place.
        path: PathBuf,
    },
}

/// A place for weights.
#[derive(Clone, Debug)]
pub struct Target {
    path: PathBuf,
    form: Form,
    force: bool,
}

impl Target {
    /// A place that weights can be written to: a free one, or with `force` one that holds older weights. Nothing is made or
    /// replaced yet, the folders that lead to the place neither.
    ///
    /// # Errors
    /// [`TargetError`] when something else is there, [`DataError`] when the system refuses.
    pub fn new(path: impl Into<PathBuf>, form: Form, force: bool) -> Result<Self> {
        let target = Target { path: path.into(), form, force };
        target.check()?;
        target.check_writable()?;
        Ok(target)
    }

    /// The place.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the weights of a network; they appear whole or not at all.
    ///
    /// # Errors
    /// As [`Target::new`], for the place may have changed since; what was there stays then.
    pub fn write(&self, params: &ParamSet<f32>) -> Result<()> {
        self.check()?;
        if let Some(parent) = self.path.parent() {
            fs::create_dir_all(parent).map_err(|error| DataError::write(&self.path, error))?;
        }
        match self.form {
            Form::File(name) => {
                let file = params.file(name).with_context(|| format!("the network has no file '{name}'"))?;
                Ok(weights::save(&self.path, file)?)
            }
            Form::Folder(files) => self.staging(files)?.fill(|folder| Ok(weights::save_directory(folder, params)?)),
        }
    }

    /// The place of a folder with these files; only one that such weights were written to before gives way.
    fn staging(&self, files: &'static [&'static str]) -> Result<Staging<'static>, DataError> {
        Staging::new(&self.path, Earlier::Replace { entries: files, asked: self.force })
    }

    fn check(&self) -> Result<()> {
        match self.form {
            Form::File(_) => Ok(self.check_file()?),
            Form::Folder(files) => self.check_folder(files),
        }
    }

    fn check_file(&self) -> Result<(), TargetError> {
        let path = self.path.clone();
        if path.is_dir() || !names_a_file(&path) {
            return Err(TargetError::Folder { path });
        }
        match path.symlink_metadata() {
            Err(_) => Ok(()),
            Ok(_) if !path.is_file() => Err(TargetError::NotAFile { path }),
            Ok(_) if !self.force => Err(TargetError::AlreadyThere { path }),
            Ok(_) => Ok(()),
        }
    }

    fn check_folder(&self, files: &'static [&'static str]) -> Result<()> {
        let path = self.path.clone();
        let named = std::path::absolute(&path).is_ok_and(|path| path.file_name().is_some());
        if !named {
            return Err(TargetError::Nameless { path }.into());
        }
        self.staging(files)?;
        Ok(())
    }

    /// Tries the folder that the place is in, or the nearest one that is there.
    fn check_writable(&self) -> Result<(), DataError> {
        let failed = |error| DataError::write(&self.path, error);
        let absolute = std::path::absolute(&self.path).map_err(failed)?;
        let folder = absolute.ancestors().skip(1).find(|folder| folder.exists()).unwrap_or(&absolute);
        let probe = folder.join(format!(".dimode-{}.tmp", std::process::id()));
        fs::write(&probe, "").and_then(|()| fs::remove_file(&probe)).map_err(failed)
    }
}

/// Whether the text ends with a name: `a/`, `a/.` and `..` do not.
fn names_a_file(path: &Path) -> bool {
    let text = path.to_string_lossy();
    let last = text.rsplit(std::path::is_separator).next();
    path.file_name().is_some_and(|name| Some(name.to_string_lossy().as_ref()) == last)
}

#[cfg(test)]
mod tests {
    use dimode_autodiff::{Shape, Tensor};
    use dimode_nets::{Entry, Kind};

    use super::*;

    const PAIR: Form = Form::Folder(&["one.safetensors", "two.safetensors"]);

    fn params(value: f32) -> ParamSet<f32> {
        let mut set = ParamSet::new();
        for file in ["one", "two"] {
            let entry = Entry::new(vec![3], Kind::Parameter, Tensor::full(Shape::new(1, 3, 1, 1), value));
            set.file_mut(file).insert("weight", entry);
        }
        set
    }

    fn first_value(file: &Path) -> f64 {
        weights::read(file).unwrap()[0].values[0]
    }

    fn entries(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[track_caller]
    fn refused(path: impl Into<PathBuf>, form: Form, force: bool, part: &str) {
        let message = Target::new(path, form, force).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }

    #[test]
    fn one_file_goes_to_a_name_that_can_be_that_of_a_file() {
        let place = tempfile::tempdir().unwrap();
        let file = Form::File("one");
        refused(place.path(), file, true, "name a file");
        for name in ["new/", "new/.", "new/..", ".."] {
            refused(format!("{}/{name}", place.path().display()), file, true, "name a file");
        }
        refused("", file, true, "name a file");
        let path = place.path().join("new/deep/weights");
        let target = Target::new(&path, file, false).unwrap();
        assert!(entries(place.path()).is_empty(), "nothing is made before there are weights");
        target.write(&params(1.0)).unwrap();
        refused(&path, file, false, "already written");
        Target::new(&path, file, true).unwrap().write(&params(2.0)).unwrap();
        assert_eq!(first_value(&path), 2.0);
    }

    #[test]
    fn a_place_that_cannot_be_written_is_named() {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("file"), "x").unwrap();
        for form in [Form::File("one"), PAIR] {
            refused(place.path().join("file/new/weights"), form, true, "weights: cannot be written");
        }
        assert_eq!(entries(place.path()), ["file"]);
    }

    #[test]
    fn several_files_appear_together_and_replace_older_ones_on_request() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("new/pair");
        let target = Target::new(&path, PAIR, false).unwrap();
        assert!(entries(place.path()).is_empty(), "nothing is made before there are weights");
        target.write(&params(1.0)).unwrap();
        refused(&path, PAIR, false, "already written");
        Target::new(&path, PAIR, true).unwrap().write(&params(2.0)).unwrap();
        for file in ["one.safetensors", "two.safetensors"] {
            assert_eq!(first_value(&path.join(file)), 2.0);
        }
        assert_eq!(entries(&place.path().join("new")), ["pair"]);
    }

    #[test]
    fn an_empty_folder_is_free() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("pair");
        fs::create_dir(&path).unwrap();
        Target::new(&path, PAIR, false).unwrap().write(&params(1.0)).unwrap();
        assert_eq!(first_value(&path.join("two.safetensors")), 1.0);
    }

    #[test]
    fn a_folder_with_anything_else_is_never_replaced() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("pair");
        Target::new(&path, PAIR, false).unwrap().write(&params(1.0)).unwrap();
        let target = Target::new(&path, PAIR, true).unwrap();
        fs::write(path.join("000001.png"), "precious").unwrap();
        refused(&path, PAIR, true, "not made by this command");
        let message = target.write(&params(2.0)).unwrap_err().to_string();
        assert!(message.contains("not made by this command"), "{message}");
        assert_eq!(first_value(&path.join("one.safetensors")), 1.0);
        assert_eq!(entries(place.path()), ["pair"]);
        refused(path.join("000001.png"), PAIR, true, "a file is in the way");
        refused(path.join("new/.."), PAIR, true, "does not end with a name");
        for name in ["other.partial", "another.replaced"] {
            fs::create_dir(place.path().join(name)).unwrap();
        }
        refused(place.path().join("other"), PAIR, true, "other.partial");
        refused(place.path().join("another"), PAIR, true, "another.replaced");
    }

    /// The third file cannot be written: its folder is missing.
    #[test]
    fn a_failure_leaves_no_half_of_the_files() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("pair");
        Target::new(&path, PAIR, false).unwrap().write(&params(1.0)).unwrap();
        let target = Target::new(&path, PAIR, true).unwrap();
        let mut broken = params(2.0);
        broken.file_mut("no/such/folder").insert("weight", params(2.0).get("one:weight").unwrap().clone());
        assert!(target.write(&broken).is_err());
        assert_eq!(first_value(&path.join("one.safetensors")), 1.0);
        assert_eq!(entries(place.path()), ["pair"]);
    }
}

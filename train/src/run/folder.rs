//! The folder of a run: names of its files, and when it may be written to.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::config::{Config, ConfigError, LossPreset, StageConfig};
use crate::data::{DataError, write_atomic};

/// Why a folder cannot take or give a run.
#[derive(Debug, Error)]
pub enum RunError {
    /// A finished run is there.
    #[error("{}: a finished run is already there; name another folder with --out, or add --force to replace it", path.display())]
    Finished {
        /// The folder.
        path: PathBuf,
    },
    /// A run that was stopped is there.
    #[error("{}: an unfinished run is already there; continue it with --resume {}, or add --force to begin again", path.display(), path.display())]
    Unfinished {
        /// The folder.
        path: PathBuf,
    },
    /// A configuration is there that the new run would replace, and no run that used it.
    #[error("{}: a config.toml with other settings is already there; name another folder with --out, or add --force to replace it", path.display())]
    OtherSettings {
        /// The folder.
        path: PathBuf,
    },
    /// Something else is there.
    #[error("{}: not empty, and not the folder of a run (no config.toml that 'dimode train' wrote); name another folder with --out", path.display())]
    NotARun {
        /// The folder.
        path: PathBuf,
    },
    /// No run is there.
    #[error("{}: no run found (no {missing}); name the folder that 'dimode train' wrote", path.display())]
    NoRun {
        /// The folder.
        path: PathBuf,
        /// The file that was looked for.
        missing: &'static str,
    },
}

/// The folder of a run. Creating the value touches nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

/// The program, as a command names it.
const PROGRAM: &str = "dimode ";
/// Begins the first line of `config.toml`, which holds the command and tells the folder of a run.
const MARK: &str = "# dimode ";
const CONFIG: &str = "config.toml";
const CHECKPOINT: &str = "checkpoint.safetensors";
const LOG: &str = "log.jsonl";
const METRICS: &str = "metrics.json";
const REPORT: &str = "report.html";

impl RunFolder {
    /// The run at `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Makes the folder for a new run and writes `config.toml`, with the command that asked for the run in its first line. With
    /// `force` the files of an earlier run are removed first; files that no run writes are left alone.
    ///
    /// **Errors** [`RunError`] when a run is there and `force` is not set, or something that is no run; [`DataError`] when the
    /// system refuses.
    pub fn create(path: impl Into<PathBuf>, config: &Config, command: &str, force: bool) -> anyhow::Result<Self> {
        let run = Self::new(path);
        let text = format!("{MARK}{}\n\n{}", command.strip_prefix(PROGRAM).unwrap_or(command), config.to_toml());
        run.check_free(&text, force)?;
        fs::create_dir_all(&run.path).map_err(|error| DataError::write(&run.path, error))?;
        let cleared = if force { run.clear() } else { Ok(()) };
        let written = cleared.and_then(|()| write_atomic(&run.config(), text.as_bytes()));
        written.inspect_err(|_| run.give_up())?;
        Ok(run)
    }

    /// `runs/train-<world or folder>-s<seed>`, with what differs from a plain run: for runs that were not given a folder.
    pub fn default_path(config: &Config) -> PathBuf {
        let data = match &config.data.path {
            Some(path) => path.file_name().map_or_else(|| "frames".to_owned(), |name| name.to_string_lossy().into_owned()),
            None => config.data.preset.to_string(),
        };
        let mut name = format!("train-{data}-s{}", config.seed);
        if config.train.steps != Config::default().train.steps {
            name += &format!("-n{}", config.train.steps);
        }
        if let Some(only) = &config.train.only_stages {
            let numbers: Vec<String> = only.iter().map(usize::to_string).collect();
            name += &format!("-stages{}", numbers.join(""));
        }
        if config.loss.preset != LossPreset::default() {
            name += &format!("-{}", config.loss.preset);
        }
        let shares = config.train.stages.iter().map(|stage| stage.share);
        if shares.eq(StageConfig::PAPER_PARTS.map(|parts| parts / 30.0)) {
            name += "-paper";
        }
        PathBuf::from("runs").join(name)
    }

    /// The run at `path`, which must have a configuration and a checkpoint.
    ///
    /// **Errors** [`RunError::NoRun`].
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, RunError> {
        let run = Self::new(path);
        for missing in [CONFIG, CHECKPOINT] {
            if !run.path.join(missing).is_file() {
                return Err(RunError::NoRun { path: run.path, missing });
            }
        }
        Ok(run)
    }

    /// Whether a run with this `config.toml` may begin here.
    fn check_free(&self, text: &str, force: bool) -> Result<(), RunError> {
        let path = self.path.clone();
        if fs::read_dir(&path).map_or(true, |mut entries| entries.next().is_none()) {
            return Ok(());
        }
        let there = fs::read_to_string(self.config()).ok().filter(|there| there.starts_with(MARK));
        match there {
            None => Err(RunError::NotARun { path }),
            Some(_) if force => Ok(()),
            Some(_) if self.is_finished() => Err(RunError::Finished { path }),
            Some(_) if self.checkpoint().exists() => Err(RunError::Unfinished { path }),
            Some(there) if !there.lines().skip(1).eq(text.lines().skip(1)) => Err(RunError::OtherSettings { path }),
            Some(_) => Ok(()),
        }
    }

    /// Takes back a run that could not begin.
    pub(super) fn give_up(&self) {
        // The error that led here is the one to tell.
        let _ = self.clear();
        let _ = fs::remove_dir(&self.path);
    }

    /// Removes what a run writes; what else is there stays.
    fn clear(&self) -> Result<(), DataError> {
        let removed = |name: &str, remove: fn(&Path) -> io::Result<()>| {
            let place = self.path.join(name);
            match remove(&place) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => Err(DataError::write(&place, error)),
                _ => Ok(()),
            }
        };
        // All of them, even when one resists.
        let files = [METRICS, REPORT, CHECKPOINT, LOG, CONFIG].map(|name| removed(name, |file| fs::remove_file(file)));
        let folders = ["trajectories", "depth"].map(|name| removed(name, |folder| fs::remove_dir_all(folder)));
        files.into_iter().chain(folders).collect()
    }

    /// The command that asked for the run, as `config.toml` tells it.
    pub fn command(&self) -> Option<String> {
        let text = fs::read_to_string(self.config()).ok()?;
        Some(format!("{PROGRAM}{}", text.lines().next()?.strip_prefix(MARK)?))
    }

    /// Reads and checks `config.toml`.
    ///
    /// **Errors** [`ConfigError`].
    pub fn read_config(&self) -> Result<Config, ConfigError> {
        let config = Config::read_complete(&self.config())?;
        config.validate()?;
        Ok(config)
    }

    /// Whether evaluation and report are written.
    pub fn is_finished(&self) -> bool {
        self.metrics().exists()
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `config.toml`: the settings of the run.
    pub fn config(&self) -> PathBuf {
        self.path.join(CONFIG)
    }

    /// `checkpoint.safetensors`: weights and state after the last saved step.
    pub fn checkpoint(&self) -> PathBuf {
        self.path.join(CHECKPOINT)
    }

    /// `log.jsonl`: one line for each step.
    pub fn log(&self) -> PathBuf {
        self.path.join(LOG)
    }

    /// `metrics.json`: the evaluation; written last, so it tells a finished run.
    pub fn metrics(&self) -> PathBuf {
        self.path.join(METRICS)
    }

    /// `report.html`.
    pub fn report(&self) -> PathBuf {
        self.path.join(REPORT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_not_overwritten_unless_asked() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a/b");
        let config = Config::quick();
        let create = |force| RunFolder::create(&path, &config, "dimode train --quick", force);
        let run = create(false).unwrap();
        assert_eq!(run.read_config().unwrap(), config);
        assert_eq!(run.command().unwrap(), "dimode train --quick");
        create(false).unwrap();
        fs::write(run.checkpoint(), "x").unwrap();
        let message = create(false).unwrap_err().to_string();
        assert!(message.contains("--resume"), "{message}");
        fs::write(run.metrics(), "{}").unwrap();
        fs::write(path.join("notes.txt"), "mine").unwrap();
        let message = create(false).unwrap_err().to_string();
        assert!(message.contains("finished run"), "{message}");
        create(true).unwrap();
        assert!(!run.checkpoint().exists() && !run.metrics().exists());
        assert!(path.join("notes.txt").exists());
    }

    #[test]
    fn folders_of_something_else_are_left_alone() {
        let place = tempfile::tempdir().unwrap();
        let foreign = place.path().join("depth/mine.txt");
        fs::create_dir(place.path().join("depth")).unwrap();
        fs::write(&foreign, "x").unwrap();
        let printed = Config::quick().to_toml();
        for config in [None, Some("name = \"of another program\""), Some(&printed)] {
            if let Some(text) = config {
                fs::write(place.path().join("config.toml"), text).unwrap();
            }
            for force in [false, true] {
                let message = RunFolder::create(place.path(), &Config::quick(), "", force).unwrap_err().to_string();
                assert!(message.contains("not the folder of a run"), "{message}");
            }
        }
        assert!(foreign.exists());
        assert_eq!(fs::read_to_string(place.path().join("config.toml")).unwrap(), printed);
    }

    #[test]
    fn an_edited_configuration_of_a_run_is_not_overwritten() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("run");
        let create = |force| RunFolder::create(&path, &Config::quick(), "dimode train --quick", force);
        let run = create(false).unwrap();
        let edited = format!("{}# mine\n", fs::read_to_string(run.config()).unwrap());
        fs::write(run.config(), &edited).unwrap();
        let message = create(false).unwrap_err().to_string();
        assert!(message.contains("other settings"), "{message}");
        assert_eq!(fs::read_to_string(run.config()).unwrap(), edited);
        create(true).unwrap();
    }

    #[test]
    fn names_of_runs_hold_no_clock() {
        let mut config = Config::default();
        assert_eq!(RunFolder::default_path(&config), PathBuf::from("runs/train-street-s1"));
        (config.seed, config.data.path) = (4, Some("some/kitti".into()));
        assert_eq!(RunFolder::default_path(&config), PathBuf::from("runs/train-kitti-s4"));
    }

    #[test]
    fn a_run_that_does_not_name_a_setting_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let run = RunFolder::create(place.path().join("run"), &Config::default(), "dimode train", false).unwrap();
        let text = fs::read_to_string(run.config()).unwrap();
        for (key, name) in [("pose_iterations", "nets.pose_iterations"), ("noise_share", "loss.geometric.noise_share")] {
            let without: Vec<_> = text.lines().filter(|line| !line.starts_with(key)).collect();
            fs::write(run.config(), without.join("\n")).unwrap();
            let message = run.read_config().unwrap_err().to_string();
            assert!(message.contains(&format!("'{name}' is missing")), "{message}");
        }
        fs::write(run.config(), text).unwrap();
        run.read_config().unwrap();
    }

    #[test]
    fn a_folder_without_a_run_is_named() {
        let place = tempfile::tempdir().unwrap();
        let message = RunFolder::open(place.path()).unwrap_err().to_string();
        assert!(message.contains("no config.toml"), "{message}");
    }

    #[test]
    fn a_file_in_the_way_is_an_error() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("file");
        fs::write(&file, "x").unwrap();
        let message = RunFolder::create(file.join("run"), &Config::quick(), "", false).unwrap_err().to_string();
        assert!(message.contains("cannot be written"), "{message}");
    }
}

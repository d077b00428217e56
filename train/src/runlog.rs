//! The log of a run: `log.jsonl`, one JSON object per step.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, Serialize};

use crate::data::{DataError, write_atomic};
use crate::memory::PeakMemory;
use crate::objective::ImageReport;

/// What one step left behind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Steps done after this one, from 1.
    pub step: u64,
    /// Name of the stage.
    pub stage: String,
    /// Value of each loss term before its weight, and of the weighted sum (`total`). A value that is not a number is written
    /// as `null`.
    #[serde(deserialize_with = "numbers")]
    pub terms: BTreeMap<String, f64>,
    /// Share of pixels that each term counted, 0 to 1.
    #[serde(default, deserialize_with = "numbers")]
    pub valid: BTreeMap<String, f64>,
    /// Norms of gradients, by network or term.
    #[serde(default, deserialize_with = "numbers")]
    pub gradient_norms: BTreeMap<String, f64>,
    /// Value and pixels of every image and source in turn, by term; in the steps in which gradients of terms are measured.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub images: BTreeMap<String, Vec<ImageReport>>,
    /// Learning rate of the step.
    pub learning_rate: f64,
    /// Time the step took, in seconds.
    pub seconds: f64,
    /// Peaks of memory so far. Like the time, they are measured: two runs of one seed differ in them.
    #[serde(default)]
    pub memory: PeakMemory,
}

fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, f64>, D::Error> {
    let map = BTreeMap::<String, Option<f64>>::deserialize(deserializer)?;
    Ok(map.into_iter().map(|(name, value)| (name, value.unwrap_or(f64::NAN))).collect())
}

/// Appends records to a file; each is handed to the system as one whole line.
#[derive(Debug)]
pub struct RunLog {
    path: PathBuf,
    file: File,
}

impl RunLog {
    /// Begins an empty log at `path`.
    ///
    /// **Errors** [`DataError::Write`].
    pub fn create(path: &Path) -> Result<Self, DataError> {
        let file = File::create(path).map_err(|error| DataError::write(path, error))?;
        Ok(Self { path: path.to_owned(), file })
    }

    /// Continues the log at `path` after `step`: later records and an incomplete last line are dropped. A missing log is
    /// begun.
    ///
    /// **Errors** as [`read`], or [`DataError::Write`].
    pub fn resume(path: &Path, step: u64) -> Result<Self, DataError> {
        if !path.exists() {
            return Self::create(path);
        }
        let text = text_of(path)?;
        let records = parse(&text, path)?;
        // The lines stay as they were written; a number read and written again might lose its last digit.
        let kept = text.split_inclusive('\n').zip(&records).filter(|(_, record)| record.step <= step);
        let kept: String = kept.map(|(line, _)| line).collect();
        write_atomic(path, kept.as_bytes())?;
        let file = OpenOptions::new().append(true).open(path);
        Ok(Self { path: path.to_owned(), file: file.map_err(|error| DataError::write(path, error))? })
    }

    /// Appends one record.
    ///
    /// **Errors** [`DataError::Write`].
    pub fn append(&mut self, record: &StepRecord) -> Result<(), DataError> {
        self.file.write_all(line(record).as_bytes()).map_err(|error| DataError::write(&self.path, error))
    }

    /// Waits until everything appended is on the disk; to be called before a checkpoint is written.
    ///
    /// **Errors** [`DataError::Write`].
    pub fn sync(&self) -> Result<(), DataError> {
        self.file.sync_data().map_err(|error| DataError::write(&self.path, error))
    }
}

fn line(record: &StepRecord) -> String {
    let mut text = serde_json::to_string(record).expect("a record is plain numbers and names");
    text.push('\n');
    text
}

/// Reads all records of a log. A last line without its end, as an interruption leaves it, is not counted.
///
/// **Errors** [`DataError::Missing`], [`DataError::Read`], or [`DataError::Malformed`] with the line.
pub fn read(path: &Path) -> Result<Vec<StepRecord>, DataError> {
    parse(&text_of(path)?, path)
}

fn text_of(path: &Path) -> Result<String, DataError> {
    fs::read_to_string(path).map_err(|error| DataError::read(path, "the log of a run", error))
}

fn parse(text: &str, path: &Path) -> Result<Vec<StepRecord>, DataError> {
    let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
    let record = |(index, line): (usize, &str)| {
        serde_json::from_str(line)
            .map_err(|error| DataError::at_line(path, index + 1, format!("not a record of a step ({error})"), "remove the line"))
    };
    whole.lines().enumerate().map(record).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(step: u64) -> StepRecord {
        StepRecord {
            step,
            stage: "1 joint".to_owned(),
            terms: BTreeMap::from([("pho".to_owned(), 0.1 / step as f64)]),
            valid: BTreeMap::from([("pho".to_owned(), 0.9)]),
            gradient_norms: BTreeMap::new(),
            images: BTreeMap::new(),
            learning_rate: 1e-3,
            seconds: 0.25,
            memory: PeakMemory { process: None, pool: 1000 * step },
        }
    }

    #[test]
    fn resume_keeps_the_steps_up_to_the_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let mut log = RunLog::create(&path).unwrap();
        for step in 1..=5 {
            log.append(&record(step)).unwrap();
        }
        log.sync().unwrap();
        drop(log);
        let whole = fs::read_to_string(&path).unwrap();
        fs::write(&path, format!("{whole}{{\"step\":6,\"sta")).unwrap();
        assert_eq!(read(&path).unwrap().len(), 5, "the incomplete line is not counted");
        let mut log = RunLog::resume(&path, 3).unwrap();
        log.append(&record(4)).unwrap();
        log.append(&record(5)).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), whole);
        assert_eq!(read(&path).unwrap(), (1..=5).map(record).collect::<Vec<_>>());
    }

    #[test]
    fn resume_without_a_log_begins_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        RunLog::resume(&path, 3).unwrap().append(&record(4)).unwrap();
        assert_eq!(read(&path).unwrap().len(), 1);
    }

    #[test]
    fn values_that_are_no_numbers_survive() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let mut bad = record(1);
        bad.terms.insert("rad".to_owned(), f64::NAN);
        let images = [f64::INFINITY, 0.5].map(|value| ImageReport { value, pixels: 3 });
        bad.images.insert("rad".to_owned(), images.to_vec());
        RunLog::create(&path).unwrap().append(&bad).unwrap();
        let back = read(&path).unwrap();
        assert!(back[0].terms["rad"].is_nan());
        assert!(back[0].images["rad"][0].value.is_nan());
        assert_eq!(back[0].images["rad"][1], ImageReport { value: 0.5, pixels: 3 });
        assert_eq!(back[0].terms["pho"], bad.terms["pho"]);
    }

    #[test]
    fn a_log_from_before_memory_was_told_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let text = line(&record(1));
        let old = text.replace(r#","memory":{"pool":1000}"#, "");
        assert!(old.len() < text.len());
        fs::write(&path, old).unwrap();
        assert_eq!(read(&path).unwrap(), [StepRecord { memory: PeakMemory::default(), ..record(1) }]);
    }

    #[test]
    fn a_broken_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        fs::write(&path, format!("{}nonsense\n", line(&record(1)))).unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("log.jsonl:2:"), "{message}");
    }
}

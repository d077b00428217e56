//! What a long task tells while it runs.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;

use indicatif::{ProgressBar, ProgressStyle};

/// A listener of a long task. All text goes to standard error, never to standard output.
pub trait Progress: Sync {
    /// The task begins: `total` units of `what`.
    fn start(&self, total: u64, what: &str);
    /// `done` units are ready; `message` is one short line, for instance the terms of the loss.
    fn step(&self, done: u64, message: &str);
    /// A line that should stay, for instance the begin of a stage.
    fn note(&self, line: &str);
    /// The task ends.
    fn finish(&self);
}

/// Tells nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn start(&self, _total: u64, _what: &str) {}
    fn step(&self, _done: u64, _message: &str) {}
    fn note(&self, _line: &str) {}
    fn finish(&self) {}
}

/// A bar with time left and message when standard error is a terminal; else only the notes, one line each.
#[derive(Debug, Default)]
pub struct Bar {
    bar: Mutex<Option<ProgressBar>>,
    terminal: bool,
}

impl Bar {
    /// Looks whether standard error is a terminal.
    pub fn new() -> Self {
        Self { bar: Mutex::new(None), terminal: std::io::stderr().is_terminal() }
    }

    fn with_bar(&self, act: impl FnOnce(&ProgressBar)) {
        // A bar is only for the eye: a poisoned lock is no reason to stop the task.
        if let Ok(guard) = self.bar.lock()
            && let Some(bar) = guard.as_ref()
        {
            act(bar);
        }
    }
}

impl Progress for Bar {
    fn start(&self, total: u64, what: &str) {
        if !self.terminal {
            return;
        }
        let bar = ProgressBar::new(total);
        let template = "{prefix} {pos}/{len} [{bar:28}] {elapsed} elapsed, {eta} left  {msg}";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style.progress_chars("=> "));
        bar.set_prefix(what.to_owned());
        if let Ok(mut guard) = self.bar.lock() {
            *guard = Some(bar);
        }
    }

    fn step(&self, done: u64, message: &str) {
        self.with_bar(|bar| {
            bar.set_position(done);
            bar.set_message(message.to_owned());
        });
    }

    fn note(&self, line: &str) {
        if self.terminal {
            self.with_bar(|bar| bar.suspend(|| tell(line)));
            let none = self.bar.lock().is_ok_and(|guard| guard.is_none());
            if none {
                tell(line);
            }
        } else {
            tell(line);
        }
    }

    fn finish(&self) {
        self.with_bar(ProgressBar::finish_and_clear);
        if let Ok(mut guard) = self.bar.lock() {
            *guard = None;
        }
    }
}

/// Standard error may be closed; a lost note is no failure.
fn tell(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Keeps everything that was told, for tests.
#[derive(Debug, Default)]
pub struct Recorder {
    lines: Mutex<Vec<String>>,
}

impl Recorder {
    /// The notes so far.
    #[track_caller]
    pub fn lines(&self) -> Vec<String> {
        self.lines.lock().expect("no writer panicked").clone()
    }

    fn push(&self, line: String) {
        if let Ok(mut lines) = self.lines.lock() {
            lines.push(line);
        }
    }
}

impl Progress for Recorder {
    fn start(&self, total: u64, what: &str) {
        self.push(format!("start {what} {total}"));
    }

    fn step(&self, done: u64, message: &str) {
        self.push(format!("step {done} {message}"));
    }

    fn note(&self, line: &str) {
        self.push(line.to_owned());
    }

    fn finish(&self) {
        self.push("finish".to_owned());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recorder_keeps_the_order() {
        let recorder = Recorder::default();
        recorder.start(2, "train");
        recorder.step(1, "pho 0.1");
        recorder.note("stage 2");
        recorder.finish();
        assert_eq!(recorder.lines(), ["start train 2", "step 1 pho 0.1", "stage 2", "finish"]);
    }

    #[test]
    fn without_terminal_no_bar_begins() {
        let bar = Bar { bar: Mutex::new(None), terminal: false };
        bar.start(3, "train");
        bar.step(1, "x");
        assert!(bar.bar.lock().unwrap().is_none());
        bar.finish();
    }
}

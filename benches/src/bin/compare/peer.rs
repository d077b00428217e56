//! A process, PyTorch's as a rule, that waits for requests, one JSON object a line.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Seek, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

/// Environment that makes the C library keep memory instead of returning it to the system after every call.
const TUNED: [(&str, &str); 2] = [("MALLOC_TRIM_THRESHOLD_", "4294967296"), ("MALLOC_MMAP_THRESHOLD_", "4294967296")];

/// How the peer's process handles memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Allocator {
    /// As users start it.
    Default,
    /// Memory is kept.
    Tuned,
    /// Not PyTorch: the program of the Rust peers, with what it uses itself.
    RustPeers,
}

impl Allocator {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Tuned => "tuned",
            Self::RustPeers => "rust",
        }
    }

    /// Sets the environment of a process.
    pub fn apply(self, command: &mut Command) {
        if self == Self::Tuned {
            command.envs(TUNED);
        }
    }
}

/// A running peer.
pub struct Peer {
    child: Child,
    stdin: ChildStdin,
    stdout: BufReader<ChildStdout>,
    /// What it complains of.
    stderr: File,
    stopped: bool,
    /// Version of its library.
    pub version: String,
}

impl Peer {
    /// Starts `server.py` and waits for its answer.
    ///
    /// # Errors
    /// When Python cannot be started or lacks PyTorch.
    pub fn start(python: &Path, allocator: Allocator) -> Result<Self> {
        let mut command = Command::new(python);
        allocator.apply(&mut command);
        command.arg(scripts().join("server.py")).env("PYTHONDONTWRITEBYTECODE", "1");
        Self::spawn(command).with_context(|| format!("{} cannot run torch", python.display()))
    }

    /// Starts a program that answers requests, and waits for its first answer.
    ///
    /// # Errors
    /// When it cannot be started or does not answer.
    pub fn spawn(mut command: Command) -> Result<Self> {
        // A file, since nobody empties a pipe while both work.
        let stderr = tempfile::tempfile().context("no temporary file")?;
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(stderr.try_clone()?);
        let mut child = command.spawn().with_context(|| format!("cannot start {}", command.get_program().display()))?;
        let stdin = child.stdin.take().context("no way to write to the peer")?;
        let stdout = BufReader::new(child.stdout.take().context("no way to read from the peer")?);
        let mut peer = Self { child, stdin, stdout, stderr, stopped: false, version: String::new() };
        let hello = peer.ask(&json!({"do": "hello"}))?;
        peer.version = hello["torch"].as_str().unwrap_or("?").to_owned();
        Ok(peer)
    }

    /// Sends a request and waits for the answer.
    ///
    /// # Errors
    /// When the peer is gone or could not do it.
    pub fn ask(&mut self, request: &Value) -> Result<Value> {
        let sent = writeln!(self.stdin, "{request}").and_then(|()| self.stdin.flush());
        let mut line = String::new();
        if sent.is_err() || self.stdout.read_line(&mut line)? == 0 {
            self.stopped = true;
            bail!("the peer stopped{}", self.last_words());
        }
        let answer: Value = serde_json::from_str(&line).with_context(|| format!("the peer said {line}"))?;
        match answer["error"].as_str() {
            Some(error) => bail!("the peer failed: {error}"),
            None => Ok(answer),
        }
    }

    /// Whether it has ended by itself.
    pub fn has_stopped(&self) -> bool {
        self.stopped
    }

    /// How it ended, and the last lines of its error output.
    fn last_words(&mut self) -> String {
        const LINES: usize = 8;
        let mut status = None;
        for _ in 0..50 {
            status = self.child.try_wait().ok().flatten();
            if status.is_some() {
                break;
            }
            sleep(Duration::from_millis(20));
        }
        let mut bytes = Vec::new();
        let _ = self.stderr.rewind().and_then(|()| self.stderr.read_to_end(&mut bytes));
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().collect();
        let last = lines[lines.len().saturating_sub(LINES)..].iter().map(|line| format!("\n    {line}"));
        format!("{}:{}", status.map_or(String::new(), |status| format!(" ({status})")), last.collect::<String>())
    }

    /// Milliseconds of each repetition of something that was built.
    ///
    /// # Errors
    /// As [`Peer::ask`].
    pub fn time(&mut self, key: &str, what: &str, threads: usize, seconds: f64) -> Result<Vec<f64>> {
        let request = json!({"do": "time", "key": key, "what": what, "threads": threads, "seconds": seconds});
        let answer = self.ask(&request)?;
        Ok(serde_json::from_value(answer["samples"].clone())?)
    }

    /// Waits until the peer takes no more processor time: the threads of its OpenMP run-time look for work for a while after a
    /// loop before they sleep.
    pub fn settle(&self) {
        let mut before = self.ticks();
        for _ in 0..15 {
            sleep(Duration::from_millis(20));
            let now = self.ticks();
            if now.is_some() && now == before {
                return;
            }
            before = now;
        }
    }

    /// Processor time so far, in ticks of the system.
    fn ticks(&self) -> Option<u64> {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id())).ok()?;
        let mut fields = stat.rsplit(')').next()?.split_whitespace().skip(11);
        Some(fields.next()?.parse::<u64>().ok()? + fields.next()?.parse::<u64>().ok()?)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It has nothing to finish.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The folder of the peers' programs.
pub fn scripts() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/peers"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_that_stops_leaves_its_last_words() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo nothing of that kind >&2; exit 3"]);
        let error = Peer::spawn(command).err().expect("it cannot answer").to_string();
        assert!(error.contains("exit status: 3") && error.contains("nothing of that kind"), "{error}");
    }
}

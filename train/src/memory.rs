//! How much memory a run took at most.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Peaks of memory since the program began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PeakMemory {
    /// Most bytes of the process that were in memory at one time, as Linux tells them; none on other systems.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<u64>,
    /// Most bytes of the buffers that training steps share, in use or at rest.
    pub pool: u64,
}

impl PeakMemory {
    /// The peaks so far, given that of the pool in bytes.
    pub fn now(pool: usize) -> Self {
        let status = std::fs::read_to_string("/proc/self/status").ok();
        PeakMemory { process: status.and_then(|status| process_peak(&status)), pool: pool as u64 }
    }

    /// The larger of two peaks, each for itself: a run that was resumed has several.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        PeakMemory { process: self.process.max(other.process), pool: self.pool.max(other.pool) }
    }
}

impl fmt::Display for PeakMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mebibytes = |bytes: u64| bytes.div_ceil(1 << 20);
        match self.process {
            Some(bytes) => write!(f, "{} MiB", mebibytes(bytes))?,
            None => write!(f, "not told by this system")?,
        }
        write!(f, "; buffers of the training steps {} MiB", mebibytes(self.pool))
    }
}

/// Bytes in the line `VmHWM:  1234 kB` of a process's status.
fn process_peak(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_from_the_status_and_absent_without_it() {
        assert_eq!(process_peak("Name:\tdimode\nVmPeak:\t  900 kB\nVmHWM:\t  708 kB\n"), Some(708 * 1024));
        for status in ["", "VmPeak: 3 kB\n", "VmHWM: 3 MB\n", "VmHWM: x kB\n"] {
            assert_eq!(process_peak(status), None, "{status:?}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_peak_of_this_process_grows_with_what_it_touches() {
        let bytes = |peak: PeakMemory| peak.process.expect("Linux tells it");
        let before = PeakMemory::now(0);
        let block = std::hint::black_box(vec![1_u8; 64 << 20]);
        let after = PeakMemory::now(5);
        assert!(bytes(after) >= 64 << 20 && bytes(after) >= bytes(before));
        assert_eq!((after.pool, block.len()), (5, 64 << 20));
    }

    #[test]
    fn it_says_what_it_does_not_know() {
        let known = PeakMemory { process: Some(3 << 20), pool: 1 };
        let unknown = PeakMemory { process: None, pool: 5 << 20 };
        assert_eq!(known.to_string(), "3 MiB; buffers of the training steps 1 MiB");
        assert_eq!(unknown.to_string(), "not told by this system; buffers of the training steps 5 MiB");
        assert_eq!(known.max(unknown), PeakMemory { process: Some(3 << 20), pool: 5 << 20 });
        assert_eq!(serde_json::to_string(&unknown).unwrap(), r#"{"pool":5242880}"#);
        assert_eq!(serde_json::from_str::<PeakMemory>(r#"{"pool":5242880}"#).unwrap(), unknown);
    }
}

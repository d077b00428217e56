//! Everything that a run measured so far, as text and as JSON.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde_json::json;

use super::duel::{Outcome, Row};
use super::memory::{Allocations, Peak};
use super::tables::Table;
use super::topics::{Share, Topic};
use super::{goals, memory, rust_peers, tables, topics};

/// What was measured.
#[derive(Default)]
pub struct Report {
    /// What ran where.
    pub machine: String,
    /// Numbers of threads that were asked for.
    pub threads: Vec<usize>,
    /// Topics, in the order of their tables.
    pub topics: Vec<Topic>,
    /// Comparisons.
    pub rows: Vec<Row>,
    /// Variants that the peer could not run.
    pub left_out: Vec<String>,
    /// Variants whose numbers differ.
    pub differing: Vec<String>,
    /// Memory.
    pub peaks: Vec<Peak>,
    /// Allocations.
    pub allocations: Vec<Allocations>,
    /// Shares of the machine's peak.
    pub shares: Vec<Share>,
}

impl Report {
    /// Takes what came of a case.
    pub fn add(&mut self, outcome: Outcome) {
        self.rows.extend(outcome.rows);
        self.left_out.extend(outcome.left_out);
        self.differing.extend(outcome.differing);
    }

    /// Whether there was nothing to measure: no case, not even one that the peer could not run.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
            && self.left_out.is_empty()
            && self.peaks.is_empty()
            && self.allocations.is_empty()
            && self.shares.is_empty()
    }

    /// The tables of a topic.
    fn tables(&self, topic: Topic) -> Vec<Table> {
        let key = topic.key();
        let rows: Vec<Row> = self.rows.iter().filter(|row| row.topic == key).cloned().collect();
        let each = |table: &dyn Fn(usize) -> Table| self.threads.iter().map(|&threads| table(threads)).collect();
        match topic {
            Topic::Memory => each(&|threads| memory::table(&self.peaks, threads)),
            Topic::Allocations => each(&|threads| memory::allocations_table(&self.allocations, threads)),
            Topic::Peak => vec![topics::shares_table(&self.shares)],
            Topic::RustPeers => {
                let mut tables: Vec<Table> = each(&|threads| rust_peers::best_table(&rows, threads));
                tables.extend(tables::of_rows(topic.title(), &rows));
                tables
            }
            _ => tables::of_rows(topic.title(), &rows),
        }
    }

    /// All tables.
    pub fn to_markdown(&self) -> String {
        let mut out = format!("{}\n", self.machine);
        let lists = [("Left out, since the peer could not run it", &self.left_out), ("Numbers differ", &self.differing)];
        for (title, items) in lists.into_iter().filter(|(_, items)| !items.is_empty()) {
            let _ = writeln!(out, "{title}:\n");
            for item in items {
                let _ = writeln!(out, "- {}", item.replace('\n', " "));
            }
            out.push('\n');
        }
        let tables = std::iter::once(goals::table(self)).chain(self.topics.iter().flat_map(|&topic| self.tables(topic)));
        for table in tables.filter(|table| !table.is_empty()) {
            let _ = write!(out, "\n{}", table.to_markdown());
        }
        out
    }

    /// Writes what there is so far, so that a run that stops leaves something.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn save(&self, markdown: Option<&Path>, json: Option<&Path>) -> Result<()> {
        let write = |path: &Path, text: String| fs::write(path, text).with_context(|| format!("cannot write {}", path.display()));
        if let Some(path) = markdown {
            write(path, self.to_markdown())?;
        }
        let Some(path) = json else { return Ok(()) };
        let all = json!({
            "machine": self.machine,
            "rows": self.rows,
            "left_out": self.left_out,
            "differing": self.differing,
            "memory": self.peaks,
            "allocations": self.allocations,
            "shares": self.shares,
            "goals": goals::to_json(self)
        });
        write(path, serde_json::to_string_pretty(&all)?)
    }
}

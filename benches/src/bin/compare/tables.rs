//! Tables of what was measured, for the terminal and for Markdown files.

use std::fmt::Write;

use dimode_benches::timing::{ends, geometric_mean};

use super::duel::Row;

/// A title, column heads, and cells.
#[derive(Clone, Debug)]
pub struct Table {
    title: String,
    heads: Vec<String>,
    cells: Vec<Vec<String>>,
}

impl Table {
    /// An empty table.
    pub fn new(title: &str, heads: &[&str]) -> Self {
        Self { title: title.to_owned(), heads: heads.iter().map(|&h| h.to_owned()).collect(), cells: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, cells: Vec<String>) {
        self.cells.push(cells);
    }

    /// Whether it has no rows.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The table in Markdown, which reads well in a terminal too: columns are as wide as their widest cell.
    pub fn to_markdown(&self) -> String {
        let rows = || std::iter::once(&self.heads).chain(&self.cells);
        let width = |k: usize| rows().map(|row| row.get(k).map_or(0, |cell| cell.chars().count())).max().unwrap_or(0);
        let widths: Vec<usize> = (0..self.heads.len()).map(width).collect();
        let mut out = format!("### {}\n\n", self.title);
        for (i, row) in rows().enumerate() {
            for (k, cell) in row.iter().enumerate() {
                let pad = " ".repeat(widths[k] - cell.chars().count());
                // The first column holds names, the others numbers.
                let _ = if k == 0 { write!(out, "| {cell}{pad} ") } else { write!(out, "| {pad}{cell} ") };
            }
            out.push_str("|\n");
            if i == 0 {
                for (k, width) in widths.iter().enumerate() {
                    let _ = write!(out, "|{}{}", "-".repeat(width + 1), if k == 0 { "-" } else { ":" });
                }
                out.push_str("|\n");
            }
        }
        out
    }
}

/// `2.34 (2.30..2.41)`, and whether the numbers differ.
pub fn with_spread(row: &Row) -> String {
    let (low, high) = row.spread();
    format!("{:.2} ({low:.2}..{high:.2}){}", row.ratio(), mark(row.agrees()))
}

fn mark(agrees: bool) -> &'static str {
    if agrees { "" } else { " differs" }
}

/// `1 thread`, `2 threads`.
pub fn of_threads(threads: usize) -> String {
    format!("{threads} thread{}", if threads == 1 { "" } else { "s" })
}

/// One table for each number of threads: cases down, the peer's variants across. Convolutions also get their means and worst.
pub fn of_rows(title: &str, rows: &[Row]) -> Vec<Table> {
    let mut threads: Vec<usize> = rows.iter().map(|row| row.threads).collect();
    threads.sort_unstable();
    threads.dedup();
    threads.into_iter().map(|t| one_table(title, t, &rows.iter().filter(|row| row.threads == t).collect::<Vec<_>>())).collect()
}

fn one_table(title: &str, threads: usize, rows: &[&Row]) -> Table {
    let variants = unique(rows.iter().map(|row| row.variant.clone()));
    let items = unique(rows.iter().map(|row| (row.case.clone(), row.what.clone())));
    let mut heads = vec!["case".to_owned(), "ours, ms".to_owned()];
    heads.extend(variants.iter().map(|variant| format!("/ {variant}")));
    let mut table =
        Table { title: format!("{title}, {}: time of the peer / ours", of_threads(threads)), heads, cells: Vec::new() };
    for (case, what) in &items {
        let of_item: Vec<_> = rows.iter().filter(|row| row.case == *case && row.what == *what).collect();
        let mut cells = vec![format!("{case}, {}", what.replace('_', " ")), format!("{:.3}", of_item[0].ours)];
        let cell = |v: &String| of_item.iter().find(|row| row.variant == *v).map_or("-".to_owned(), |row| with_spread(row));
        cells.extend(variants.iter().map(cell));
        table.push(cells);
    }
    let several = unique(rows.iter().map(|row| row.case.clone())).len() > 3;
    for what in unique(rows.iter().map(|row| row.what.clone())).into_iter().filter(|_| several) {
        let ratios = |v: &String| -> (Vec<f64>, bool) {
            let chosen = || rows.iter().filter(|row| row.variant == *v && row.what == what);
            (chosen().map(|row| row.ratio()).collect(), chosen().all(|row| row.agrees()))
        };
        let of_all: Vec<_> = variants.iter().map(ratios).collect();
        let name = what.replace('_', " ");
        let line = |label: String, number: fn(&[f64]) -> f64| {
            let cell = |(ratios, agrees): &(Vec<f64>, bool)| match ratios.as_slice() {
                [] => "-".to_owned(),
                ratios => format!("**{:.2}**{}", number(ratios), mark(*agrees)),
            };
            let numbers = of_all.iter().map(cell);
            [label, String::new()].into_iter().chain(numbers).collect::<Vec<_>>()
        };
        table.push(line(format!("**geometric mean, {name}**"), geometric_mean));
        table.push(line(format!("**worst, {name}**"), |r| ends(r).0));
    }
    table
}

/// The items without repetitions, in order.
fn unique<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut found = Vec::new();
    for item in items {
        if !found.contains(&item) {
            found.push(item);
        }
    }
    found
}

//! The evaluation as text tables.

use comfy_table::{Cell, CellAlignment, Table, presets};

use super::{DepthTable, Evaluation, MotionTable, Ratio, RowKind};
use crate::counted::counted;

/// One table ready to be shown, as text or in a report.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// What the table shows and how the numbers were made.
    pub title: String,
    /// Column heads, the first being the row name.
    pub heads: Vec<String>,
    /// Rows.
    pub rows: Vec<GridRow>,
    /// Remarks below the table.
    pub notes: Vec<String>,
}

/// One row of a [`Grid`].
#[derive(Clone, Debug, PartialEq)]
pub struct GridRow {
    /// Row name.
    pub name: String,
    /// Trained, trivial, or the ratio line (`None`).
    pub kind: Option<RowKind>,
    /// Formatted values and whether each is the best of its column.
    pub cells: Vec<(String, bool)>,
}

/// Which way a column is better.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Better {
    Higher,
    Lower,
    /// A description, not a score.
    Neither,
}

/// A column: head, direction, decimals, values by row, ratio to the best trivial row.
struct Column {
    head: &'static str,
    better: Better,
    decimals: usize,
    values: Vec<Option<f64>>,
    ratio: Option<f64>,
}

impl Column {
    fn is_best(&self, row: usize) -> bool {
        let Some(value) = self.values[row] else {
            return false;
        };
        self.values.iter().flatten().all(|other| match self.better {
            Better::Higher => *other <= value,
            Better::Lower => *other >= value,
            Better::Neither => false,
        })
    }
}

fn grid(title: String, rows: &[(&str, RowKind)], columns: &[Column], notes: Vec<String>) -> Grid {
    let mut heads = vec![String::new()];
    heads.extend(columns.iter().map(|c| match c.better {
        Better::Higher => format!("{} ↑", c.head),
        Better::Lower => format!("{} ↓", c.head),
        Better::Neither => c.head.to_owned(),
    }));
    let mut lines: Vec<GridRow> = Vec::new();
    for (i, (name, kind)) in rows.iter().enumerate() {
        let cell = |c: &Column| match c.values[i] {
            Some(value) => (format!("{value:.*}", c.decimals), c.is_best(i)),
            None => ("n/a".to_owned(), false),
        };
        lines.push(GridRow { name: (*name).to_owned(), kind: Some(*kind), cells: columns.iter().map(cell).collect() });
    }
    let ratio = |c: &Column| c.ratio.map_or_else(String::new, |r| format!("{r:.2} x"));
    lines.push(GridRow {
        name: "ratio to the best trivial row".to_owned(),
        kind: None,
        cells: columns.iter().map(|c| (ratio(c), false)).collect(),
    });
    Grid { title, heads, rows: lines, notes }
}

fn ratio_of(ratios: &[Ratio], metric: &str) -> Option<f64> {
    ratios.iter().find(|r| r.metric == metric).map(|r| r.ratio)
}

/// The depth rows as a grid.
pub(crate) fn depth_grid(data: &str, table: &DepthTable) -> Grid {
    let names = super::DepthScores::NAMES;
    let heads = ["AbsRel", "SqRel [m]", "RMSE [m]", "RMSE log", "a1", "a2", "a3"];
    let mut columns: Vec<Column> = (0..7)
        .map(|k| Column {
            head: heads[k],
            better: if k >= 4 { Better::Higher } else { Better::Lower },
            decimals: 3,
            values: table.rows.iter().map(|row| Some(row.summary.scores.values()[k])).collect(),
            ratio: ratio_of(&table.ratios, names[k]),
        })
        .collect();
    columns.push(Column {
        head: "scale spread",
        better: Better::Neither,
        decimals: 3,
        values: table.rows.iter().map(|row| Some(row.summary.scale_spread)).collect(),
        ratio: None,
    });
    let rows: Vec<_> = table.rows.iter().map(|row| (row.name.as_str(), row.kind)).collect();
    let mut notes =
        vec!["Mean over frames of the per-frame values. Scale spread: standard deviation of scale / median scale.".to_owned()];
    if table.skipped > 0 {
        notes.push(format!("{} without a valid pixel left out.", counted(table.skipped, "frame")));
    }
    let title = format!("Depth: {data}, {} ({})", counted(table.frames, "frame"), table.protocol.describe());
    grid(title, &rows, &columns, notes)
}

/// The motion rows as a grid.
pub(crate) fn motion_grid(data: &str, table: &MotionTable) -> Grid {
    type Get = fn(&super::MotionRow) -> Option<f64>;
    let specs: [(&'static str, &'static str, usize, Get); 7] = [
        ("rot [deg]", "rotation_mean_deg", 3, |r| Some(r.frame_to_frame.rotation_mean_deg)),
        ("rot median", "rotation_median_deg", 3, |r| Some(r.frame_to_frame.rotation_median_deg)),
        ("dir [deg]", "direction_mean_deg", 2, |r| r.frame_to_frame.direction_mean_deg),
        ("dir median", "direction_median_deg", 2, |r| r.frame_to_frame.direction_median_deg),
        ("e_t [%]", "e_t_percent", 2, |r| r.odometry.e_t_percent),
        ("e_r [deg/100m]", "e_r_deg_per_100m", 2, |r| r.odometry.e_r_deg_per_100m),
        ("ATE [m]", "ate_m", 3, |r| r.odometry.ate_m),
    ];
    let columns: Vec<Column> = specs
        .into_iter()
        .map(|(head, key, decimals, get)| Column {
            head,
            better: Better::Lower,
            decimals,
            values: table.rows.iter().map(get).collect(),
            ratio: ratio_of(&table.ratios, key),
        })
        .collect();
    let rows: Vec<_> = table.rows.iter().map(|row| (row.name.as_str(), row.kind)).collect();
    let title = format!(
        "Motion: {data}, {} in {} ({})",
        counted(table.pairs, "frame pair"),
        counted(table.sequences, "sequence"),
        table.protocol.alignment.label()
    );
    grid(title, &rows, &columns, motion_notes(table))
}

fn motion_notes(table: &MotionTable) -> Vec<String> {
    let lengths: Vec<String> = table.protocol.lengths.iter().map(f64::to_string).collect();
    let mut notes = vec![
        format!(
            "rot, dir: rotation and translation-direction error per frame pair (mean and median), directions compared in the {} frame.",
            table.direction_frame
        ),
        format!(
            "e_t, e_r: sub-sequences of {} m, mean over sequences; n/a: the path is shorter, or nothing moves.",
            lengths.join(", ")
        ),
    ];
    let skipped = table.rows[0].frame_to_frame.direction_skipped;
    if skipped > 0 {
        notes.push(format!("No direction error for {} without true translation.", counted(skipped, "pair")));
    }
    if table.rows[0].odometry.per_sequence.iter().any(|s| s.errors.rotation_ambiguous) {
        notes.push("Some true paths are straight lines: the alignment cannot fix the twist about them.".to_owned());
    }
    notes
}

/// All tables of an evaluation, depth first.
pub(crate) fn grids(evaluation: &Evaluation) -> Vec<Grid> {
    let depth = evaluation.depth.as_ref().map(|t| depth_grid(&evaluation.data, t));
    let motion = evaluation.motion.as_ref().map(|t| motion_grid(&evaluation.data, t));
    depth.into_iter().chain(motion).collect()
}

/// A grid as text; the best value of each column carries a star.
pub(crate) fn render(grid: &Grid) -> String {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    table.set_header(grid.heads.iter().map(|head| {
        let alignment = if head.is_empty() { CellAlignment::Left } else { CellAlignment::Right };
        Cell::new(head).set_alignment(alignment)
    }));
    for row in &grid.rows {
        let mut cells = vec![Cell::new(&row.name)];
        cells.extend(row.cells.iter().map(|(text, best)| {
            let text = if *best { format!("{text} *") } else { format!("{text}  ") };
            Cell::new(text.as_str()).set_alignment(CellAlignment::Right)
        }));
        table.add_row(cells);
    }
    let notes: String = grid.notes.iter().map(|note| format!("  {note}\n")).collect();
    format!("{}\n{}\n{notes}", grid.title, table.trim_fmt())
}

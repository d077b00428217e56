//! Ratio losses and the rest (L51 to L64).

use super::Row;

pub const ROWS: &[Row] = &[];

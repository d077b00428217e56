//! Direction losses (L36 to L50).

use super::Row;

pub const ROWS: &[Row] = &[];

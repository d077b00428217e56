//! Gradients of the flow, decomposition and alignment (L18 to L35).

use super::Row;

pub const ROWS: &[Row] = &[];

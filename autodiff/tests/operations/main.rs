//! Tests of the operations from outside. One program, because every program compiles every operation again.

mod determinism;
mod determinism_spatial;
mod kinks;
mod network_shapes;

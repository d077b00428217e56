//! DiMoDE as a whole: data, losses, schedule, training, evaluation and report.
pub mod batch;
pub mod checkpoint;
pub mod cli;
pub mod config;
pub mod data;
pub mod eval;
pub mod losses;
pub mod model;
pub mod optim;
pub mod pretrain;
pub mod progress;
pub mod report;
pub mod run;
pub mod runlog;
pub mod sampler;
pub mod schedule;

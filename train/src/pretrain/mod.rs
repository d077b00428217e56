//! Training of a network on its own, before the joint training: where flow and pose networks begin.
//!
//! A [`Task`] says what a network learns from; [`train`] is the one loop for all of them.

pub mod flow;
pub mod pose;
pub mod settings;
pub mod target;
pub mod task;
pub mod training;
pub mod worlds;

pub use flow::FlowTask;
pub use pose::PoseTask;
pub use settings::Settings;
pub use target::{Form, Target, TargetError};
pub use task::Task;
pub use training::{HeldOutError, train};
pub use worlds::Worlds;

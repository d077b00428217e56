//! `dimode eval odometry`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::failure::Exit;
use super::output;
use crate::eval::{Alignment, Arithmetic, OdometryProtocol};
use crate::run::eval_odometry::{EvalOdometryRequest, TrajectoryFormat, eval_odometry};

const LONG_ABOUT: &str = "\
Score a trajectory file against a true one.

Both files hold world_from_camera poses, either as KITTI rows (12 numbers, or 13 with the frame index first) or in TUM form \
(time x y z qx qy qz qw). Frames are matched by index, or by time when both files hold times.

Printed: e_t and e_r (mean error over sub-sequences of fixed lengths), ATE (distance of aligned positions), RPE (error from \
frame to frame). The alignment is always named: a monocular trajectory has no scale, so 'sim3' is the default.";

const EXAMPLES: &str = "\
Examples:
  dimode eval odometry --gt poses/09.txt --est predictions/09/trajectory.kitti.txt
  dimode eval odometry --gt gt.tum --est est.tum --align se3 --json
  dimode eval odometry --gt poses/00.txt --est est.txt --lengths 5,10,20 --start-step 1";

/// Fit before the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Align {
    /// Nothing
    None,
    /// One factor
    Scale,
    /// Rotation and translation (6 degrees of freedom)
    #[value(alias = "6dof")]
    Se3,
    /// Rotation, translation and scale (7 degrees of freedom)
    #[value(alias = "7dof")]
    Sim3,
    /// The scale of the 7-degree fit alone
    Scale7dof,
}

impl From<Align> for Alignment {
    fn from(align: Align) -> Self {
        match align {
            Align::None => Self::None,
            Align::Scale => Self::Scale,
            Align::Se3 => Self::Se3,
            Align::Sim3 => Self::Sim3,
            Align::Scale7dof => Self::Scale7dof,
        }
    }
}

/// Flags of `dimode eval odometry`.
#[derive(Debug, Args)]
#[command(long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct EvalOdometryArgs {
    /// True trajectory
    #[arg(long, value_name = "FILE")]
    gt: PathBuf,
    /// Estimated trajectory
    #[arg(long, value_name = "FILE")]
    est: PathBuf,
    /// Fit before the comparison
    #[arg(long, value_name = "HOW", default_value = "sim3")]
    align: Align,
    /// Form of both files [default: by the number of columns]
    #[arg(long, value_name = "FORM")]
    format: Option<TrajectoryFormat>,
    /// Lengths of the sub-sequences in metres, with commas [default: 100,200,..,800]
    #[arg(long, value_name = "METRES", value_delimiter = ',')]
    lengths: Vec<f64>,
    /// Frames between the starts of sub-sequences
    #[arg(long, value_name = "N", default_value_t = 10)]
    start_step: usize,
    /// Angles and inverses by exact formulas instead of those of the usual tool
    #[arg(long)]
    robust: bool,
    /// Largest difference of times that belong together, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.02)]
    max_time_difference: f64,
    /// Print the numbers as JSON
    #[arg(long)]
    json: bool,
}

impl EvalOdometryArgs {
    /// Compares and prints.
    pub fn run(self) -> anyhow::Result<Exit> {
        let mut protocol = OdometryProtocol { alignment: self.align.into(), start_step: self.start_step, ..Default::default() };
        if !self.lengths.is_empty() {
            protocol.lengths = self.lengths;
        }
        if self.robust {
            protocol.arithmetic = Arithmetic::Robust;
        }
        let result = eval_odometry(&EvalOdometryRequest {
            truth: self.gt,
            estimate: self.est,
            format: self.format,
            max_time_difference: self.max_time_difference,
            protocol,
        })?;
        if self.json {
            output::json(&result)?;
        } else {
            output::text(&result.table())?;
        }
        Ok(Exit::Done)
    }
}

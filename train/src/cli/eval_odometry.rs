//! `dimode eval odometry`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::failure::{Exit, UsageError};
use super::{output, summary};
use crate::eval::{Alignment, Arithmetic, OdometryProtocol};
use crate::progress::Bar;
use crate::run::eval_motion::{EvalMotionRequest, eval_motion};
use crate::run::eval_odometry::{EvalOdometryRequest, OdometryChanges, TrajectoryFormat, eval_odometry};

const LONG_ABOUT: &str = "\
Score motion against ground truth: of a trained run, or of a trajectory file.

A run (--run) is scored on worlds that were not trained on or on a folder with true poses (--data), frame to frame and as \
trajectories, beside predictors that do not look: zero motion and the mean training motion.

Two files (--gt, --est) hold world_from_camera poses, either as KITTI rows (12 numbers, or 13 with the frame index first) or in TUM form \
(time x y z qx qy qz qw). Frames are matched by index, or by time when both files hold times.

Printed: e_t and e_r (mean error over sub-sequences of fixed lengths), ATE (distance of aligned positions), RPE (error from \
frame to frame). The alignment is always named: a monocular trajectory has no scale, so 'sim3' is the default.";

const EXAMPLES: &str = "\
Examples:
  dimode eval odometry --run runs/train-street-s1
  dimode eval odometry --run runs/train-street-s1 --data worlds --lengths 5,10 --json
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

/// How a trajectory is written in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// 12 numbers a line, or 13 with the frame index first
    Kitti,
    /// Time, position, quaternion: 8 numbers a line
    Tum,
}

impl From<Format> for TrajectoryFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Kitti => Self::Kitti,
            Format::Tum => Self::Tum,
        }
    }
}

/// Flags of `dimode eval odometry`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct EvalOdometryArgs {
    /// Folder of a trained run
    #[arg(long, value_name = "RUN", conflicts_with_all = ["est", "format", "max_time_difference"])]
    run: Option<PathBuf>,
    /// Folder of frames with true poses [default: the data of the run, or held-out worlds]
    #[arg(long, value_name = "DIR", requires = "run")]
    data: Option<PathBuf>,
    /// Sequences of the folder, with commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "run")]
    sequences: Vec<String>,
    /// Looks of the pose network at a pair [default: those of the run]
    #[arg(long, value_name = "N", requires = "run")]
    looks: Option<usize>,
    /// True trajectory
    #[arg(long, value_name = "FILE", requires = "est", conflicts_with_all = ["run", "data", "sequences", "looks"])]
    gt: Option<PathBuf>,
    /// Estimated trajectory
    #[arg(long, value_name = "FILE", requires = "gt")]
    est: Option<PathBuf>,
    /// Fit before the comparison
    #[arg(long, value_name = "HOW", default_value = "sim3")]
    align: Align,
    /// Form of both files [default: by the number of columns]
    #[arg(long, value_name = "FORM")]
    format: Option<Format>,
    /// Lengths of the sub-sequences in metres, with commas [default: 100,200,..,800; of a run as in its report]
    #[arg(long, value_name = "METRES", value_delimiter = ',')]
    lengths: Vec<f64>,
    /// Frames between the starts of sub-sequences [default: 10; 1 for a run on short paths]
    #[arg(long, value_name = "N")]
    start_step: Option<usize>,
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
        let json = self.json;
        let changes = OdometryChanges {
            alignment: Some(self.align.into()),
            lengths: self.lengths,
            start_step: self.start_step,
            arithmetic: self.robust.then_some(Arithmetic::Robust),
        };
        let (truth, estimate) = match (self.run, self.gt, self.est) {
            (Some(run), ..) => {
                let request = EvalMotionRequest { run, data: self.data, sequences: self.sequences, looks: self.looks, changes };
                let result = eval_motion(&request, &Bar::new())?;
                if json {
                    output::json(&result)?;
                } else {
                    output::text(&result.render_table())?;
                }
                return Ok(Exit::Done);
            }
            (None, Some(truth), Some(estimate)) => (truth, estimate),
            _ => return Err(UsageError::new("nothing to score", "give --run RUN, or --gt FILE with --est FILE").into()),
        };
        let protocol = changes.on(OdometryProtocol::default());
        let result = eval_odometry(&EvalOdometryRequest {
            truth,
            estimate,
            format: self.format.map(Into::into),
            max_time_difference: self.max_time_difference,
            protocol,
        })?;
        if json {
            output::json(&result)?;
        } else {
            output::text(&result.table())?;
        }
        Ok(Exit::Done)
    }
}

//! `dimode eval depth`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::failure::{Exit, UsageError};
use super::{output, summary};
use crate::eval::{Crop, DepthProtocol, DepthScaling};
use crate::progress::Bar;
use crate::run::eval_depth::{DepthSource, EvalDepthRequest, ProtocolChanges, eval_depth};

const LONG_ABOUT: &str = "\
Score depth against ground truth: the seven usual numbers, beside constant depth on the same frames.

Either a trained run (--run), on worlds that were not trained on or on a folder with true depth (--data); or two folders of \
16-bit PNG files with equal names (--gt, --pred; value = metres x 256, 0 unknown). Predictions of another size are resized as \
disparity. Scale is found per image by the ratio of medians unless --scaling says otherwise.";

const EXAMPLES: &str = "\
Examples:
  dimode eval depth --run runs/train-street-s1
  dimode eval depth --run runs/train-street-s1 --data worlds --json
  dimode eval depth --gt worlds/depth/00 --pred predictions/00/depth --crop garg
  dimode eval depth --run runs/kitti --data kitti --protocol kitti-eigen";

/// Choices behind the numbers, as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Protocol {
    /// Bounds of the run (0.001 to 80 m for pictures), median scaling, whole image
    Default,
    /// As usual for the Eigen split of KITTI: 0.001 to 80 m, median scaling, Garg crop
    KittiEigen,
}

/// How scale is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Scaling {
    /// Ratio of medians, per image
    Median,
    /// The same with the lower of the middle two values
    LowerMedian,
    /// The prediction is in metres
    None,
}

/// Part of the image that counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CropName {
    /// All of it
    None,
    /// The usual crop for KITTI
    Garg,
}

/// Flags of `dimode eval depth`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct EvalDepthArgs {
    /// Folder of a trained run
    #[arg(long, value_name = "RUN", conflicts_with = "pred")]
    run: Option<PathBuf>,
    /// Folder of frames with true depth [default: the data of the run, or held-out worlds]
    #[arg(long, value_name = "DIR", requires = "run")]
    data: Option<PathBuf>,
    /// Sequences of the folder, with commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "run")]
    sequences: Vec<String>,
    /// Folder of true depth pictures
    #[arg(long, value_name = "DIR", requires = "pred", conflicts_with_all = ["run", "data", "sequences"])]
    gt: Option<PathBuf>,
    /// Folder of predicted depth pictures
    #[arg(long, value_name = "DIR", requires = "gt")]
    pred: Option<PathBuf>,
    /// Choices behind the numbers; the flags below change single ones
    #[arg(long, value_name = "NAME", default_value = "default")]
    protocol: Protocol,
    /// How scale is found [default: that of the protocol, median]
    #[arg(long, value_name = "HOW")]
    scaling: Option<Scaling>,
    /// Smallest true depth that counts, metres
    #[arg(long, value_name = "METRES")]
    min_depth: Option<f64>,
    /// Largest true depth that counts, metres
    #[arg(long, value_name = "METRES")]
    max_depth: Option<f64>,
    /// Part of the image that counts [default: that of the protocol]
    #[arg(long, value_name = "WHICH")]
    crop: Option<CropName>,
    /// Print the numbers as JSON
    #[arg(long)]
    json: bool,
}

impl EvalDepthArgs {
    /// Scores and prints.
    pub fn run(self) -> anyhow::Result<Exit> {
        let json = self.json;
        let result = eval_depth(&self.request()?, &Bar::new())?;
        if json {
            output::json(&result)?;
        } else {
            output::text(&result.render_table())?;
        }
        Ok(Exit::Done)
    }

    fn request(self) -> Result<EvalDepthRequest, UsageError> {
        let changes = self.changes();
        let protocol = match self.protocol {
            Protocol::Default => None,
            Protocol::KittiEigen => Some(DepthProtocol::kitti_eigen()),
        };
        let source = match (self.run, self.gt, self.pred) {
            (Some(run), _, _) => DepthSource::Run { run, data: self.data, sequences: self.sequences },
            (None, Some(truth), Some(prediction)) => DepthSource::Pictures { truth, prediction },
            _ => return Err(UsageError::new("nothing to score", "give --run RUN, or --gt DIR with --pred DIR")),
        };
        Ok(EvalDepthRequest { source, protocol, changes })
    }

    fn changes(&self) -> ProtocolChanges {
        let scaling = |name| match name {
            Scaling::Median => DepthScaling::Median,
            Scaling::LowerMedian => DepthScaling::LowerMedian,
            Scaling::None => DepthScaling::None,
        };
        let crop = |name| match name {
            CropName::None => Crop::None,
            CropName::Garg => Crop::Garg,
        };
        ProtocolChanges {
            min_depth: self.min_depth,
            max_depth: self.max_depth,
            scaling: self.scaling.map(scaling),
            crop: self.crop.map(crop),
        }
    }
}

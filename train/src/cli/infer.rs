//! `dimode infer`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use dimode_nets::{DepthNetKind, FlowNetKind, PoseNetKind};

use super::failure::{Exit, UsageError};
use super::options::{Size, refuse_unless};
use super::{interrupt, output, summary};
use crate::counted::counted;
use crate::model::DepthRange;
use crate::progress::Bar;
use crate::run::Stopped;
use crate::run::infer::{Form, Forms, InferRequest, NamedNetworks, SequenceSummary, Source, infer};

const LONG_ABOUT: &str = "\
Write depth, trajectory and flow of every frame of a folder.

The networks are those of a trained run (--run), or any of --depth, --pose and --flow by name with weights in the form of the \
reference programs; what has no network is not written. Frames are resized for the networks, and results back to the frames.

For each sequence: depth/ (16-bit PNG, value = depth x 256), depth_magma/ and depth_turbo/ (inverse depth in colours, near is at \
the upper end), depth_npy/ (float32), the trajectory as trajectory.kitti.txt (12 numbers a line) and trajectory.tum.txt (time, \
position, quaternion), flow/ from each frame to the next (KITTI PNG or .flo), and flow_colour/ with flow_legend.png. Depth and \
positions have one unit, in which a usual depth is 10 unless --unit says otherwise; from a single camera its length is not known.

Frames per second are told for each network alone, the first frame left out, and for everything with reading and writing.";

const EXAMPLES: &str = "\
Examples:
  dimode infer --run runs/train-street-s1 --data DIR --out predictions
  dimode infer --run runs/train-kitti-s1 --data kitti --sequences 09 --flow --out predictions-09
  dimode infer --depth resnet18 --depth-weights mono_640x192 --data DIR --formats png,npy,turbo --out depth
  dimode infer --flow raft_small --flow-weights raft-small.safetensors --size 512x256 --data DIR --out flow";

/// A form of depth or flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FormName {
    /// 16-bit PNG: depth x 256, and flow as in KITTI
    Png,
    /// Depth as NPY, float32
    Npy,
    /// Inverse depth in the colours of magma
    Magma,
    /// Inverse depth in the colours of turbo
    Turbo,
    /// Flow as .flo, float32
    Flo,
    /// Flow by the colour wheel, with a legend
    Wheel,
}

impl FormName {
    fn form(self) -> Form {
        match self {
            Self::Png => Form::Png,
            Self::Npy => Form::Npy,
            Self::Magma => Form::Magma,
            Self::Turbo => Form::Turbo,
            Self::Flo => Form::Flo,
            Self::Wheel => Form::Wheel,
        }
    }
}

/// Flags of `dimode infer`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct InferArgs {
    /// Folder of a trained run
    #[arg(long, value_name = "RUN", conflicts_with_all = ["depth", "pose", "flow_weights", "depth_range"])]
    run: Option<PathBuf>,
    /// Depth network by name, such as resnet18
    #[arg(long, value_name = "NAME", requires = "depth_weights")]
    depth: Option<DepthNetKind>,
    /// Folder with the checkpoint files of the depth network
    #[arg(long, value_name = "DIR", requires = "depth")]
    depth_weights: Option<PathBuf>,
    /// Pose network by name
    #[arg(long, value_name = "NAME", requires = "pose_weights")]
    pose: Option<PoseNetKind>,
    /// Folder (or file, where there is one) with the weights of the pose network
    #[arg(long, value_name = "PATH", requires = "pose")]
    pose_weights: Option<PathBuf>,
    /// Flow network by name; without a name that of the run
    #[arg(long, value_name = "NAME", num_args = 0..=1)]
    flow: Option<Option<FlowNetKind>>,
    /// File (or folder) with the weights of the flow network
    #[arg(long, value_name = "PATH", requires = "flow")]
    flow_weights: Option<PathBuf>,
    /// Folder of frames, as for 'dimode train --data'; without --run it needs no intrinsics
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Sequences of the folder, with commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    sequences: Vec<String>,
    /// Size that the networks see [default: that of the run, or 640x192]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Refinements of the flow [default: those of the run or of the network]
    #[arg(long, value_name = "N")]
    flow_iterations: Option<usize>,
    /// Smallest and largest depth that the depth network can say, in its own unit [default: 0.1,100]
    #[arg(long, value_name = "MIN,MAX", value_delimiter = ',', num_args = 1)]
    depth_range: Vec<f64>,
    /// Factor from the networks' own unit of depth to that of the files [default: a usual depth becomes 10]
    #[arg(long, value_name = "FACTOR")]
    unit: Option<f64>,
    /// Forms to write, with commas
    #[arg(long, value_name = "FORMS", value_delimiter = ',', default_values = ["png", "magma", "wheel"])]
    formats: Vec<FormName>,
    /// Folder to write; must be new or empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print a summary as JSON
    #[arg(long)]
    json: bool,
}

impl InferArgs {
    /// Predicts and writes.
    pub fn run(self) -> anyhow::Result<Exit> {
        let json = self.json;
        let request = self.request()?;
        let stop = interrupt::stop_flag("stopping; nothing will be written")?;
        let bar = Bar::new();
        let summaries = match infer(&request, &bar, &stop) {
            Err(error) if error.is::<Stopped>() => return Ok(Exit::Interrupted),
            other => other?,
        };
        if json {
            output::json(&summaries)?;
        } else {
            output::text(&summaries.iter().map(|summary| told(&request, summary)).collect::<String>())?;
        }
        Ok(Exit::Done)
    }

    fn request(self) -> Result<InferRequest, UsageError> {
        if let Some(unit) = self.unit {
            refuse_unless(unit.is_finite() && unit > 0.0, || format!("--unit {unit}"), "use a finite number above 0")?;
        }
        if let Some(iterations) = self.flow_iterations {
            refuse_unless((1..=64).contains(&iterations), || format!("--flow-iterations {iterations}"), "use 1 to 64")?;
        }
        let mut forms: Vec<Form> = Vec::new();
        for form in self.formats.iter().map(|name| name.form()) {
            if !forms.contains(&form) {
                forms.push(form);
            }
        }
        let (forms, size) = (Forms(forms), self.size.map(|size| (size.width, size.height)));
        Ok(InferRequest {
            source: self.source()?,
            data: self.data,
            sequences: self.sequences,
            size,
            flow_iterations: self.flow_iterations,
            unit: self.unit,
            forms,
            out: self.out,
        })
    }

    fn source(&self) -> Result<Source, UsageError> {
        if let Some(run) = self.run.clone() {
            let named = matches!(self.flow, Some(Some(_)));
            refuse_unless(
                !named,
                || "--flow with a name and --run".to_owned(),
                "write --flow alone for the flow network of the run",
            )?;
            return Ok(Source::Run { run, flow: self.flow.is_some() });
        }
        let flow = match (self.flow, self.flow_weights.clone()) {
            (None, _) => None,
            (Some(Some(kind)), Some(path)) => Some((kind, path)),
            (Some(None), _) => return Err(UsageError::new("--flow without a name", "name the network, or a run with --run")),
            (Some(Some(_)), None) => return Err(UsageError::new("--flow without weights", "add --flow-weights FILE")),
        };
        let depth = self.depth.zip(self.depth_weights.clone());
        let pose = self.pose.zip(self.pose_weights.clone());
        let advice = "give --run RUN, or any of --depth, --pose and --flow with their weights";
        refuse_unless(depth.is_some() || pose.is_some() || flow.is_some(), || "no network".to_owned(), advice)?;
        Ok(Source::Named(NamedNetworks { depth, pose, flow, range: self.range()? }))
    }

    fn range(&self) -> Result<DepthRange, UsageError> {
        match self.depth_range[..] {
            [] => Ok(DepthRange::MONODEPTH),
            [min, max] if min > 0.0 && max > min && max.is_finite() => Ok(DepthRange { min, max }),
            _ => Err(UsageError::new(
                format!("--depth-range {:?}", self.depth_range),
                "use two depths above 0 with a comma, the smaller one first, for instance 0.1,100",
            )),
        }
    }
}

/// What was written for a sequence, and how fast.
fn told(request: &InferRequest, summary: &SequenceSummary) -> String {
    let path = summary.path_length.map_or_else(String::new, |length| format!(", path of {length:.2} units"));
    let scale = summary.flow_scale.map_or_else(String::new, |scale| format!(", flow in full colour at {scale} px"));
    let folder = request.out.join(&summary.name);
    let (name, frames, speed) = (&summary.name, counted(summary.frames, "frame"), summary.speed.told());
    format!("{name}: {frames}{path}{scale} in {}\n  {speed}\n", folder.display())
}

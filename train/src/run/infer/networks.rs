//! The networks at work: those of a run, or single ones with weights of their own.

use std::path::{Path, PathBuf};

use anyhow::Result;
use dimode_autodiff::{Pool, Shape, Tensor};
use dimode_geometry::{Intrinsics, Se3};
use dimode_nets::{DepthNetKind, FlowNetKind, PoseNetKind, UnfitSize, WeightError, weights};
use thiserror::Error;

use super::{InferRequest, USUAL_DEPTH};
use crate::config::{Config, NetsConfig};
use crate::data::DataError;
use crate::inference::{self, Buffers};
use crate::model::{DepthRange, Model};
use crate::pose_refinement::Pairs;
use crate::run::TrainedModel;

/// Where the networks come from.
#[derive(Clone, Debug)]
pub enum Source {
    /// Of a trained run: depth, motion, and flow where it is asked for.
    Run {
        /// Folder of the run.
        run: PathBuf,
        /// Whether flow is written.
        flow: bool,
    },
    /// Single networks.
    Named(NamedNetworks),
}

/// Networks by name, each with the place of its weights: a folder with its checkpoint files, or the file of a network that has
/// one only. Any may be missing.
#[derive(Clone, Debug)]
pub struct NamedNetworks {
    /// Depth from one frame.
    pub depth: Option<(DepthNetKind, PathBuf)>,
    /// Motion between two frames: one look, as the network says it.
    pub pose: Option<(PoseNetKind, PathBuf)>,
    /// Flow from a frame to the next.
    pub flow: Option<(FlowNetKind, PathBuf)>,
    /// Disparity to depth.
    pub range: DepthRange,
}

impl NamedNetworks {
    /// Width and height that the networks see unless another size is asked for.
    pub const SIZE: (usize, usize) = (640, 192);
}

/// Networks that cannot be put to work.
#[derive(Debug, Error)]
pub enum InferError {
    /// What a network says has no form among those that are asked for.
    #[error("--formats has none for {what}; add one of {forms}")]
    NoForm {
        /// Depth or flow.
        what: &'static str,
        /// The forms of it.
        forms: &'static str,
    },
    /// The network does not take frames of this size.
    #[error("{unfit}; choose another --size")]
    Size {
        /// What it takes.
        unfit: UnfitSize,
    },
    /// The weights cannot be read or are those of another network.
    #[error("--{role}-weights: {source}; name what was trained as {network}")]
    Weights {
        /// `depth`, `pose` or `flow`.
        role: &'static str,
        /// Name of the network.
        network: String,
        /// What is wrong with which file.
        source: Box<WeightError>,
    },
    /// One file was named where the network has several.
    #[error("--{role}-weights: {} is one file, {network} has {}; name the folder that holds them", path.display(), files.join(" and "))]
    Several {
        /// `depth` or `pose`.
        role: &'static str,
        /// Name of the network.
        network: String,
        /// The file.
        path: PathBuf,
        /// Names of the checkpoint files.
        files: Vec<String>,
    },
}

impl InferError {
    /// Whether the command, not the files, is to blame.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Size { .. } | Self::Several { .. } | Self::NoForm { .. })
    }
}

/// Networks with their weights, and what is wanted of them.
pub(super) struct Networks {
    pub trained: TrainedModel,
    pub writes_depth: bool,
    pub writes_motion: bool,
    pub writes_flow: bool,
    /// Looks of the pose network at a pair.
    looks: usize,
    /// From the networks' unit of depth to that of the files.
    pub unit: f64,
    buffers: Buffers,
}

impl Networks {
    /// Reads all weights and checks the size.
    pub fn load(request: &InferRequest) -> Result<Self> {
        let mut networks = match &request.source {
            Source::Run { run, flow } => {
                let trained = TrainedModel::load(run)?;
                let looks = trained.config.nets.pose_test_iterations;
                Self { writes_flow: *flow, looks, ..Self::of(trained) }
            }
            Source::Named(named) => Self::named(named, request.size)?,
        };
        let TrainedModel { config, model, .. } = &mut networks.trained;
        if let Some(size) = request.size {
            // The networks stay those of the size they were trained at.
            (config.data.width, config.data.height) = size;
        }
        if let Some(iterations) = request.flow_iterations {
            model.flow_iterations = iterations;
        }
        networks.unit = request.unit.unwrap_or(USUAL_DEPTH / networks.trained.model.range.usual());
        let asked = matches!(&request.source, Source::Named(named) if named.depth.is_some());
        if asked && !request.forms.of_depth() {
            return Err(InferError::NoForm { what: "depth", forms: "png, npy, magma, turbo" }.into());
        }
        if networks.writes_flow && !request.forms.of_flow() {
            return Err(InferError::NoForm { what: "flow", forms: "png, flo, wheel" }.into());
        }
        networks.check_size()?;
        Ok(networks)
    }

    fn of(trained: TrainedModel) -> Self {
        let buffers = Pool::new();
        Self { trained, writes_depth: true, writes_motion: true, writes_flow: true, looks: 1, unit: 1.0, buffers }
    }

    fn named(named: &NamedNetworks, size: Option<(usize, usize)>) -> Result<Self> {
        let usual = NetsConfig::default();
        let nets = NetsConfig {
            depth: named.depth.as_ref().map_or(usual.depth, |(kind, _)| *kind),
            pose: named.pose.as_ref().map_or(usual.pose, |(kind, _)| *kind),
            flow: named.flow.as_ref().map_or(usual.flow, |(kind, _)| *kind),
            rotation_scale: 1.0,
            tangential_scale: 1.0,
            radial_scale: 1.0,
            pose_test_iterations: 1,
            min_depth: named.range.min,
            max_depth: named.range.max,
            ..usual
        };
        let nets = NetsConfig { flow_iterations: nets.flow.config().iterations, ..nets };
        let mut config = Config { nets, ..Config::default() };
        (config.data.width, config.data.height) = size.unwrap_or(NamedNetworks::SIZE);
        let model = Model::of(&config);
        let mut fresh = model.init(0);
        if let Some((kind, path)) = &named.depth {
            load("depth", &kind.to_string(), path, &mut fresh.depth)?;
        }
        if let Some((kind, path)) = &named.pose {
            load("pose", &kind.to_string(), path, &mut fresh.pose)?;
        }
        if let Some((kind, path)) = &named.flow {
            load("flow", &kind.to_string(), path, &mut fresh.flow)?;
        }
        let networks = Self::of(TrainedModel { config, model, weights: fresh });
        Ok(Self {
            writes_depth: named.depth.is_some(),
            writes_motion: named.pose.is_some(),
            writes_flow: named.flow.is_some(),
            ..networks
        })
    }

    /// (width, height) that the networks see.
    pub fn size(&self) -> (usize, usize) {
        (self.trained.config.data.width, self.trained.config.data.height)
    }

    fn check_size(&self) -> Result<(), InferError> {
        let ((width, height), model) = (self.size(), &self.trained.model);
        let fits = [
            (self.needs_depth(), model.depth.check_size(height, width)),
            (self.writes_motion, model.pose.check_size(height, width)),
            (self.writes_flow, model.flow.check_size(height, width)),
        ];
        let unfit = fits.into_iter().find_map(|(used, fits)| fits.err().filter(|_| used));
        unfit.map_or(Ok(()), |unfit| Err(InferError::Size { unfit }))
    }

    /// Whether the camera has a part in what is written: in looks from the second on, and where rotation is removed first.
    pub fn needs_camera(&self) -> bool {
        self.writes_motion && (self.looks > 1 || self.trained.model.rectify.is_some())
    }

    /// Whether the depth of every frame is needed.
    pub fn needs_depth(&self) -> bool {
        self.writes_depth || (self.writes_motion && self.looks > 1)
    }

    /// Depth `[1, 1, h, w]` of an image, in the networks' unit.
    pub fn depth(&self, image: &Tensor<f32>) -> Tensor<f32> {
        let TrainedModel { model, weights, .. } = &self.trained;
        model.range.depth_in(&self.buffers, &inference::disparity(&model.depth, &weights.depth, image, &self.buffers))
    }

    /// The motion that takes points of the first camera to the second.
    pub fn motion(&self, [first, second]: [&Tensor<f32>; 2], depth: Option<&Tensor<f32>>, camera: Intrinsics) -> Se3 {
        let TrainedModel { model, weights, .. } = &self.trained;
        let pairs = Pairs { target: first, source: second, earlier: 0, depth, cameras: &[camera] };
        model.predict_motions_in(&self.buffers, weights, &pairs, self.looks)[0]
    }

    /// Flow `[1, 2, h, w]` from the first image to the second, pixels.
    pub fn flow(&self, images: [&Tensor<f32>; 2]) -> Tensor<f32> {
        let TrainedModel { model, weights, .. } = &self.trained;
        inference::flow(&model.flow, &weights.flow, images, model.flow_iterations, &self.buffers)
    }

    /// Shape of an image for the networks.
    pub fn shape(&self) -> Shape {
        let (width, height) = self.size();
        Shape::new(1, 3, height, width)
    }
}

/// Fills the tensors of a network, or says what is wrong.
fn load(role: &'static str, network: &str, path: &Path, set: &mut dimode_nets::ParamSet<f32>) -> Result<()> {
    let files: Vec<String> = set.files().map(|(file, _)| file.to_owned()).collect();
    let network = network.to_owned();
    let read = match (&files[..], path.is_dir()) {
        _ if !path.exists() => {
            let advice = format!("check --{role}-weights: the folder or file with the weights of {network}");
            return Err(DataError::Missing { path: path.to_owned(), what: format!("{role} weights"), advice }.into());
        }
        (_, true) => weights::load_directory(path, set),
        ([file], false) => weights::load(path, set.file_mut(file)),
        _ => return Err(InferError::Several { role, network, path: path.to_owned(), files }.into()),
    };
    Ok(read.map_err(|source| InferError::Weights { role, network, source: Box::new(source) })?)
}

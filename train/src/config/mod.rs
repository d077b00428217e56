//! The settings of a run: plain structs, one file per group, read from TOML and written back.
//!
//! Every group has defaults, so an empty file is a complete configuration. Values given on the command line win over the
//! file, the file wins over the defaults. A key that does not exist is an error that names the nearest one that does.

mod by_name;
mod data;
mod error;
mod eval;
mod examples;
mod flow_loss;
mod geometric;
mod kind;
mod local_structure;
mod loss;
mod nets;
mod preset;
mod setting;
mod suggest;
mod train;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use dimode_geometry::taped::matches::Matching;
use dimode_nets::{DepthNet, FlowNet, PoseNet, UnfitSize};

use crate::objective::{FlowWays, needs};

pub use crate::data::synthetic::Preset;
pub use data::DataConfig;
pub use error::ConfigError;
pub use eval::EvalConfig;
pub use flow_loss::{FlowData, FlowLossConfig, FlowSmoothnessForm, Iterates, Occlusion};
pub use local_structure::{DegradationConfig, LocalStructure, PseudoDepth};
pub use loss::{ContextualDepth, LossConfig, Photometric, SCALE_ANCHOR, SmoothnessOf, Sources};
pub use nets::{FirstWeights, NetsConfig, Rectify};
pub use preset::LossPreset;
pub use suggest::nearest;
pub use train::{Decay, StageConfig, TrainConfig};

/// All settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of every random choice: weights, order of snippets, augmentation, worlds.
    pub seed: u64,
    /// Where frames come from.
    pub data: DataConfig,
    /// Which networks are trained.
    pub nets: NetsConfig,
    /// Terms of the loss.
    pub loss: LossConfig,
    /// Steps, optimiser and stages.
    pub train: TrainConfig,
    /// Evaluation after training.
    pub eval: EvalConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            data: DataConfig::default(),
            nets: NetsConfig::default(),
            loss: LossConfig::default(),
            train: TrainConfig::default(),
            eval: EvalConfig::default(),
        }
    }
}

impl Config {
    /// The settings of `--quick`: few steps, smaller frames, a short evaluation; a first look within two minutes.
    pub fn quick() -> Self {
        let mut config = Self::default();
        config.apply_quick();
        config
    }

    /// Changes the sizes to those of [`Config::quick`] and leaves every choice of form and data as it is.
    pub fn apply_quick(&mut self) {
        self.data.width = 96;
        self.data.height = 64;
        self.data.worlds = 256;
        self.train.steps = 300;
        self.train.warmup = 20;
        self.train.checkpoint_every = 100;
        self.eval.worlds = 2;
        self.eval.frames = 12;
    }

    /// The paper's learning rate for all networks, and the lengths of its stages where the preset has these.
    pub fn use_paper_schedule(&mut self) {
        let train = &mut self.train;
        (train.learning_rate, train.pose_rate) = (1e-4, 1.0);
        if matches!(self.loss.preset, LossPreset::Dimode | LossPreset::DimodeLiteral) {
            for (stage, parts) in train.stages.iter_mut().zip(StageConfig::PAPER_PARTS) {
                stage.share = parts / 30.0;
            }
        }
    }

    /// Reads a configuration from TOML. `path` is used in messages only.
    ///
    /// **Errors** [`ConfigError::UnknownKey`], [`ConfigError::UnknownName`], [`ConfigError::WrongKind`] or
    /// [`ConfigError::Syntax`], with the line. Ranges are not checked here but by [`Config::validate`], because flags may still
    /// change values. What the file does not name has the value of the preset that it names, else the default.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let explain = |error: toml::de::Error| suggest::explain(&error, text, path);
        let over_defaults: Self = toml::from_str(text).map_err(explain)?;
        let preset = over_defaults.loss.preset;
        if preset == LossPreset::default() {
            return Ok(over_defaults);
        }
        let mut table = preset.config().to_table();
        setting::merge(&mut table, toml::from_str(text).map_err(explain)?);
        Self::from_table(table, &path.display().to_string())
    }

    /// The configuration in a TOML table; `origin` is used in messages.
    ///
    /// **Errors** as [`Config::from_toml`].
    pub fn from_table(table: toml::Table, origin: &str) -> Result<Self, ConfigError> {
        table.try_into().map_err(|error| suggest::explain(&error, "", Path::new(origin)))
    }

    /// Reads a configuration file.
    ///
    /// **Errors** [`ConfigError::Read`] when the file cannot be read, else as [`Config::from_toml`].
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        Self::from_toml(&text, path)
    }

    /// Reads a file that must name every setting, as [`Config::to_toml`] writes it: what a run was made with must not follow
    /// the defaults of a later version.
    ///
    /// **Errors** as [`Config::read`], and [`ConfigError::MissingKey`] for the first setting that is missing.
    pub fn read_complete(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        let config = Self::from_toml(&text, path)?;
        let given: toml::Table = toml::from_str(&text).expect("read before");
        match missing(&config.to_table(), &given, "") {
            Some((key, default)) => Err(ConfigError::MissingKey { path: path.to_owned(), key, default }),
            None => Ok(config),
        }
    }

    /// The configuration as TOML, with a comment for each setting that has no value; [`Config::from_toml`] gives back an equal
    /// one.
    pub fn to_toml(&self) -> String {
        let text = toml::to_string_pretty(self).expect("a configuration holds only what TOML can hold");
        examples::add_unset(text, &self.to_table())
    }

    /// The configuration as a TOML table.
    fn to_table(&self) -> toml::Table {
        toml::Table::try_from(self).expect("a configuration holds only what TOML can hold")
    }

    /// The same settings with absolute paths: a run may go on from another working directory.
    pub fn with_absolute_paths(mut self) -> Self {
        let absolute = |path: &mut PathBuf| *path = std::path::absolute(&*path).unwrap_or_else(|_| path.clone());
        self.data.path.as_mut().map(absolute);
        self.loss.local_structure.folder.as_mut().map(absolute);
        let nets = &mut self.nets;
        for weights in [&mut nets.depth_weights, &mut nets.pose_weights, &mut nets.flow_weights] {
            if let FirstWeights::File(path) = weights {
                absolute(path);
            }
        }
        self
    }

    /// Checks every range.
    ///
    /// **Errors** [`ConfigError::Value`] for the first value that cannot work; the message says what would.
    pub fn validate(&self) -> Result<(), ConfigError> {
        error::require(self.seed <= i64::MAX as u64, "seed", self.seed, "must be below 2^63 (TOML integers are signed)")?;
        self.data.validate()?;
        self.nets.validate()?;
        self.loss.validate()?;
        self.train.validate()?;
        self.eval.validate()?;
        self.validate_together()
    }

    /// What one group asks of another.
    fn validate_together(&self) -> Result<(), ConfigError> {
        let rendered = self.loss.local_structure.pseudo_depth == PseudoDepth::Rendered;
        let key = "loss.local_structure.pseudo_depth";
        let advice = "only the embedded world is rendered; with data.path choose folder, self-guided or none";
        error::require(!rendered || self.data.path.is_none(), key, "rendered", advice)?;
        let local = &self.loss.local_structure;
        let used = local.pseudo_depth == PseudoDepth::None || self.train.stages.iter().any(|stage| stage.lambda3 > 0.0);
        let advice = "no stage has lambda3 above 0, so nothing would look at it; set for instance train.stages.1.lambda3 = 0.01";
        error::require(used, key, local.pseudo_depth.name(), advice)?;
        let pixels = (self.data.width * self.data.height) as f64;
        let most = Matching::default().best as f64 / pixels;
        let enough = self.loss.occlusion != Occlusion::BestMatches || self.loss.geometric.min_valid_share < most;
        let advice = format!("best-matches leaves at most {most:.3} of the pixels of these frames; must be below that");
        error::require(enough, "loss.geometric.min_valid_share", self.loss.geometric.min_valid_share, &advice)?;
        let sees_flow = |stage: &StageConfig| needs(&self.loss, stage).flow != FlowWays::None;
        let advice = "the optical flow knows nothing of the removed rotation; choose none, or a loss without optical flow such as \
                      --loss sc-depth";
        let goes = self.nets.rectify == Rectify::None || !self.train.stages.iter().any(sees_flow);
        error::require(goes, "nets.rectify", self.nets.rectify.name(), advice)?;
        self.validate_sizes()
    }

    /// The networks can take the frames.
    fn validate_sizes(&self) -> Result<(), ConfigError> {
        let (NetsConfig { depth, pose, flow, .. }, DataConfig { width, height, .. }) = (&self.nets, &self.data);
        let fits = |key, name: String, checked: Result<(), UnfitSize>| {
            let advice = checked.err().map_or_else(String::new, |unfit| format!("{unfit}; change data.width and data.height"));
            error::require(advice.is_empty(), key, name, &advice)
        };
        fits("nets.depth", depth.to_string(), DepthNet::new(depth.config()).check_size(*height, *width))?;
        fits("nets.pose", pose.to_string(), PoseNet::new(pose.config()).check_size(*height, *width))?;
        fits("nets.flow", flow.to_string(), FlowNet::new(flow.config()).check_size(*height, *width))
    }
}

/// The first key of `whole` that `given` does not have, with its table, and its value.
fn missing(whole: &toml::Table, given: &toml::Table, table: &str) -> Option<(String, String)> {
    whole.iter().find_map(|(key, value)| match (value, given.get(key)) {
        (toml::Value::Table(inner), None) => missing(inner, &toml::Table::new(), &format!("{table}{key}.")),
        (toml::Value::Table(inner), Some(toml::Value::Table(given))) => missing(inner, given, &format!("{table}{key}.")),
        (_, Some(_)) => None,
        (value, None) => Some((format!("{table}{key}"), value.to_string())),
    })
}

#[cfg(test)]
mod tests;

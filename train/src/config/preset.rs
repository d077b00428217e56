//! `loss.preset`: the method whose loss and stages a run starts from.

use std::fmt;
use std::str::FromStr;

use dimode_geometry::losses::LossOptions;
use serde::{Deserialize, Serialize};

use super::{Config, FlowLossConfig, Iterates, LossConfig, Photometric, SmoothnessOf, Sources, StageConfig, nearest};
use crate::losses::contextual_geometric::{PART_WEIGHT, WEIGHT};

/// A method, as far as its loss goes: networks, data and optimiser stay, so that runs differ by the loss alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossPreset {
    /// DiMoDE in the forms that train ([`LossOptions::default`]), three stages.
    #[default]
    Dimode,
    /// DiMoDE with its four geometric losses as printed ([`LossOptions::literal`]), three scales, and the flow network's own loss on
    /// its last flow without smoothness; three stages.
    DimodeLiteral,
    /// Monodepth2: minimum reprojection with auto-mask and smoothness on four scales; one stage.
    Monodepth2,
    /// SC-Depth (V1 of sc_depth_pl): photometric and geometric consistency of view pairs, smoothness of the depth; one stage. With
    /// a pseudo-depth (`loss.local_structure.pseudo_depth`) also the local structure terms of V3.
    ScDepth,
    /// DF-Net: after a joint stage rigid and optical flow agree (`cross_task`), on four scales. With `train_flow` in that stage they
    /// teach each other.
    DfNet,
    /// DCPI-Depth: after a joint stage the depth that flow and motion imply is compared with the predicted one (`contextual`), in
    /// the last third also divergence and depth slope; next frame only, three scales.
    Dcpi,
}

impl LossPreset {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Dimode, Self::DimodeLiteral, Self::Monodepth2, Self::ScDepth, Self::DfNet, Self::Dcpi];

    /// What configuration files call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dimode => "dimode",
            Self::DimodeLiteral => "dimode-literal",
            Self::Monodepth2 => "monodepth2",
            Self::ScDepth => "sc-depth",
            Self::DfNet => "df-net",
            Self::Dcpi => "dcpi",
        }
    }

    /// Terms of the loss and their weights, but for those that the stages have.
    pub fn loss(self) -> LossConfig {
        let base = LossConfig { preset: self, ..LossConfig::plain() };
        match self {
            Self::Dimode => base,
            Self::DimodeLiteral => {
                let flow = FlowLossConfig { smoothness: 0.0, iterates: Iterates::Last, ..FlowLossConfig::default() };
                LossConfig { geometric: LossOptions::literal(), scales: 3, flow, ..base }
            }
            Self::Monodepth2 | Self::DfNet => LossConfig { scales: 4, ..base },
            Self::ScDepth => {
                let mut loss = LossConfig { photometric: Photometric::ScDepth, geometry_consistency: 0.1, ..base };
                (loss.smoothness, loss.smoothness_of) = (0.1, SmoothnessOf::Depth);
                (loss.local_structure.relative_normal, loss.local_structure.depth_ranking) = (1.0, 1.0);
                loss
            }
            Self::Dcpi => LossConfig { scales: 3, sources: Sources::Next, ..base },
        }
    }

    /// The stages with the weights that belong to them.
    pub fn stages(self) -> Vec<StageConfig> {
        let joint = || StageConfig { lambda3: 0.01, train_flow: true, ..StageConfig::new("1 joint", 2.0 / 30.0) };
        match self {
            Self::Dimode | Self::DimodeLiteral => StageConfig::nano(),
            Self::Monodepth2 => vec![StageConfig::new("1 joint", 1.0)],
            Self::ScDepth => vec![StageConfig { lambda3: 0.1, ..StageConfig::new("1 joint", 1.0) }],
            // 0.5 w_s beside a ternary loss that is some hundred times l_pho and has the weights w_s, too.
            Self::DfNet => {
                vec![joint(), StageConfig { lambda3: 0.01, cross_task: 1e-3, ..StageConfig::new("2 cross-task", 28.0 / 30.0) }]
            }
            Self::Dcpi => {
                let part = WEIGHT * PART_WEIGHT;
                let contextual = StageConfig {
                    lambda3: 0.01,
                    contextual: WEIGHT,
                    rigid: part,
                    ..StageConfig::new("2 contextual", 18.0 / 30.0)
                };
                let last =
                    StageConfig { divergence: part, name: "3 divergence".into(), share: 10.0 / 30.0, ..contextual.clone() };
                vec![joint(), contextual, last]
            }
        }
    }

    /// Puts the whole loss of a configuration and its stages to those of the method.
    pub fn apply(self, config: &mut Config) {
        config.loss = self.loss();
        config.train.stages = self.stages();
    }

    /// The defaults with this method's loss and stages.
    pub fn config(self) -> Config {
        let mut config = Config::default();
        self.apply(&mut config);
        config
    }
}

impl fmt::Display for LossPreset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for LossPreset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = Self::ALL.map(Self::name);
        let found = Self::ALL.into_iter().find(|preset| preset.name() == text);
        found.ok_or_else(|| match nearest(text, names) {
            Some(name) => format!("did you mean '{name}'?"),
            None => format!("use one of {}", names.join(", ")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_files() {
        for preset in LossPreset::ALL {
            assert_eq!(preset.name().parse(), Ok(preset));
            assert_eq!(toml::Value::try_from(preset).unwrap().as_str(), Some(preset.name()));
        }
        assert_eq!(
            "literal".parse::<LossPreset>().unwrap_err(),
            "use one of dimode, dimode-literal, monodepth2, sc-depth, df-net, dcpi"
        );
        assert_eq!("monodepth".parse::<LossPreset>().unwrap_err(), "did you mean 'monodepth2'?");
    }

    #[test]
    fn every_preset_is_valid_and_is_written_and_read_as_it_is() {
        for preset in LossPreset::ALL {
            let config = preset.config();
            config.validate().unwrap();
            assert_eq!(config.loss.preset, preset);
            let path = std::path::Path::new("run.toml");
            assert_eq!(Config::from_toml(&config.to_toml(), path).unwrap(), config);
            let shares: f64 = config.train.stages.iter().map(|stage| stage.share).sum();
            assert!((shares - 1.0).abs() < 1e-12, "{preset}: {shares}");
        }
        assert_eq!(LossPreset::Dimode.config(), Config::default());
    }

    #[test]
    fn a_file_changes_single_values_of_the_preset_that_it_names() {
        let path = std::path::Path::new("run.toml");
        let text = "[loss]\npreset = \"sc-depth\"\ngeometry_consistency = 0.5\n[loss.local_structure]\ndepth_ranking = 0.25\n";
        let mut expected = LossPreset::ScDepth.config();
        expected.loss.geometry_consistency = 0.5;
        expected.loss.local_structure.depth_ranking = 0.25;
        assert_eq!(Config::from_toml(text, path).unwrap(), expected);
        let text = "[loss]\npreset = \"dcpi\"\n[[train.stages]]\nname = \"all\"\nshare = 1.0\ncontextual = 0.02\n";
        let stages = Config::from_toml(text, path).unwrap().train.stages;
        assert_eq!(stages, [StageConfig { contextual: 0.02, ..StageConfig::new("all", 1.0) }]);
        let message = Config::from_toml("[loss]\npreset = \"dfnet\"\n", path).unwrap_err().to_string();
        assert_eq!(message, "run.toml:2: unknown value 'dfnet'; did you mean 'df-net'?");
    }
}

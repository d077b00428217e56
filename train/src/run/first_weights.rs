//! Where the first weights of the networks come from.

use std::path::{Path, PathBuf};

use anyhow::Result;
use dimode_nets::{ParamSet, WeightError, weights};
use thiserror::Error;

use crate::config::{FirstWeights, NetsConfig};
use crate::data::DataError;
use crate::model::Weights;

/// Weights of `nano_raft_d4` after `dimode pretrain flow`; `assets/README.md` tells command, seed and error.
const FLOW: &[u8] = include_bytes!("../../assets/flow_nano_raft_d4.safetensors");
/// Weights of the `nano` pose network after `dimode pretrain pose`, file by file.
const POSE: [(&str, &[u8]); 2] = [
    ("pose_encoder", include_bytes!("../../assets/pose_nano/pose_encoder.safetensors")),
    ("pose", include_bytes!("../../assets/pose_nano/pose.safetensors")),
];

/// First weights that cannot be used.
#[derive(Debug, Error)]
#[error("{setting}: {source}; {advice}")]
pub struct FirstWeightsError {
    /// The setting that names them.
    pub setting: &'static str,
    /// What is wrong with which file.
    pub source: Box<WeightError>,
    /// What to write instead.
    pub advice: &'static str,
}

/// A network whose first weights a setting names.
struct Part<'a> {
    setting: &'static str,
    /// What the program has for it: file by file.
    embedded: &'static [(&'static str, &'static [u8])],
    from: &'a FirstWeights,
    set: &'a mut ParamSet<f32>,
    /// Whether a part of the network may start random: an encoder that knows pictures goes with a fresh decoder.
    partial: bool,
    advice: &'static str,
}

/// Replaces fresh weights by those that the configuration names. Says, a line each, which files of a network were not there: their
/// part stays random.
///
/// # Errors
/// [`DataError::Missing`] when nothing is where the configuration points; [`FirstWeightsError`] when no weights are embedded for
/// this size, or a file cannot be read or does not fit. Nothing is changed then.
pub fn load_first_weights(nets: &NetsConfig, fresh: &mut Weights) -> Result<Vec<String>> {
    let mut loaded = fresh.clone();
    let parts = [
        Part {
            setting: "nets.depth_weights",
            embedded: &[],
            from: &nets.depth_weights,
            set: &mut loaded.depth,
            partial: true,
            advice: "name weights of this network, or leave nets.depth_weights out",
        },
        Part {
            setting: "nets.flow_weights",
            embedded: &[("raft", FLOW)],
            from: &nets.flow_weights,
            set: &mut loaded.flow,
            partial: false,
            advice: "name a file that 'dimode pretrain flow' wrote for this size of network, or leave nets.flow_weights out",
        },
        Part {
            setting: "nets.pose_weights",
            embedded: &POSE,
            from: &nets.pose_weights,
            set: &mut loaded.pose,
            partial: false,
            advice: "name a folder that 'dimode pretrain pose' wrote for this size of network, or leave nets.pose_weights out",
        },
    ];
    let mut notes = Vec::new();
    for part in parts {
        match part.from {
            FirstWeights::Random => {}
            FirstWeights::Embedded => embedded(part.set, part.embedded).map_err(|source| part.error(source))?,
            FirstWeights::File(path) => notes.extend(part.load(path)?),
        }
    }
    *fresh = loaded;
    Ok(notes)
}

impl Part<'_> {
    /// `depth weights`, for instance.
    fn what(&self) -> String {
        self.setting.trim_start_matches("nets.").replace('_', " ")
    }

    fn error(&self, source: WeightError) -> FirstWeightsError {
        FirstWeightsError { setting: self.setting, source: Box::new(source), advice: self.advice }
    }

    /// Loads the files of the network that are there, and says which are not.
    fn load(self, path: &Path) -> Result<Vec<String>> {
        let names: Vec<String> = self.set.files().map(|(name, _)| name.to_owned()).collect();
        let found: Vec<(String, Option<PathBuf>)> = match &names[..] {
            [only] if path.is_file() => vec![(only.clone(), Some(path.to_owned()))],
            _ => names.into_iter().map(|name| (name.clone(), file_of(path, &name))).collect(),
        };
        let there = found.iter().filter(|(_, file)| file.is_some()).count();
        if there == 0 || there < found.len() && !self.partial {
            let missing = found.iter().filter(|(_, file)| file.is_none());
            let files: Vec<String> = missing.map(|(name, _)| format!("{name}.safetensors or {name}.pth")).collect();
            let advice = format!("check {}: a folder with {}", self.setting, files.join(", "));
            return Err(DataError::Missing { path: path.to_owned(), what: self.what(), advice }.into());
        }
        let mut notes = Vec::new();
        for (name, file) in found {
            match file {
                Some(file) => weights::load(&file, self.set.file_mut(&name)).map_err(|source| FirstWeightsError {
                    setting: self.setting,
                    source: Box::new(source),
                    advice: self.advice,
                })?,
                None => notes.push(format!("{}: no {name} in {}; that part starts random", self.setting, path.display())),
            }
        }
        Ok(notes)
    }
}

/// The file of a part of a network in a folder.
fn file_of(folder: &Path, name: &str) -> Option<PathBuf> {
    weights::ENDINGS.map(|ending| folder.join(format!("{name}.{ending}"))).into_iter().find(|file| file.is_file())
}

fn embedded(set: &mut ParamSet<f32>, files: &[(&str, &[u8])]) -> Result<(), WeightError> {
    for (file, bytes) in files {
        let origin = format!("embedded weights {file}");
        weights::assign(set.file_mut(file), weights::parse(bytes, &origin)?, &origin)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_nets::PoseNetKind;

    use crate::model::Model;

    #[test]
    fn of_a_depth_network_a_file_may_be_missing_and_is_named() {
        let place = tempfile::tempdir().unwrap();
        let nets = NetsConfig { depth_weights: FirstWeights::File(place.path().to_owned()), ..NetsConfig::default() };
        let model = Model::new(&nets);
        let [trained, fresh] = [5, 6].map(|seed| model.init(seed));
        let encoder = |weights: &Weights| weights.depth.file("encoder").unwrap().iter().next().unwrap().1.tensor().to_vec();
        let decoder = |weights: &Weights| weights.depth.file("depth").unwrap().iter().next().unwrap().1.tensor().to_vec();
        let missing = load_first_weights(&nets, &mut fresh.clone()).unwrap_err().to_string();
        assert!(missing.contains("depth weights not found") && missing.contains("encoder.safetensors"), "{missing}");

        weights::save(&place.path().join("encoder.safetensors"), trained.depth.file("encoder").unwrap()).unwrap();
        let mut loaded = fresh.clone();
        let notes = load_first_weights(&nets, &mut loaded).unwrap();
        assert!(
            notes.len() == 1 && notes[0].contains("no depth in") && notes[0].ends_with("that part starts random"),
            "{notes:?}"
        );
        assert!(encoder(&loaded) == encoder(&trained) && encoder(&loaded) != encoder(&fresh));
        assert_eq!(decoder(&loaded), decoder(&fresh));
    }

    #[test]
    fn weights_of_another_network_are_told_in_a_line_that_names_the_place_once() {
        let place = tempfile::tempdir().unwrap();
        let small = NetsConfig::default();
        weights::save_directory(place.path(), &Model::new(&small).init(0).pose).unwrap();
        let pose_weights = FirstWeights::File(place.path().to_owned());
        let nets = NetsConfig { pose: PoseNetKind::Resnet18, pose_weights, ..small };
        let message = load_first_weights(&nets, &mut Model::new(&nets).init(0)).unwrap_err().to_string();
        assert!(message.starts_with("nets.pose_weights: "), "{message}");
        assert!(message.ends_with("or leave nets.pose_weights out"), "{message}");
        assert!(message.contains("pose_encoder.safetensors does not fit the network"), "{message}");
        assert_eq!(message.matches(place.path().to_str().unwrap()).count(), 1, "{message}");
        assert!(message.len() < 600, "{message}");
    }
}

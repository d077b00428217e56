//! Where the first weights of the flow and the pose network come from.

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

/// **Errors** [`DataError::Missing`] when nothing is where the configuration points.
fn check_present(nets: &NetsConfig) -> Result<(), DataError> {
    if let FirstWeights::File(path) = &nets.flow_weights
        && !path.is_file()
    {
        let advice = "check nets.flow_weights: embedded, random or a file that 'dimode pretrain flow' wrote".to_owned();
        return Err(DataError::Missing { path: path.clone(), what: "flow weights".to_owned(), advice });
    }
    if let FirstWeights::File(path) = &nets.pose_weights
        && !path.is_dir()
    {
        let advice = "check nets.pose_weights: embedded, random or a folder that 'dimode pretrain pose' wrote".to_owned();
        return Err(DataError::Missing { path: path.clone(), what: "pose weights".to_owned(), advice });
    }
    Ok(())
}

/// Replaces fresh weights of the flow and the pose network by those that the configuration names.
///
/// # Errors
/// [`DataError::Missing`] when nothing is where the configuration points; [`FirstWeightsError`] when no weights are embedded for
/// this size, or a file cannot be read or does not fit.
pub fn load_first_weights(nets: &NetsConfig, fresh: &mut Weights) -> Result<()> {
    check_present(nets)?;
    load_flow_weights(&nets.flow_weights, &mut fresh.flow).map_err(|source| FirstWeightsError {
        setting: "nets.flow_weights",
        source: Box::new(source),
        advice: "name a file that 'dimode pretrain flow' wrote for this size of network, or leave nets.flow_weights out",
    })?;
    load_pose_weights(&nets.pose_weights, &mut fresh.pose).map_err(|source| FirstWeightsError {
        setting: "nets.pose_weights",
        source: Box::new(source),
        advice: "name a folder that 'dimode pretrain pose' wrote for this size of network, or leave nets.pose_weights out",
    })?;
    Ok(())
}

fn load_flow_weights(from: &FirstWeights, set: &mut ParamSet<f32>) -> Result<(), WeightError> {
    match from {
        FirstWeights::Random => Ok(()),
        FirstWeights::Embedded => embedded(set, &[("raft", FLOW)]),
        FirstWeights::File(path) => weights::load(path, set.file_mut("raft")),
    }
}

fn load_pose_weights(from: &FirstWeights, set: &mut ParamSet<f32>) -> Result<(), WeightError> {
    match from {
        FirstWeights::Random => Ok(()),
        FirstWeights::Embedded => embedded(set, &POSE),
        FirstWeights::File(path) => weights::load_directory(path, set),
    }
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

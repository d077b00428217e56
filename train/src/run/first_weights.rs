//! Where the first weights of the flow and the pose network come from.

use anyhow::{Context, Result, bail};
use dimode_nets::{FlowNetKind, ParamSet, PoseNetKind, weights};

use crate::config::{FirstWeights, NetsConfig};
use crate::data::DataError;
use crate::model::{Model, Weights};

/// Weights of `nano_raft_d4` after `dimode pretrain flow`; `assets/README.md` tells command, seed and error.
const FLOW: &[u8] = include_bytes!("../../assets/flow_nano_raft_d4.safetensors");
/// Weights of the `nano` pose network after `dimode pretrain pose`, file by file.
const POSE: [(&str, &[u8]); 2] = [
    ("pose_encoder", include_bytes!("../../assets/pose_nano/pose_encoder.safetensors")),
    ("pose", include_bytes!("../../assets/pose_nano/pose.safetensors")),
];

/// Finds out before anything is written whether the weights that the configuration names can be used.
///
/// # Errors
/// As [`load_first_weights`]; [`DataError::Malformed`] for a file.
pub fn check_first_weights(nets: &NetsConfig) -> Result<()> {
    if let FirstWeights::File(path) = &nets.flow_weights
        && !path.is_file()
    {
        let advice = "check nets.flow_weights: embedded, random or a file that 'dimode pretrain flow' wrote".to_owned();
        return Err(DataError::Missing { path: path.clone(), what: "flow weights".to_owned(), advice }.into());
    }
    if let FirstWeights::File(path) = &nets.pose_weights
        && !path.is_dir()
    {
        let advice = "check nets.pose_weights: embedded, random or a folder that 'dimode pretrain pose' wrote".to_owned();
        return Err(DataError::Missing { path: path.clone(), what: "pose weights".to_owned(), advice }.into());
    }
    let mut fresh = Model::new(nets).init(0);
    let explain = |loaded: Result<()>, from: &FirstWeights, advice: &str| match from {
        FirstWeights::File(path) => {
            loaded.map_err(|error| DataError::malformed(path, format!("{error:#}"), advice.to_owned()).into())
        }
        _ => loaded,
    };
    let advice = "name a file that 'dimode pretrain flow' wrote for this size of network, or leave nets.flow_weights out";
    explain(load_flow_weights(nets, &mut fresh.flow), &nets.flow_weights, advice)?;
    let advice = "name a folder that 'dimode pretrain pose' wrote for this size of network, or leave nets.pose_weights out";
    explain(load_pose_weights(nets, &mut fresh.pose), &nets.pose_weights, advice)
}

/// Replaces fresh weights of the flow and the pose network by those that the configuration names.
///
/// # Errors
/// When no weights are embedded for this size, or a file cannot be read or does not fit.
pub fn load_first_weights(nets: &NetsConfig, fresh: &mut Weights) -> Result<()> {
    load_flow_weights(nets, &mut fresh.flow)?;
    load_pose_weights(nets, &mut fresh.pose)
}

fn load_flow_weights(nets: &NetsConfig, set: &mut ParamSet<f32>) -> Result<()> {
    match &nets.flow_weights {
        FirstWeights::Random => Ok(()),
        FirstWeights::Embedded if nets.flow != FlowNetKind::NanoRaftD4 => bail!(
            "nets.flow_weights: no weights for {} are part of the program; make some with `dimode pretrain flow` and name the \
             file, or say \"random\"",
            nets.flow
        ),
        FirstWeights::Embedded => embedded(set, &[("raft", FLOW)]),
        FirstWeights::File(path) => {
            weights::load(path, set.file_mut("raft")).with_context(|| format!("nets.flow_weights: {}", path.display()))
        }
    }
}

fn load_pose_weights(nets: &NetsConfig, set: &mut ParamSet<f32>) -> Result<()> {
    match &nets.pose_weights {
        FirstWeights::Random => Ok(()),
        FirstWeights::Embedded if nets.pose != PoseNetKind::Nano => bail!(
            "nets.pose_weights: no weights for {} are part of the program; make some with `dimode pretrain pose` and name the \
             folder, or say \"random\"",
            nets.pose
        ),
        FirstWeights::Embedded => embedded(set, &POSE),
        FirstWeights::File(path) => {
            weights::load_directory(path, set).with_context(|| format!("nets.pose_weights: {}", path.display()))
        }
    }
}

fn embedded(set: &mut ParamSet<f32>, files: &[(&str, &[u8])]) -> Result<()> {
    for (file, bytes) in files {
        let origin = format!("embedded weights {file}");
        weights::assign(set.file_mut(file), weights::parse(bytes, &origin)?, &origin)?;
    }
    Ok(())
}

//! Where the flow network's first weights come from.

use anyhow::{Context, Result, bail};
use dimode_nets::{FlowNet, FlowNetKind, Network, ParamSet, weights};

use crate::config::{FlowWeights, NetsConfig};
use crate::data::DataError;

/// Weights of `nano_raft_d4` after `dimode pretrain flow`; `assets/README.md` tells command, seed and error.
const EMBEDDED: &[u8] = include_bytes!("../../assets/flow_nano_raft_d4.safetensors");

/// Finds out before anything is written whether the weights that the configuration names can be used.
///
/// # Errors
/// As [`load_flow_weights`]; [`DataError::Malformed`] for a file.
pub fn check_flow_weights(nets: &NetsConfig) -> Result<()> {
    let loaded = load_flow_weights(nets, &mut FlowNet::new(nets.flow.config()).init(0));
    let FlowWeights::File(path) = &nets.flow_weights else { return loaded };
    let advice = "name a file that 'dimode pretrain flow' wrote for this size of network, or leave nets.flow_weights out";
    loaded.map_err(|error| DataError::malformed(path, format!("{error:#}"), advice).into())
}

/// Replaces fresh weights by those that the configuration names.
///
/// # Errors
/// When no weights are embedded for this size, or the file cannot be read or does not fit.
pub fn load_flow_weights(nets: &NetsConfig, set: &mut ParamSet<f32>) -> Result<()> {
    let (tensors, origin) = match &nets.flow_weights {
        FlowWeights::Random => return Ok(()),
        FlowWeights::Embedded if nets.flow != FlowNetKind::NanoRaftD4 => bail!(
            "nets.flow_weights: no weights for {} are part of the program; make some with `dimode pretrain flow` and name the \
             file, or say \"random\"",
            nets.flow
        ),
        FlowWeights::Embedded => (weights::parse(EMBEDDED, "embedded flow weights")?, "embedded flow weights".to_owned()),
        FlowWeights::File(path) => (weights::read(path)?, path.display().to_string()),
    };
    weights::assign(set.file_mut("raft"), tensors, &origin).with_context(|| format!("nets.flow_weights: {origin}"))
}

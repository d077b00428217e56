//! Where the flow network's first weights come from.

use anyhow::{Context, Result, bail};
use dimode_nets::{FlowNetKind, ParamSet, weights};

use crate::config::{FlowWeights, NetsConfig};

/// Weights of `nano_raft_d4` after `dimode pretrain flow`; `assets/README.md` tells command, seed and error.
const EMBEDDED: &[u8] = include_bytes!("../../assets/flow_nano_raft_d4.safetensors");

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

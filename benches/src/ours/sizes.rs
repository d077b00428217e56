//! Sizes of networks, by the names that the peer gives them.

use dimode_nets::{DepthNetConfig, FlowNetConfig, PoseNetConfig, ResNetConfig, ResNetPoseConfig};
use serde_json::{Value, json};

/// Of a depth network.
///
/// # Panics
/// When the peer does not have it.
pub fn depth(config: &DepthNetConfig) -> Value {
    match config {
        DepthNetConfig::ResNet(config) => {
            json!({"net": "depth", "encoder": encoder(&config.encoder), "decoder": config.decoder})
        }
        DepthNetConfig::LiteMono(config) => json!({
            "net": "depth", "dims": config.dims, "dilations": config.dilations, "heads": config.heads,
            "expansion": config.expansion
        }),
        other => panic!("the peer has no twin of {other:?}"),
    }
}

/// Of a pose network whose rotations and translations have factors: rotation, tangential, radial.
///
/// # Panics
/// When the peer does not have it.
pub fn pose(config: &PoseNetConfig, [rotation, tangential, radial]: [f64; 3]) -> Value {
    match config {
        PoseNetConfig::ResNet(ResNetPoseConfig { encoder: sizes, decoder, frames }) => {
            let scale = [[rotation; 3], [tangential, tangential, radial]].concat();
            json!({"net": "pose", "encoder": encoder(sizes), "decoder": decoder, "frames": frames, "scale": scale})
        }
        other => panic!("the peer has no twin of {other:?}"),
    }
}

/// Of a small flow network with a number of refinements.
pub fn flow(config: &FlowNetConfig, iterations: usize) -> Value {
    let FlowNetConfig { stem, stages, last_stride, features, hidden, context, levels, radius, .. } = config;
    let FlowNetConfig { correlation, flow, motion, head, .. } = config;
    json!({
        "net": "flow", "stem": stem, "stages": stages, "last_stride": last_stride, "features": features, "hidden": hidden,
        "context": context, "levels": levels, "radius": radius, "correlation": correlation, "flow": flow, "motion": motion,
        "head": head, "iterations": iterations
    })
}

fn encoder(config: &ResNetConfig) -> Value {
    json!({"images": config.images, "widths": config.widths, "blocks": config.blocks, "classifier": config.classifier})
}

//! D-HRNet: an encoder that keeps a high resolution, and a decoder that fuses all of them
//! (hmhemu/RA-Depth, `networks/hrnet_encoder.py` and `depth_decoder_msf.py`).

mod bottleneck;
mod config;
mod conv_norm;
mod decoder;
mod encoder;
mod module;
mod net;

pub use config::DHrNetConfig;
pub use net::DHrNet;

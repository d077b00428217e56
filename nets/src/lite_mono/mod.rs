//! Lite-Mono: convolutions with growing dilation and attention across channels, in one light depth network
//! (noahzn/Lite-Mono, `networks/depth_encoder.py` and `depth_decoder.py`).
//!
//! The reference moves channels to the last axis for its linear layers and back for its convolutions. Here maps stay as they
//! are: a linear layer over channels is a 1x1 convolution, and the channels of a map are its attention heads one after another.

mod cdc_block;
mod config;
mod decoder;
mod encoder;
mod lgfi_block;
mod net;
mod pointwise;
mod positional_code;

pub use config::LiteMonoConfig;
pub use net::LiteMono;

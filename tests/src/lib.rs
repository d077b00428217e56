//! Reference numbers with their origin.
//!
//! The numbers lie under `golden/`; the README of each folder says how they were made and who reads them:
//!
//! - `losses`: tensors and gradients of sampling, pose, masks and losses, read by `autodiff`, `geometry` and `train`;
//! - `networks`: activations and gradients of the nano networks, read by `nets`;
//! - `evaluation`: depth and trajectory metrics, read by `train`.
//!
//! They are kept outside those crates because several of them read the same folder.

//! Parity of the networks with the reference: same parameters, same inputs, same numbers.

mod compare;
mod depth;
mod flow;
mod pose;
mod store;
mod tensors;

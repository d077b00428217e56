//! Proofs of gradients: every operation against two oracles, and planted faults that the oracles must notice.
//!
//! An operation carries a [`Proof`] in its own file: cases (inputs and attributes) and a [`Twin`], the same function once on the
//! tape and once as a plain loop over [`Number`]s. The loop shares no code with the operation. Run with `f64` it gives the
//! value, run with [`Dual`] the derivative along a direction (the forward mode), which the tape must transpose:
//!
//! | compared | with | bound |
//! |---|---|---|
//! | value | the loop in `f64` | 1e-12 |
//! | gradient, every entry `i` | `<J eᵢ, w>` from the loop in [`Dual`], several `w` | 1e-12 |
//! | `<v, J' w>` | `<J v, w>` with dense random `v` | 1e-12 |
//! | gradient, every entry | central differences, [`gradcheck`](crate::gradcheck()) | its defaults |
//! | value and gradient in `f32` | the same in `f64` at the same inputs | [`Proof::single_bound`] |
//!
//! Errors are relative to the scale of the terms that were summed, see [`Errors`].
//!
//! [`Proof::hidden_nan`] asks further whether what is not a number shows in all that depends on it, [`Proof::bits`] for the bits
//! of everything, to be compared between threads.
//!
//! [`mutations`] then spoils each backward rule in five ways ([`Fault`]) and counts what is caught.
//!
//! ```
//! let proof = dimode_autodiff::proof::all().into_iter().find(|p| p.op() == "abs").unwrap();
//! proof.check().assert_ok();
//! ```

mod case;
mod check;
mod draw;
mod dual;
mod fault;
mod hidden;
mod reference;

pub use case::{Case, Proof, Twin};
pub use check::{Errors, Report, TOLERANCE};
pub use draw::{Draw, shapes, some_axes};
pub use dual::{Dual, Number, total};
pub(crate) use fault::Planted;
pub use fault::{Fault, Mutation, mutations};
pub use reference::{Plain, indices, with};

/// The proofs of all operations of this crate, in the order of the index.
pub fn all() -> Vec<Proof> {
    crate::ops::proofs()
}

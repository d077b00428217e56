//! The ledger: every equation and claim of the method sections of the paper, each with a verdict and a check.
//!
//! A [`Claim`] lies in a file of its own under `claims/`. Its check draws inputs, compares, and writes what it found into
//! [`Findings`]: *residuals*, which must stay below a tolerance, and *gaps*, which must not vanish. A claim that fails as printed
//! has both: the printed form misses by at least so much, and the corrected form holds. Should the printed form ever hold,
//! its gap closes and the verdict is contradicted.
//!
//! Three ways lead to every derivative: the closed form, forward mode over [`forward`] (a second implementation that shares
//! no code with the first), and the tape; central differences are the fourth.
//!
//! ```
//! use dimode_geometry::ledger::{self, Settings};
//! let claim = ledger::find("L15").unwrap();
//! let outcome = claim.verify(&Settings { samples: 50, ..Settings::default() });
//! assert!(outcome.ok && outcome.samples >= 50);
//! ```

mod claim;
mod claims;
mod equations;
pub mod estimates;
mod findings;
mod flow_derivatives;
pub mod forward;
mod loss_slopes;
mod responses;
mod sampling;
pub mod taped;
#[cfg(test)]
pub(crate) mod testing;
mod trial;

pub use claim::{Claim, Outcome, Settings, Verdict, find, verify};
pub use claims::all;
pub use equations::{EQUATIONS, Equation};
pub use findings::{Agreement, Finding, Findings, Kind};
pub use sampling::{Case, DIMENSIONS, Draw, EXTRA};
pub use trial::Trial;

//! `dimode verify`.

use std::path::PathBuf;

use clap::Args;
use dimode_geometry::ledger::Settings;

use super::failure::Exit;
use super::options::refuse_unless;
use super::{output, summary};
use crate::progress::Bar;
use crate::report::ledger::{Verification, document, recorded};
use crate::run::verify::{self, PAGE, VerifyRequest};

const LONG_ABOUT: &str = "\
Check every equation and claim of the paper, and print a table with a verdict for each.

A claim has a verdict: exact, conditional (true under a stated condition), first order, fails (not true as printed; a \
correction is given) or measured. Its check compares on random cameras, pixels, depths and motions: residuals must vanish up to \
rounding, and where a statement does not hold it must miss by as much as is known. Derivatives are compared between closed form, \
forward mode, the tape that training uses, and central differences.

The code is 1 when a verdict does not stand. The same seed prints the same bytes, with any number of threads.";

const EXAMPLES: &str = "\
Examples:
  dimode verify                        all claims
  dimode verify --id L28,L41           two claims in full: place, derivation, correction, every comparison
  dimode verify --samples 20000 --seed 7
  dimode verify --json > ledger.json
  dimode verify --plots pictures       flow fields, decompositions and loss landscapes: pictures/index.html
  dimode verify --poses poses/*.txt    claim L33 on motions of your own";

/// Flags of `dimode verify`.
#[derive(Debug, Args)]
#[command(about = summary(LONG_ABOUT), long_about = LONG_ABOUT, after_help = EXAMPLES)]
pub struct VerifyArgs {
    /// Claims to check and to print in full: L28, 28 or a short name; with commas, or repeated [default: all, as a table]
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    id: Vec<String>,
    /// Random cases of each claim that samples
    #[arg(long, value_name = "N", default_value_t = Settings::default().samples)]
    samples: usize,
    /// Seed of the random cases
    #[arg(long, value_name = "N", default_value_t = Settings::default().seed)]
    seed: u64,
    /// Folder for pictures, with a page that shows them; must be new or empty
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Print everything that was found as JSON
    #[arg(long)]
    json: bool,
    /// Instead of the claims: what the printed alignment costs on recorded motions (claim L33), from pose files in KITTI form
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["id", "samples", "seed", "plots"])]
    poses: Vec<PathBuf>,
    /// Print docs/verification.md: all claims and what is compared, without numbers of this run
    #[arg(long, conflicts_with_all = ["id", "samples", "seed", "plots", "json", "poses"])]
    markdown: bool,
}

impl VerifyArgs {
    /// Checks and prints.
    pub fn run(self) -> anyhow::Result<Exit> {
        if self.markdown {
            let found = verify::all(&Bar::new());
            output::text(&document(&found))?;
            return exit(&found);
        }
        if !self.poses.is_empty() {
            let found = verify::recorded(&self.poses)?;
            if self.json {
                output::json(&found)?
            } else {
                output::text(&recorded(&found))?
            }
            return Ok(Exit::Done);
        }
        let advice = "a check needs at least one case";
        refuse_unless(self.samples > 0, || format!("--samples {}", self.samples), advice)?;
        let claims = verify::choose(&self.id)?;
        let settings = Settings { samples: self.samples, seed: self.seed };
        let found = verify::verify(&VerifyRequest { claims, settings, plots: self.plots.clone() }, &Bar::new())?;
        self.print(&found)?;
        exit(&found)
    }

    fn print(&self, found: &Verification) -> anyhow::Result<()> {
        if self.json {
            return output::json(&found.to_json());
        }
        let text = if self.id.is_empty() { found.tables() } else { found.entries() };
        output::text(&text)?;
        if let Some(folder) = &self.plots {
            output::text(&format!("pictures   {}", folder.join(PAGE).display()))?;
        }
        Ok(())
    }
}

/// A contradicted verdict is a failure.
fn exit(found: &Verification) -> anyhow::Result<Exit> {
    verify::stands(found)?;
    Ok(Exit::Done)
}

#[cfg(test)]
mod tests {
    use super::super::failure::tell;
    use super::*;
    use crate::report::ledger::tests::{contradicted, verification};

    #[test]
    fn verdicts_decide_the_exit_code() {
        assert_eq!(exit(&verification(&["L15"])).unwrap(), Exit::Done);
        let error = exit(&contradicted()).unwrap_err();
        assert_eq!(error.to_string(), "the ledger is contradicted in L99; the numbers are above");
        assert_eq!(tell(&error), Exit::Failed);
    }
}

//! Checking the claims of the paper.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Result;
use dimode_geometry::ledger::{self, Claim, Settings};
use dimode_geometry::motion_statistics::{MotionStatistics, StatisticsOptions, motion_statistics};
use dimode_geometry::{Trajectory, scenes};
use thiserror::Error;

use crate::config::nearest;
use crate::data::staging::{Earlier, Staging};
use crate::data::write_atomic;
use crate::progress::Progress;
use crate::report::figures;
use crate::report::ledger::{Judged, Verification};

/// Which claims to check and how.
#[derive(Clone, Debug)]
pub struct VerifyRequest {
    /// The claims: see [`choose`].
    pub claims: Vec<Claim>,
    /// Samples and seed.
    pub settings: Settings,
    /// Folder to write pictures to; must not exist, or be empty.
    pub plots: Option<PathBuf>,
}

/// A name that no claim has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("no claim is named '{name}'; {}", advice(.nearest))]
pub struct UnknownClaim {
    /// The name.
    pub name: String,
    /// What it may have been meant to be, the likeliest first.
    pub nearest: Vec<String>,
}

fn advice(nearest: &[String]) -> String {
    match nearest {
        [] => "write an id such as L15, or a short name such as rad-flow".to_owned(),
        some => format!("the nearest: {}", some.join(", ")),
    }
}

/// The verdict of a claim does not stand.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("the ledger is contradicted in {}; the numbers are above", .ids.join(", "))]
pub struct Contradicted {
    /// The claims.
    pub ids: Vec<&'static str>,
}

/// Claims by id (`L28`, `28`) or short name, each once, by number; all of them without any name.
///
/// **Errors** [`UnknownClaim`].
pub fn choose(names: &[String]) -> Result<Vec<Claim>, UnknownClaim> {
    let find = |name: &String| ledger::find(name.trim()).ok_or_else(|| unknown(name.trim()));
    let mut chosen: Vec<Claim> = names.iter().map(|name| find(name).copied()).collect::<Result<_, _>>()?;
    if names.is_empty() {
        chosen = ledger::all().iter().map(|claim| **claim).collect();
    }
    chosen.sort_by_key(|claim| claim.id);
    chosen.dedup_by_key(|claim| claim.id);
    Ok(chosen)
}

/// Most names that are offered for one that does not exist.
const OFFERS: usize = 3;

fn unknown(name: &str) -> UnknownClaim {
    let number = |id: &str| id.trim_start_matches(['L', 'l']).parse::<i64>().ok();
    let mut near: Vec<&Claim> = Vec::new();
    if let Some(wanted) = number(name) {
        near = ledger::all().to_vec();
        near.sort_by_key(|claim| number(claim.id).map_or(i64::MAX, |n| n.saturating_sub(wanted).saturating_abs()));
    } else {
        near.extend(ledger::all().iter().filter(|claim| name.len() > 2 && claim.slug.contains(name)));
        while near.len() < OFFERS {
            let others = ledger::all().iter().filter(|claim| near.iter().all(|known| known.id != claim.id));
            let Some(slug) = nearest(name, others.map(|claim| claim.slug)) else { break };
            near.extend(ledger::find(slug));
        }
    }
    let offer = |claim: &&Claim| format!("{} {}", claim.id, claim.slug);
    UnknownClaim { name: name.to_owned(), nearest: near.iter().take(OFFERS).map(offer).collect() }
}

/// Checks the claims, at the same time where threads are free, and draws the pictures that are asked for. The result does not
/// depend on the number of threads; how long it took is told to `progress`.
///
/// **Errors** [`crate::data::DataError`] for a folder that is occupied or cannot be written, before anything is checked;
/// contradicted verdicts are no errors here: see [`stands`].
pub fn verify(request: &VerifyRequest, progress: &dyn Progress) -> Result<Verification> {
    let staging = request.plots.as_deref().map(|folder| Staging::new(folder, Earlier::Keep)).transpose()?;
    if let Some(staging) = staging {
        staging.fill(|folder| -> Result<()> {
            let figures = figures::all();
            for figure in &figures {
                write_atomic(&folder.join(format!("{}.svg", figure.name)), figure.svg.as_bytes())?;
            }
            write_atomic(&folder.join(PAGE), figures::page(&figures)?.as_bytes())?;
            Ok(())
        })?;
    }
    Ok(check(&request.claims, request.settings, progress))
}

/// The page that shows all pictures.
pub const PAGE: &str = "index.html";

/// Statistics of recorded motions (claim L33): the files hold poses in KITTI form, each a trajectory; losses are taken over the
/// reference road's grid of a 640x192 camera.
///
/// **Errors** [`dimode_geometry::GeometryError`] for a file that cannot be read, and when nothing moves.
pub fn recorded(files: &[PathBuf]) -> Result<MotionStatistics> {
    let trajectories: Vec<_> = files.iter().map(|file| Trajectory::read_kitti(file)).collect::<Result<_, _>>()?;
    let scene = scenes::road();
    Ok(motion_statistics(&trajectories, &scene.camera, &scene.offsets(), &StatisticsOptions::default())?)
}

/// All claims with default settings.
pub fn all(progress: &dyn Progress) -> Verification {
    let claims: Vec<Claim> = ledger::all().iter().map(|claim| **claim).collect();
    check(&claims, Settings::default(), progress)
}

fn check(claims: &[Claim], settings: Settings, progress: &dyn Progress) -> Verification {
    let (begin, done) = (Instant::now(), AtomicU64::new(0));
    progress.start(claims.len() as u64, "claims");
    let found = dimode_autodiff::par::map_indices(claims.len(), |i| {
        let (claim, begin) = (claims[i], Instant::now());
        let outcome = claim.verify(&settings);
        progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, claim.slug);
        (Judged { claim, outcome }, begin.elapsed())
    });
    progress.finish();
    let (judged, times): (Vec<Judged>, Vec<Duration>) = found.into_iter().unzip();
    progress.note(&duration_of(&judged, &times, begin.elapsed()));
    Verification { settings, judged }
}

/// How long it took, and which claims took longest.
fn duration_of(judged: &[Judged], times: &[Duration], whole: Duration) -> String {
    let mut longest: Vec<(&Judged, &Duration)> = judged.iter().zip(times).collect();
    longest.sort_by(|a, b| b.1.cmp(a.1));
    let told = longest.iter().take(3).map(|(j, time)| format!("{} {:.2} s", j.claim.id, time.as_secs_f64()));
    format!("checked in {:.1} s; longest: {}", whole.as_secs_f64(), told.collect::<Vec<_>>().join(", "))
}

/// Whether all verdicts stand.
///
/// **Errors** [`Contradicted`].
pub fn stands(found: &Verification) -> Result<(), Contradicted> {
    let ids: Vec<&'static str> = found.contradicted().iter().map(|judged| judged.claim.id).collect();
    if ids.is_empty() { Ok(()) } else { Err(Contradicted { ids }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::{Recorder, Silent};
    use crate::report::ledger::tests::false_claim;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    fn ids(chosen: &[Claim]) -> Vec<&str> {
        chosen.iter().map(|claim| claim.id).collect()
    }

    #[test]
    fn claims_are_found_by_id_number_and_name() {
        let chosen = choose(&names(&["rad-flow", "9", "L01", "l15"])).unwrap();
        assert_eq!(ids(&chosen), ["L01", "L09", "L15"]);
        assert_eq!(choose(&[]).unwrap().len(), ledger::all().len());
    }

    #[test]
    fn the_nearest_names_are_told() {
        let nearest = |name: &str| choose(&names(&[name])).unwrap_err().nearest;
        assert_eq!(nearest("rad-flo")[0], "L15 rad-flow");
        assert_eq!(nearest("inline")[0], "L09 rot-flow-inline");
        assert_eq!(nearest("99").len(), 3);
        let message = choose(&names(&["zzzzzzzzzz"])).unwrap_err().to_string();
        assert!(message.contains("no claim is named 'zzzzzzzzzz'; "), "{message}");
    }

    #[test]
    fn a_false_claim_contradicts_the_ledger() {
        let settings = Settings { samples: 10, seed: 1 };
        let claims = [choose(&names(&["L15"])).unwrap(), vec![false_claim()]].concat();
        let request = VerifyRequest { claims, settings, plots: None };
        let recorder = Recorder::default();
        let found = verify(&request, &recorder).unwrap();
        assert_eq!(stands(&found), Err(Contradicted { ids: vec!["L99"] }));
        assert!(recorder.lines().iter().any(|line| line.contains("checked in")));
        let claims = choose(&names(&["L15"])).unwrap();
        assert_eq!(stands(&verify(&VerifyRequest { claims, ..request }, &Silent).unwrap()), Ok(()));
    }
}

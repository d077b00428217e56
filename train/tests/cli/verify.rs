use std::fs;

use crate::{dimode, text};

/// Some claims with few samples.
const FEW: [&str; 5] = ["verify", "--id", "L01,L09,L15,L20", "--samples", "50"];

fn few(more: &[&str]) -> crate::Ran {
    dimode(&[&FEW[..], more].concat())
}

#[test]
fn the_table_has_a_row_for_every_claim_and_a_last_line() {
    let ran = dimode(&["verify", "--samples", "8"]);
    assert!(ran.err.contains("checked in"), "{}", ran.err);
    for word in ["Claims of the paper", "L01", "text after eq.", "df/dt_z", "tolerance", "misses by", "forward mode"] {
        assert!(ran.out.contains(word), "'{word}' is not in {}", ran.out);
    }
    let last = ran.out.lines().last().unwrap();
    assert!(last.contains("verdicts stand (") && last.ends_with("samples, seed 1)"), "{last}");
}

#[test]
fn one_claim_is_told_in_full_by_any_of_its_names() {
    let by = |name| dimode(&["verify", "--id", name, "--samples", "50"]).succeeded();
    let told = by("L15");
    for part in
        ["L15 rad-flow", "eqs. radial_correspondence", "verdict          exact", "derivation", "flow - full projection, px"]
    {
        assert!(told.contains(part), "'{part}' is not in {told}");
    }
    assert!(told.contains("flow::radial::radial_flow (geometry/src/flow/radial.rs)"), "{told}");
    assert!(told.trim_end().lines().last().unwrap().starts_with("1 of 1 verdict stands (1 exact; "), "{told}");
    assert_eq!(told, by("15"));
    assert_eq!(told, by("rad-flow"));
    let both = dimode(&["verify", "--id", "L20", "--id", "L09", "--samples", "50"]).succeeded();
    assert!(both.find("L09 rot-flow-inline").unwrap() < both.find("L20 grad-tz").unwrap(), "{both}");
}

#[test]
fn names_that_no_claim_has_and_no_samples_are_refused() {
    let unknown = |name| dimode(&["verify", "--id", name]);
    unknown("rad-flw").refused(2, &["no claim is named 'rad-flw'", "fix: the nearest: L15 rad-flow"]);
    unknown("L999").refused(2, &["no claim is named 'L999'", "fix: the nearest: L"]);
    unknown("").refused(2, &["no claim is named ''"]);
    dimode(&["verify", "--samples", "0"]).refused(2, &["--samples 0", "fix: a check needs at least one case"]);
}

#[test]
fn the_numbers_are_there_as_json() {
    let found: serde_json::Value = serde_json::from_str(&few(&["--json"]).succeeded()).unwrap();
    assert_eq!((found["settings"]["samples"].as_u64(), found["settings"]["seed"].as_u64()), (Some(50), Some(1)));
    assert_eq!((found["summary"]["ok"].as_bool(), found["summary"]["stand"].as_u64()), (Some(true), Some(4)));
    let claims = found["claims"].as_array().unwrap();
    let ids: Vec<_> = claims.iter().map(|claim| claim["id"].as_str().unwrap()).collect();
    assert_eq!(ids, ["L01", "L09", "L15", "L20"]);
    for claim in claims {
        assert!(claim["samples"].as_u64().unwrap() >= 50 && claim["ok"].as_bool().unwrap());
        let compared = claim["findings"].as_array().unwrap().len() + claim["derivatives"].as_array().unwrap().len();
        assert!(compared > 0, "{claim}");
    }
    let derivative = &claims[3]["derivatives"][0];
    for way in ["forward", "tape", "central"] {
        assert!(derivative[way].as_f64().unwrap() < 1e-6, "{derivative}");
    }
    assert!(claims[1]["correction"].is_string() && claims[2]["correction"].is_null());
}

#[test]
fn the_same_seed_prints_the_same_bytes_with_any_number_of_threads() {
    let one = few(&["--json", "--threads", "1"]).succeeded();
    assert_eq!(one, few(&["--json", "--threads", "2"]).succeeded());
    assert_ne!(one, few(&["--json", "--seed", "2"]).succeeded());
    assert_eq!(few(&["--threads", "1"]).succeeded(), few(&["--threads", "2"]).succeeded());
}

#[test]
fn pictures_are_written_to_a_free_folder() {
    let place = tempfile::tempdir().unwrap();
    let folders = ["a", "b"].map(|name| place.path().join(name));
    for (folder, threads) in folders.iter().zip(["1", "2"]) {
        let told = few(&["--plots", text(folder), "--threads", threads]).succeeded();
        assert!(told.contains(&format!("pictures   {}", folder.join("index.html").display())), "{told}");
    }
    let [a, b] = &folders;
    let mut pictures = 0;
    for entry in fs::read_dir(a).unwrap() {
        let name = entry.unwrap().file_name();
        assert_eq!(fs::read(a.join(&name)).unwrap(), fs::read(b.join(&name)).unwrap(), "{name:?}");
        pictures += usize::from(name.to_str().unwrap().ends_with(".svg"));
    }
    assert!(pictures >= 6, "{pictures}");
    let page = fs::read_to_string(a.join("index.html")).unwrap();
    assert_eq!(page.matches("<svg xmlns=").count(), pictures);
    few(&["--plots", text(a)]).refused(2, &["already there", "fix: name a folder that is new or empty"]);
}

#[test]
fn a_document_has_no_choices() {
    for flag in [&["--json"][..], &["--id", "L15"], &["--samples", "9"], &["--plots", "x"]] {
        let ran = dimode(&[&["verify", "--markdown"], flag].concat());
        assert_eq!((ran.code, ran.out.as_str()), (2, ""), "{}", ran.err);
        assert!(ran.err.contains("cannot be used with"), "{}", ran.err);
    }
}

#[test]
fn recorded_motions_are_measured() {
    let place = tempfile::tempdir().unwrap();
    let (straight, still) = (place.path().join("straight.txt"), place.path().join("still.txt"));
    let pose = |z: f64| format!("1 0 0 0.02 0 1 0 0 0 0 1 {z}\n");
    fs::write(&straight, (0..5).map(|i| pose(f64::from(i))).collect::<String>()).unwrap();
    fs::write(&still, pose(0.0).repeat(5)).unwrap();
    let told = dimode(&["verify", "--poses", text(&straight)]).succeeded();
    assert!(told.contains("pairs that move more than 0.1: 8; of them turn more than 1 deg: 0"), "{told}");
    assert!(told.contains("100.0 % of 3"), "{told}");
    let found: serde_json::Value =
        serde_json::from_str(&dimode(&["verify", "--json", "--poses", text(&straight), text(&straight)]).succeeded()).unwrap();
    assert_eq!((found["pairs"].as_u64(), found["triplets"].as_u64()), (Some(16), Some(6)));
    assert_eq!(found["axial_loss"]["max"].as_f64(), Some(0.0), "{found}");
    dimode(&["verify", "--poses", text(&still)]).refused(1, &["no two neighbouring frames are more than 0.1 apart"]);
    dimode(&["verify", "--poses", text(&place.path().join("none.txt"))]).refused(1, &["none.txt"]);
}

//! The library trains without the command line: one call checks, makes the folder, trains, evaluates and reports.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use dimode::checkpoint::{Checkpoint, hash};
use dimode::config::{Config, FirstWeights, LossPreset, PseudoDepth, Rectify};
use dimode::progress::Silent;
use dimode::run::train::train;
use dimode::run::{RunFolder, Start, TrainOutcome, TrainRequest};

fn request(out: &Path) -> TrainRequest {
    let mut config = Config::quick();
    (config.data.width, config.data.height, config.data.worlds) = (64, 64, 2);
    (config.train.steps, config.train.batch) = (2, 1);
    (config.eval.worlds, config.eval.frames) = (1, 3);
    config.nets.flow_weights = FirstWeights::Random;
    TrainRequest { config, out: out.to_owned(), start: Start::New, command: "dimode train".to_owned() }
}

fn run(request: &TrainRequest) -> anyhow::Result<TrainOutcome> {
    train(request, &Silent, &AtomicBool::new(false))
}

#[test]
fn two_steps_through_the_library_call_alone() {
    let place = tempfile::tempdir().unwrap();
    let request = request(&place.path().join("runs/tiny"));
    let TrainOutcome::Finished { report, checkpoint_hash, .. } = run(&request).unwrap() else { panic!("nobody stops it") };
    let folder = RunFolder::open(&request.out).unwrap();
    assert!(report.is_file() && folder.is_finished());
    assert_eq!(folder.read_config().unwrap(), request.config);
    assert_eq!(folder.command().unwrap(), "dimode train");
    assert_eq!(Checkpoint::read(&folder.checkpoint()).unwrap().state["step"], 2);

    assert!(run(&request).unwrap_err().to_string().contains("a finished run is already there"));
    run(&TrainRequest { start: Start::Replace, ..request.clone() }).unwrap();
    assert_eq!(hash(&folder.checkpoint()).unwrap(), checkpoint_hash);
    run(&TrainRequest::resume(&request.out).unwrap()).unwrap();
    assert_eq!(hash(&folder.checkpoint()).unwrap(), checkpoint_hash);
}

/// What each step depends on is in the checkpoint, whatever the method.
#[test]
fn a_run_of_any_method_goes_on_with_the_same_bits() {
    let place = tempfile::tempdir().unwrap();
    for preset in LossPreset::ALL {
        let mut request = request(&place.path().join(format!("{preset}")));
        preset.apply(&mut request.config);
        let stages = &mut request.config.train.stages;
        stages.iter_mut().for_each(|stage| (stage.share, stage.lambda3) = (1.0, 0.01));
        request.config.train.steps = 2 * stages.len() as u64;
        request.config.loss.local_structure.pseudo_depth = PseudoDepth::Rendered;
        if preset == LossPreset::ScDepth {
            request.config.nets.rectify = Rectify::Nano;
        }
        let TrainOutcome::Finished { checkpoint_hash, .. } = run(&request).unwrap() else { panic!("nobody stops it") };
        let again = TrainRequest { out: place.path().join(format!("{preset}-again")), ..request };
        let mut outcome = train(&again, &Silent, &AtomicBool::new(true)).unwrap();
        let mut interruptions = 0;
        while let TrainOutcome::Interrupted { .. } = outcome {
            interruptions += 1;
            let stop = AtomicBool::new(interruptions < 2);
            outcome = train(&TrainRequest::resume(&again.out).unwrap(), &Silent, &stop).unwrap();
        }
        assert!(interruptions > 0, "{preset}");
        let folder = RunFolder::open(&again.out).unwrap();
        assert_eq!(hash(&folder.checkpoint()).unwrap(), checkpoint_hash, "{preset}");
    }
}

#[test]
fn settings_out_of_range_leave_no_folder() {
    let place = tempfile::tempdir().unwrap();
    let mut request = request(&place.path().join("run"));
    request.config.eval.frames = 6000;
    assert!(run(&request).unwrap_err().to_string().starts_with("eval.frames = 6000"));
    assert!(!request.out.exists());
}

/// A folder in the place of the log stops the run after its configuration is written.
#[test]
fn a_run_that_cannot_write_its_first_files_leaves_none() {
    let place = tempfile::tempdir().unwrap();
    let request = request(&place.path().join("run"));
    for start in [Start::New, Start::Replace] {
        let folder = RunFolder::create(&request.out, &request.config, &request.command, false).unwrap();
        std::fs::create_dir(folder.log()).unwrap();
        let message = run(&TrainRequest { start, ..request.clone() }).unwrap_err().to_string();
        assert!(message.contains("log.jsonl: cannot be written"), "{message}");
        assert!(!folder.config().exists() && !folder.checkpoint().exists());
        std::fs::remove_dir_all(&request.out).unwrap();
    }
}

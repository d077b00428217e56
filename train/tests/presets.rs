//! Every method's loss and every choice of its terms trains: steps of each stage on rendered worlds, nothing that is not finite.

use dimode::batch::Batch;
use dimode::config::{Config, LossPreset, Preset, PseudoDepth};
use dimode::data::Dataset;
use dimode::model::{Model, Weights};
use dimode::objective::TermGradients;
use dimode::optim::adamw::State;
use dimode::run::first_weights::load_first_weights;
use dimode::run::trained::weight_tensors;
use dimode::run::training_frames;
use dimode::sampler::Sampler;
use dimode::schedule::Schedule;
use dimode::teacher::Teacher;
use dimode::trainer::{StepReport, Trainer};
use dimode_autodiff::par;

/// Steps of each stage.
const STEPS: u64 = 3;

/// A small run of a method.
fn small(preset: LossPreset, world: Preset, seed: u64) -> Config {
    let mut config = preset.config();
    config.seed = seed;
    (config.data.preset, config.data.worlds, config.data.frames) = (world, 3, 4);
    (config.data.width, config.data.height) = (64, 64);
    (config.train.batch, config.nets.flow_iterations) = (2, 2);
    as_long_as_its_stages(config)
}

fn as_long_as_its_stages(mut config: Config) -> Config {
    config.train.stages.iter_mut().for_each(|stage| stage.share = 1.0);
    config.train.steps = STEPS * config.train.stages.len() as u64;
    config
}

fn with(mut config: Config, settings: &[&str]) -> Config {
    for setting in settings {
        config = config.with_setting(setting).unwrap();
    }
    config.validate().unwrap();
    as_long_as_its_stages(config)
}

struct Run {
    reports: Vec<StepReport>,
    before: Weights,
    after: Weights,
}

fn run(config: &Config) -> Run {
    let frames: Box<dyn Dataset> = training_frames(config).unwrap();
    let lengths = (0..frames.sequence_count()).map(|s| frames.sequence_len(s)).collect();
    let mut sampler = Sampler::new(lengths, config.seed, config.train.batch);
    let mut before = Model::new(&config.nets).init(config.seed);
    load_first_weights(&config.nets, &mut before).unwrap();
    let mut trainer = Trainer::new(config, before.clone(), State::default());
    let (schedule, teacher) = (Schedule::new(&config.train), Teacher::new(config));
    let mut step = |k: u64| {
        let items = sampler.batch(k as usize);
        let batch = Batch::load(frames.as_ref(), &items, (&config.train, &teacher), config.seed, k, trainer.pool()).unwrap();
        trainer.step(&batch, None, schedule.stage(k).1, k, config.train.learning_rate, true).unwrap()
    };
    let reports = (0..config.train.steps).map(&mut step).collect();
    Run { reports, before, after: trainer.into_networks().1 }
}

/// Names of the terms of the last step of each stage.
fn terms(run: &Run) -> Vec<Vec<&str>> {
    let last = run.reports.iter().skip(STEPS as usize - 1).step_by(STEPS as usize);
    last.map(|report| report.terms.iter().map(|term| term.name.as_str()).collect()).collect()
}

/// The term counted pixels and pulled at something, if not in every step; `rigid` pulls at the flow network alone.
fn counts(run: &Run, name: &str, what: &str) {
    let said: Vec<_> = run.reports.iter().flat_map(|report| &report.terms).filter(|term| term.name == name).collect();
    assert!(said.iter().any(|term| term.valid > 0.0 && term.value != 0.0), "{what}: {name} of {:?}", terms(run));
    let pulls = |g: &TermGradients| g.disparity + g.rotation + g.tangential + g.radial > 0.0;
    let measured: Vec<_> = said.iter().filter_map(|term| term.gradients.as_ref()).collect();
    assert!(measured.is_empty() || name == "rigid" || measured.into_iter().any(pulls), "{what}: {name} pulls at nothing");
}

/// Everything said is finite, adds up, and the networks that are trained have moved.
fn check(run: &Run, what: &str) {
    for (step, report) in run.reports.iter().enumerate() {
        let mut total = 0.0;
        for term in &report.terms {
            let context = || format!("{what}, step {step}, {term:?}");
            assert!(term.value.is_finite() && (0.0..=1.0).contains(&term.valid), "{}", context());
            assert!(term.images.iter().all(|image| image.value.is_finite()), "{}", context());
            total += term.weight * term.value;
            let own = ["l_flow", "l_flow_back", "l_rc", "l_rt"].contains(&term.name.as_str());
            let Some(g) = term.gradients else {
                assert!(own, "{}", context());
                continue;
            };
            assert!(
                [g.disparity, g.depth, g.rotation, g.tangential, g.radial].iter().all(|norm| norm.is_finite()),
                "{}",
                context()
            );
        }
        assert!((report.total - total).abs() <= 1e-9 * total.abs(), "{what}, step {step}: {} is not {total}", report.total);
        assert!(report.network_gradients.iter().flatten().all(|norm| norm.is_finite()), "{what}, step {step}");
    }
    for network in ["depth", "pose"] {
        assert!(moved(run, network), "{what}: the {network} network has not moved");
    }
    assert!(weight_tensors(&run.after).iter().all(|(_, _, values)| values.is_finite()), "{what}");
}

fn moved(run: &Run, network: &str) -> bool {
    let (before, after) = (weight_tensors(&run.before), weight_tensors(&run.after));
    before.iter().zip(&after).filter(|(tensor, _)| tensor.0.starts_with(network)).any(|(a, b)| a.2 != b.2)
}

#[test]
fn every_preset_trains_on_every_seed_and_world() {
    for preset in LossPreset::ALL {
        for (world, seed) in
            [Preset::Street, Preset::Handheld].into_iter().flat_map(|world| (0..5).map(move |seed| (world, seed)))
        {
            let run = run(&small(preset, world, seed));
            check(&run, &format!("{preset} on {world}, seed {seed}"));
            let base = ["l_pho", "smooth", "scale"];
            let later: Vec<Vec<&str>> = match preset {
                LossPreset::Dimode | LossPreset::DimodeLiteral => {
                    vec![vec!["l_flow"], vec!["l_pla", "l_axi"], vec!["l_pla", "l_axi", "l_tan", "l_rad"]]
                }
                LossPreset::Monodepth2 | LossPreset::ScDepth => vec![vec![]],
                LossPreset::DfNet => vec![vec!["l_flow"], vec!["cross_task"]],
                LossPreset::Dcpi => {
                    vec![vec!["l_flow"], vec!["contextual", "rigid"], vec!["contextual", "rigid", "divergence"]]
                }
            };
            let found = terms(&run);
            assert_eq!(found.len(), later.len(), "{preset}");
            for (found, later) in found.iter().zip(later) {
                let mut expected = base.to_vec();
                if preset == LossPreset::ScDepth {
                    expected.insert(1, "l_geo");
                }
                expected.extend(later);
                assert_eq!(*found, expected, "{preset}");
            }
        }
    }
}

/// One setting beside others, and the term that it is about.
struct Choice {
    preset: LossPreset,
    context: &'static [&'static str],
    setting: &'static str,
    term: &'static str,
}

/// Every setting of the loss that is a choice or turns a term on.
fn choices() -> Vec<Choice> {
    use LossPreset::{Dcpi, DfNet, Dimode, DimodeLiteral, Monodepth2, ScDepth};
    let rendered = &["loss.local_structure.pseudo_depth=rendered"];
    let back = &["loss.flow.forward_backward=0.2"];
    let few = &["loss.geometric.min_valid_share=0.01"];
    let choice = |preset, context, setting, term| Choice { preset, context, setting, term };
    vec![
        choice(ScDepth, &[], "loss.photometric=sc-sfm", "l_geo"),
        choice(ScDepth, &[], "nets.rectify=nano", "l_rt"),
        choice(Monodepth2, &[], "nets.rectify=nano", "l_rc"),
        choice(ScDepth, &["nets.rectify=nano"], "loss.rotation_triplet=0.5", "l_rt"),
        choice(ScDepth, &["nets.rectify=nano"], "loss.rotation_consistency=0.5", "l_rc"),
        choice(Monodepth2, &[], "loss.geometry_consistency=0.1", "l_geo"),
        choice(Monodepth2, &[], "loss.auto_mask=false", "l_pho"),
        choice(Monodepth2, &[], "loss.average_sources=true", "l_pho"),
        choice(Monodepth2, &[], "loss.photometric_weight=0.5", "l_pho"),
        choice(Monodepth2, &[], "loss.scales=2", "smooth"),
        choice(Monodepth2, &[], "loss.smoothness_of=depth", "smooth"),
        choice(Monodepth2, &[], "loss.scale_anchor=0.2", "scale"),
        choice(Monodepth2, &[], "loss.below_ground=0.1", "below_ground"),
        choice(Dimode, &[], "loss.flow_consistency=0.02", "flow_consistency"),
        choice(Dimode, &[], "loss.occlusion=forward-backward", "l_axi"),
        choice(Dimode, &[], "loss.occlusion=range-map", "l_rad"),
        choice(Dimode, &[], "loss.occlusion=soft-range-map", "l_axi"),
        choice(Dimode, few, "loss.occlusion=best-matches", "l_axi"),
        choice(Dimode, &[], "loss.geometric.static_mask=agreeing", "l_axi"),
        choice(Dimode, &[], "loss.geometric.static_mask=dynamo-grid", "l_tan"),
        choice(Dimode, &[], "loss.geometric.static_mask=mean", "l_tan"),
        choice(Dimode, &[], "loss.sources=next", "l_tan"),
        choice(Dimode, &[], "loss.geometric.detach_source_depth=false", "l_axi"),
        choice(DimodeLiteral, &[], "loss.geometric.axes=[true, false, true]", "l_tan"),
        choice(DimodeLiteral, &[], "loss.geometric.planar=robust", "l_pla"),
        choice(DimodeLiteral, &[], "loss.geometric.axial=folded", "l_axi"),
        choice(Dimode, &[], "loss.local_structure.pseudo_depth=self-guided", "l_loc_normals"),
        choice(Dimode, &[], "loss.local_structure.pseudo_depth=rendered", "l_loc_normals"),
        choice(Dimode, rendered, "loss.local_structure.degradation.noise=0.3", "l_loc_normals"),
        choice(Dimode, rendered, "loss.local_structure.relative_normal=0.5", "l_loc_angles"),
        choice(Dimode, rendered, "loss.local_structure.depth_ranking=0.5", "l_loc_ranking"),
        choice(ScDepth, rendered, "loss.local_structure.depth_ranking=0.5", "l_loc_ranking"),
        choice(Dimode, &[], "loss.flow.data=census-arflow", "l_flow"),
        choice(Dimode, &[], "loss.flow.data=census-smurf", "l_flow"),
        choice(Dimode, &[], "loss.flow.data=census-unflow", "l_flow"),
        choice(Dimode, &[], "loss.flow.data=photometric-arflow", "l_flow"),
        choice(Dimode, &[], "loss.flow.occlusion=forward-backward", "l_flow"),
        choice(Dimode, &[], "loss.flow.occlusion=range-map", "l_flow"),
        choice(Dimode, back, "loss.flow.occlusion=soft-range-map", "l_flow"),
        choice(Dimode, &[], "loss.flow.iterates=last", "l_flow"),
        choice(Dimode, &[], "loss.flow.weight=0.5", "l_flow"),
        choice(Dimode, &[], "loss.flow.smoothness_form=first", "l_flow"),
        choice(Dimode, &[], "loss.flow.smoothness_form=second-wide", "l_flow"),
        choice(Dimode, &[], "loss.flow.smoothness_form=length", "l_flow"),
        choice(Dimode, &[], "loss.flow.forward_backward=0.2", "l_flow_back"),
        choice(DfNet, &[], "train.stages.2.train_flow=true", "l_flow"),
        choice(DfNet, &[], "loss.scales=1", "cross_task"),
        choice(Dcpi, &[], "loss.contextual_depth=triangulated", "contextual"),
        choice(Dcpi, &[], "loss.sources=both", "contextual"),
        choice(Dcpi, &[], "train.stages.2.train_flow=true", "rigid"),
        choice(Dimode, &[], "train.stages.3.cross_task=0.001", "cross_task"),
        choice(Dimode, &[], "train.stages.3.contextual=0.01", "contextual"),
        choice(Dimode, &[], "train.stages.3.divergence=0.01", "divergence"),
    ]
}

#[test]
fn every_choice_of_every_term_trains_and_changes_what_is_measured() {
    for Choice { preset, context, setting, term } in choices() {
        let without = with(small(preset, Preset::Street, 1), context);
        let what = format!("{preset} with {context:?} and {setting}");
        let [before, after] = [without.clone(), with(without, &[setting])].map(|config| run(&config));
        check(&after, &what);
        counts(&after, term, &what);
        assert_ne!(before.reports, after.reports, "{what} measures the same as without it");
    }
}

#[test]
fn every_preset_gives_the_same_bits_on_any_number_of_threads() {
    for preset in LossPreset::ALL {
        let mut config = small(preset, Preset::Handheld, 2);
        config.train.stages.iter_mut().for_each(|stage| stage.lambda3 = 0.1);
        config.loss.local_structure.pseudo_depth = PseudoDepth::Rendered;
        let [one, three] = [1, 3].map(|threads| par::with_threads(threads, || run(&config)));
        assert_eq!(one.reports, three.reports, "{preset}");
        for (a, b) in weight_tensors(&one.after).iter().zip(weight_tensors(&three.after)) {
            assert_eq!(a.2, b.2, "{preset}: {}", a.0);
        }
    }
}

#[test]
fn the_flow_network_learns_from_the_terms_that_reach_it_and_only_where_it_is_trained() {
    for trained in [true, false] {
        let mut config = small(LossPreset::DfNet, Preset::Street, 3);
        // Depth and pose stand still, so that nothing but the flow can make the term fall.
        config.train.stages.remove(0);
        config.train.stages[0].train_depth = false;
        config.train.stages[0].train_flow = trained;
        (config.train.pose_rate, config.loss.flow.rate, config.train.learning_rate) = (1e-12, 0.2, 0.01);
        (config.train.steps, config.data.worlds, config.train.flip, config.train.jitter) = (24, 1, false, false);
        let run = run(&config);
        let value = |k: usize| run.reports[k].terms.iter().find(|term| term.name == "cross_task").unwrap().value;
        let (first, last) = ((value(0) + value(1)) / 2.0, (value(22) + value(23)) / 2.0);
        assert_eq!(last < 0.9 * first, trained, "{first} to {last}");
        assert_eq!(moved(&run, "flow"), trained);
    }
}

//! The page is complete, safe and needs nothing from outside.

use dimode_geometry::{Se3, Trajectory};
use nalgebra::Vector3;

use super::super::{Curve, StageMark, write_report};
use super::*;
use crate::data::{Image, Map};
use crate::eval::{
    Alignment, DepthProtocol, DepthTableBuilder, MeanMotion, MotionTableBuilder, OdometryProtocol, TrivialDepth, align_trajectory,
};

fn steps(turn: f64, speed: f64) -> Vec<Se3> {
    (0..40)
        .map(|i| {
            let w = Vector3::new(0.0, turn * (0.2 * f64::from(i)).sin(), 0.0);
            Se3::from_rotation_vector(&w, Vector3::new(0.05, 0.0, -speed))
        })
        .collect()
}

fn evaluation() -> Evaluation {
    let map = |factor: f32| Map { height: 6, width: 8, data: (0..48).map(|i| 2.0 + factor * i as f32).collect() };
    let trivial = vec![TrivialDepth::Constant(1.0)];
    let mut depth = DepthTableBuilder::new("dimode", DepthProtocol::default(), trivial).unwrap();
    depth.add(&map(0.3), &map(0.31), None).unwrap();
    let truth = steps(0.05, 0.5);
    let mean = MeanMotion::fit(&truth).unwrap();
    let mut motion = MotionTableBuilder::new("dimode", OdometryProtocol::small_world(), Some(mean));
    for name in ["a", "b"] {
        motion.add_sequence(name, &steps(0.04, 0.1), &Trajectory::accumulate(&truth)).unwrap();
    }
    Evaluation {
        title: "demo".into(),
        data: "held-out <worlds>".into(),
        depth: Some(depth.finish().unwrap()),
        motion: Some(motion.finish().unwrap()),
        notes: Vec::new(),
    }
}

fn sample_picture() -> SamplePicture {
    let flow = FlowMap { height: 6, width: 8, u: vec![1.5; 48], v: vec![-0.5; 48] };
    let depth = Map { height: 6, width: 8, data: (0..48).map(|i| 1.0 + i as f32).collect() };
    SamplePicture {
        caption: "frame <7>".into(),
        image: Image { channels: 3, height: 6, width: 8, data: vec![0.4; 144] },
        predicted_depth: depth.clone(),
        true_depth: Some(depth),
        optical_flow: Some(flow.clone()),
        rigid_flow: Some(flow),
    }
}

fn input() -> ReportInput {
    let curve = |name: &str, group| Curve {
        name: name.into(),
        group,
        points: (0..80).map(|i| [f64::from(i), 1.0 / (1.0 + f64::from(i))]).collect(),
    };
    let truth = Trajectory::accumulate(&steps(0.05, 0.5));
    let both = align_trajectory(&Trajectory::accumulate(&steps(0.04, 0.1)), &truth, Alignment::Sim3).unwrap();
    ReportInput {
        title: "Run <script>alert(1)</script> & more".into(),
        command: "dimode train --out \"a b\" && echo <x>".into(),
        config_toml: "name = \"</pre><b>x</b>\"".into(),
        facts: vec![("seed".into(), "7".into())],
        stage_marks: vec![StageMark { step: 0, label: "stage 1".into() }, StageMark { step: 40, label: "stage 2".into() }],
        curves: vec![
            curve("l_pho", CurveGroup::Loss),
            curve("valid", CurveGroup::ValidShare),
            curve("grad", CurveGroup::GradientNorm),
            curve("rate", CurveGroup::Other),
        ],
        samples: vec![sample_picture()],
        trajectories: vec![
            TrajectoryPlot::aligned("seq & 1", Alignment::Sim3, &both),
            TrajectoryPlot::predicted("no truth", &truth),
        ],
        evaluation: Some(evaluation()),
        notes: vec!["a note with <i>markup</i>".into()],
    }
}

#[test]
fn every_part_is_on_the_page() {
    let page = render_html(&input()).unwrap();
    for part in [
        "Metrics",
        "Pictures",
        "Trajectories",
        "Errors per frame pair",
        "Losses",
        "Valid pixels and gradients",
        "Configuration",
        "constant depth",
        "zero motion",
        "mean training motion",
        "Sim(3), 7 DoF",
        "ground truth",
        "median scaling per image",
        "stage 2",
        "data:image/png;base64,",
        "no ground truth, the unit is arbitrary",
        "the best trivial row",
        "rigid flow",
        "true depth",
    ] {
        assert!(page.contains(part), "{part} is missing");
    }
}

#[test]
fn the_page_needs_nothing_from_outside() {
    let page = render_html(&input()).unwrap();
    let without_namespace = page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    for bad in ["http://", "https://", "<script", "<link", "@import", "url(", "src=\"/"] {
        assert!(!without_namespace.contains(bad), "{bad} on the page");
    }
    let addresses = without_namespace.split("src=\"").skip(1).chain(without_namespace.split("href=\"").skip(1));
    for address in addresses {
        assert!(address.starts_with("data:image/png;base64,") || address.starts_with('#'), "{}", &address[..40]);
    }
}

#[test]
fn text_from_outside_is_escaped() {
    let page = render_html(&input()).unwrap();
    assert!(page.contains("Run &lt;script&gt;alert(1)"));
    for raw in ["<i>markup", "<b>x</b>", "echo <x>", "frame <7>", "<worlds>", "seq & 1"] {
        assert!(!page.contains(raw), "{raw} is not escaped");
    }
}

#[test]
fn charts_on_the_page_are_well_formed() {
    let page = render_html(&input()).unwrap();
    let charts: Vec<&str> = page.split("<svg xmlns").skip(1).map(|rest| rest.split("</svg>").next().unwrap()).collect();
    assert!(charts.len() > 10, "{}", charts.len());
    for chart in charts {
        super::super::svg::tests::assert_well_formed(&format!("<svg xmlns{chart}</svg>"));
    }
}

#[test]
fn an_almost_empty_report_still_renders() {
    let page = render_html(&ReportInput::default()).unwrap();
    assert!(page.contains("Configuration") && !page.contains("id=\"metrics\""));
    assert!(page.trim_end().ends_with("</html>"));
}

#[test]
fn the_file_is_written_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    write_report(&path, &input()).unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), render_html(&input()).unwrap());
    assert!(write_report(&folder.path().join("no/report.html"), &input()).is_err());
}

//! `l_flow`, and `l_flow_back`: what the flow network is trained by, beside terms of the scene that reach it.

use dimode_autodiff::{Tensor, Var};

use super::report::TermReport;
use super::term::Term;
use crate::config::{FlowData, FlowLossConfig, FlowSmoothnessForm, Iterates, Occlusion};
use crate::losses::census::CensusForm;
use crate::losses::flow_data::{FlowDataTerm, REACHED, Visibility, flow_data};
use crate::losses::flow_smoothness::FlowSmoothness;
use crate::losses::forward_backward::forward_backward;
use crate::non_finite::Failure;

/// Cells on either side of the middle of UnFlow's largest census window.
const UNFLOW_RADIUS: usize = 3;

/// Whether the loss looks at the flow back.
pub fn needs_flow_back(settings: &FlowLossConfig) -> bool {
    settings.occlusion != Occlusion::InView || settings.forward_backward > 0.0
}

/// The weighted sum of [`terms`] and what they say.
///
/// # Errors
/// When a term is not finite.
pub(crate) fn measure<'t>(
    settings: &FlowLossConfig,
    images: [Var<'t, f32>; 2],
    flows: &[Var<'t, f32>],
    backward: Option<&[Var<'t, f32>]>,
) -> Result<(Var<'t, f32>, Vec<TermReport>), Failure> {
    let terms = terms(settings, images, flows, backward);
    let report = |term: &Term<'t>| TermReport::new(term.name, term.weight, term.value.value().item().into(), term.valid);
    let reports: Vec<_> = terms.iter().map(report).collect();
    if let Some(bad) = reports.iter().find(|report| !report.value.is_finite()) {
        return Err(Failure { what: "value", term: bad.name.clone(), sample: None });
    }
    let weighted = |term: &Term<'t>| if term.weight == 1.0 { term.value } else { term.value.scale(term.weight) };
    let sum = terms.iter().map(weighted).reduce(|a, b| a.add(b)).expect("l_flow is always there");
    Ok((sum, reports))
}

/// The terms of successive flows `[n, 2, h, w]` from the first to the second of two images `[n, 3, h, w]`; `backward` are the
/// flows from the second to the first, where [`needs_flow_back`] asks for them.
fn terms<'t>(
    settings: &FlowLossConfig,
    images: [Var<'t, f32>; 2],
    flows: &[Var<'t, f32>],
    backward: Option<&[Var<'t, f32>]>,
) -> Vec<Term<'t>> {
    let last = |flows: &[Var<'t, f32>]| *flows.last().expect("a flow network says at least one flow");
    let back = backward.map(last);
    let back_value: Option<Tensor<f32>> = back.map(|flow| flow.value());
    let visible = visibility(settings.occlusion, back_value.as_ref());
    let compared = match settings.iterates {
        Iterates::All => flows,
        Iterates::Last => &flows[flows.len() - 1..],
    };
    let value = flow_data(data(settings.data), compared, images, (smoothness(settings), settings.smoothness), visible);
    let valid = super::scene::share(&visible.weights(&last(flows).value()));
    let mut terms = vec![Term::new("l_flow", settings.weight, value, valid)];
    if let Some(back) = back.filter(|_| settings.forward_backward > 0.0) {
        terms.push(Term::new("l_flow_back", settings.forward_backward, forward_backward(last(flows), back), 1.0));
    }
    terms
}

fn visibility(choice: Occlusion, back: Option<&Tensor<f32>>) -> Visibility<'_, f32> {
    match (choice, back) {
        (Occlusion::ForwardBackward, Some(back)) => Visibility::ForwardBackward(back),
        (Occlusion::RangeMap, Some(back)) => Visibility::Reached(back, REACHED),
        (Occlusion::SoftRangeMap, Some(back)) => Visibility::ReachedSoftly(back),
        // A choice of matches is refused here; the flow back is missing only where nothing looks at it.
        _ => Visibility::InView,
    }
}

fn data(choice: FlowData) -> FlowDataTerm {
    match choice {
        FlowData::Photometric => FlowDataTerm::Photometric,
        FlowData::PhotometricArflow => FlowDataTerm::Occluded,
        FlowData::CensusArflow => FlowDataTerm::Census(CensusForm::ArFlow),
        FlowData::CensusSmurf => FlowDataTerm::Census(CensusForm::Smurf),
        FlowData::CensusUnflow => FlowDataTerm::Census(CensusForm::UnFlow { radius: UNFLOW_RADIUS }),
    }
}

/// The differences with the sharpness of edges that their programs have.
fn smoothness(settings: &FlowLossConfig) -> FlowSmoothness {
    match settings.smoothness_form {
        FlowSmoothnessForm::Second => FlowSmoothness::Second { edge: 10.0 },
        FlowSmoothnessForm::SecondWide => FlowSmoothness::SecondWide { edge: 150.0 },
        FlowSmoothnessForm::First => FlowSmoothness::First { edge: 150.0 },
        FlowSmoothnessForm::Length => FlowSmoothness::Length,
    }
}

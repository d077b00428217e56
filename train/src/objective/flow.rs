//! `l_flow`, and `l_flow_back`: what the flow network is trained by, beside terms of the scene that reach it.

use dimode_autodiff::{Tensor, Var};

use super::report::TermReport;
use super::term::Term;
use crate::config::{FlowData, FlowLossConfig, Occlusion};
use crate::losses::census::CensusForm;
use crate::losses::flow_photometric::{FlowDataTerm, Visibility, flow_data};
use crate::losses::forward_backward::forward_backward;
use crate::non_finite::Failure;

/// Source pixels that must flow to a target pixel for it to count as seen, as ARFlow has it.
const REACHED: f64 = 0.2;
/// Cells on either side of the middle of UnFlow's largest census window.
const UNFLOW_RADIUS: usize = 3;

/// Whether the loss looks at the flow back.
pub fn needs_flow_back(settings: &FlowLossConfig) -> bool {
    settings.occlusion != Occlusion::InView || settings.consistency > 0.0
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
    let visible = match (settings.occlusion, &back_value) {
        (Occlusion::ForwardBackward, Some(back)) => Visibility::ForwardBackward(back),
        (Occlusion::RangeMap, Some(back)) => Visibility::Reached(back, REACHED),
        // A choice of matches is refused here; the flow back is missing only where nothing looks at it.
        _ => Visibility::InView,
    };
    let data = match settings.data {
        FlowData::Photometric => FlowDataTerm::Photometric,
        FlowData::CensusArflow => FlowDataTerm::Census(CensusForm::ArFlow),
        FlowData::CensusSmurf => FlowDataTerm::Census(CensusForm::Smurf),
        FlowData::CensusUnflow => FlowDataTerm::Census(CensusForm::UnFlow { radius: UNFLOW_RADIUS }),
    };
    let valid = super::scene::share(&visible.weights(&last(flows).value()));
    let mut terms = vec![Term::new("l_flow", 1.0, flow_data(data, flows, images, settings.smoothness, visible), valid)];
    if let Some(back) = back.filter(|_| settings.consistency > 0.0) {
        terms.push(Term::new("l_flow_back", settings.consistency, forward_backward(last(flows), back), 1.0));
    }
    terms
}

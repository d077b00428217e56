//! Where each equation of the paper is in the code.

/// One equation of the paper. Paths begin in this crate.
#[derive(Clone, Copy, Debug)]
pub struct Equation {
    /// Label in the paper's source, without `eq.`; a description in brackets where the equation has none.
    pub label: &'static str,
    /// What it gives.
    pub gives: &'static str,
    /// Closed form.
    pub functions: &'static [&'static str],
    /// What training computes on the tape; none where the equation only explains.
    pub taped: &'static [&'static str],
    /// Ids of the claims that judge it, the chief one first.
    pub claims: &'static [&'static str],
}

/// A row of the list, in the order of the fields.
const fn row(
    label: &'static str,
    gives: &'static str,
    functions: &'static [&'static str],
    taped: &'static [&'static str],
    claims: &'static [&'static str],
) -> Equation {
    Equation { label, gives, functions, taped, claims }
}

const RIGID: &[&str] = &["taped::rigid_flow"];
const ALIGN: &[&str] = &["taped::align", "taped::translation_in_target_frame"];

/// The equations in the order of the paper.
pub static EQUATIONS: &[Equation] = &[
    row("intrinsic_matrix", "viewing rays", &["camera::Intrinsics::ray", "camera::Intrinsics::matrix"], &[], &["L01"]),
    row("p_s", "flow of a static scene", &["flow::rigid::rigid_flow"], RIGID, &["L03", "L02"]),
    row("(warp)", "image read along a flow", &["warp::Image::warped"], &["taped::warp"], &["L04"]),
    row("photometric_loss", "photometric error", &["photometric::photometric_error"], &[], &["L05"]),
    row(
        "transformation",
        "split of a motion",
        &["motion::MotionParts::in_source_frame", "motion::MotionParts::rotation_first"],
        &[],
        &["L06", "L02", "L13"],
    ),
    row("rotational_correspondence", "pixel after a rotation", &["homography::transfer"], RIGID, &["L07"]),
    row("rotational_correspondence_h", "its homography", &["homography::rotation_homography"], RIGID, &["L07"]),
    row(
        "rotational_flow",
        "flow of a rotation",
        &["flow::rotational::rotational_flow", "flow::rotational::quadratic_terms"],
        RIGID,
        &["L08", "L09", "L10", "L11", "L12"],
    ),
    row("tangential_correspondence", "pixel after (t_x, t_y, 0)", &["flow::tangential::tangential_flow"], RIGID, &["L14"]),
    row("tangential_correspondence_2", "the same, written out", &["flow::tangential::tangential_flow"], RIGID, &["L14"]),
    row("tangential_flow", "flow of (t_x, t_y, 0)", &["flow::tangential::tangential_flow"], RIGID, &["L14"]),
    row("radial_correspondence", "pixel after (0, 0, t_z)", &["flow::radial::radial_flow"], RIGID, &["L15", "L16"]),
    row("radial_correspondence_2", "the same, written out", &["flow::radial::radial_flow"], RIGID, &["L15"]),
    row("radial_flow", "flow of (0, 0, t_z)", &["flow::radial::radial_flow"], RIGID, &["L15", "L16"]),
    row(
        "(combined flow)",
        "flow of a whole translation",
        &["flow::translational::translational_flow", "flow::rigid::rigid_flow_by_parts"],
        RIGID,
        &["L17"],
    ),
    row(
        "grad_z",
        "df/dz",
        &["flow::gradients::translational_gradients", "flow::gradients::rigid_gradients"],
        RIGID,
        &["L18", "L21"],
    ),
    row(
        "grad_tx",
        "df/dt_x",
        &["flow::gradients::translational_gradients", "flow::gradients::rigid_gradients"],
        RIGID,
        &["L19", "L22"],
    ),
    row(
        "grad_ty",
        "df/dt_y",
        &["flow::gradients::translational_gradients", "flow::gradients::rigid_gradients"],
        RIGID,
        &["L19", "L22"],
    ),
    row(
        "grad_tz",
        "df/dt_z",
        &["flow::gradients::translational_gradients", "flow::gradients::rigid_gradients"],
        RIGID,
        &["L20", "L22"],
    ),
    row(
        "(fig. idealtransformation)",
        "what is left after one part is undone",
        &["motion::remaining_radial", "motion::remaining_tangential"],
        &[],
        &["L23", "L26"],
    ),
    row(
        "residual_rot",
        "what wrong estimates leave",
        &["deviation::residual_rows", "deviation::alignment_residual"],
        &[],
        &["L24", "L25", "L34"],
    ),
    row("(p_s^C)", "point of the sampled source depth", &["backprojection::source_point"], &["taped::align"], &["L27"]),
    row(
        "pplanar",
        "alignment of the points",
        &["alignment::planar", "alignment::axial", "alignment::printed::defect"],
        ALIGN,
        &["L28", "L29", "L30", "L31", "L32", "L33"],
    ),
    row("disflow", "planar and axial flow", &["alignment::planar", "alignment::axial"], ALIGN, &["L28", "L29", "L35"]),
    row(
        "lp",
        "L_pla",
        &["loss_forms::planar::printed", "loss_forms::planar::circular", "loss_forms::planar::weighted"],
        &["losses::planar"],
        &["L37", "L36", "L38", "L39", "L40"],
    ),
    row(
        "la",
        "L_axi",
        &["loss_forms::axial::printed", "loss_forms::axial::pose_sign", "loss_forms::axial::folded"],
        &["losses::axial"],
        &["L41", "L36", "L42", "L43", "L44", "L45", "L46", "L47", "L48", "L49", "L50"],
    ),
    row(
        "constraint3",
        "rho_x, rho_y",
        &["ratios::tangential_ratios", "ratios::inverse_tangential_ratios"],
        &["losses::tangential"],
        &["L51"],
    ),
    row("constraint4", "rho_z", &["ratios::radial_ratio", "ratios::inverse_radial_ratio"], &["losses::radial"], &["L52", "L53"]),
    row(
        "lt",
        "L_tan",
        &["loss_forms::tangential::printed", "loss_forms::tangential::inverse_ratio"],
        &["losses::tangential"],
        &["L55", "L54", "L57", "L58", "L61"],
    ),
    row(
        "lr",
        "L_rad",
        &["loss_forms::radial::printed", "loss_forms::radial::inverse_ratio"],
        &["losses::radial"],
        &["L54", "L57", "L58", "L59", "L60", "L61"],
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger;

    #[test]
    fn labels_stand_once_and_claims_exist() {
        for (i, equation) in EQUATIONS.iter().enumerate() {
            assert!(EQUATIONS[..i].iter().all(|other| other.label != equation.label), "{} twice", equation.label);
            assert!(!equation.functions.is_empty() && !equation.claims.is_empty(), "{}", equation.label);
            for id in equation.claims {
                assert!(ledger::all().iter().any(|claim| claim.id == *id), "{}: no claim {id}", equation.label);
            }
        }
    }
}

//! Recorded trajectories in the terms of claim L33: how large their motions are, and what the printed alignment costs on them.

use comfy_table::{Cell, CellAlignment, Table, presets};
use dimode_geometry::motion_statistics::{MotionStatistics, Percentiles};

use super::words::brief;

/// One row a quantity, with its percentiles, and the shares below.
pub fn recorded(s: &MotionStatistics) -> String {
    let turning = &s.turning;
    let rows: [(&str, &Option<Percentiles>); 11] = [
        ("rotation, deg", &s.rotation_deg),
        ("L_axi with perfect inputs, printed alignment, rad", &s.axial_loss),
        ("circular L_pla of the same", &s.planar_loss),
        ("|t_tan|, units of the poses", &s.tangential),
        ("|t_z| / |t_tan|", &s.radial_over_tangential),
        ("tangential flow at 20 units, px", &s.tangential_flow),
        ("focus of expansion from the principal point, px", &s.focus_distance),
        ("turning: L_axi as above, rad", &turning.axial_loss),
        ("turning: |delta_x|, units of the poses", &turning.defect_x),
        ("turning: |t'_x|, units of the poses", &turning.in_target_x),
        ("turning: |delta_x / t'_x|", &turning.defect_share_x),
    ];
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED);
    let right = |text: &str| Cell::new(text).set_alignment(CellAlignment::Right);
    let heads = ["count", "10 %", "50 %", "90 %", "99 %", "max"].map(right);
    table.set_header(std::iter::once(Cell::new("between neighbouring frames")).chain(heads));
    for (name, row) in rows {
        let count = row.map_or(0, |p| p.count).to_string();
        let values = row.map_or([None; 5], |p| [p.p10, p.p50, p.p90, p.p99, p.max].map(Some));
        let cells = std::iter::once(count).chain(values.map(brief));
        table.add_row(std::iter::once(Cell::new(name)).chain(cells.map(|text| right(&text))));
    }
    let share = |value: f64| format!("{:.1} %", 100.0 * value);
    format!(
        "{}\n\
         pairs that move more than 0.1: {}; of them turn more than 1 deg: {}\n\
         L_axi of the printed alignment above 1 deg: {}, above 2 deg: {}\n\
         tangential flow at 20 units below half a pixel: {}\n\
         t_x and t'_x of opposite sign where it turns: {}\n\
         both neighbours move, on opposite sides along the axis (printed L_axi is wrong for one of them): {} of {}\n",
        table.trim_fmt(),
        s.pairs,
        turning.pairs,
        share(s.axial_loss_above_1_deg),
        share(s.axial_loss_above_2_deg),
        share(s.tangential_flow_below_half_pixel),
        share(turning.opposite_signs),
        share(s.opposite_sources),
        s.triplets,
    )
}

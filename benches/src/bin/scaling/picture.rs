//! The picture: panels of times above, the roofline below.

use std::fmt::Write;

use dimode::report::svg::{Chart, Series, Stroke, escape};
use dimode_benches::ours::conv::WINOGRAD_SHARE;

use super::Speeds;

/// Times of one subject.
pub struct Panel {
    /// What was timed.
    pub title: String,
    /// What grows.
    pub x_label: String,
    /// One line for each number of threads.
    pub lines: Vec<Line>,
}

/// Times of one number of threads, and those at the speeds of the machine, milliseconds.
pub struct Line {
    /// Name in the legend.
    pub name: String,
    /// Number of the colour.
    pub colour: usize,
    /// Measured times.
    pub measured: Vec<(f64, f64)>,
    /// At the speeds of the machine, operations counted as defined.
    pub bound: Vec<(f64, f64)>,
}

/// One computation in the roofline.
pub struct Spot {
    /// Its name.
    pub name: String,
    /// Operations per byte that must be moved.
    pub intensity: f64,
    /// Operations a second, as the definition counts them.
    pub speed: f64,
    /// Operations a second that were executed: fewer where it goes by Winograd's scheme.
    pub executed: f64,
}

/// Computations below the roofs of the machine.
pub struct Roofline {
    /// Speeds of the machine.
    pub speeds: Speeds,
    /// What ran.
    pub spots: Vec<Spot>,
}

const PANEL: (f64, f64) = (440.0, 250.0);
const COLUMNS: usize = 2;
const HEAD: f64 = 34.0;
const STYLE: &str = "text{font:11px sans-serif;fill:#333}.title{font-size:13px;font-weight:bold}.tick,.stage{font-size:10px;fill:#555}\
    .end{text-anchor:end}.mid{text-anchor:middle}.grid{stroke:#ddd;fill:none}.axis{stroke:#666;fill:none}\
    .line{fill:none;stroke-linejoin:round}.strong{stroke-width:2}.dashed{stroke-width:1.4;stroke-dasharray:5 4}\
    .faint{stroke-width:1;opacity:.5}.dot{fill:#b03060}.c0{stroke:#1f6fb4}.c1{stroke:#d9741a}.c2{stroke:#2e8b57}.c3{stroke:#8a4fbf}\
    .c4{stroke:#888}";

/// SVG text of everything.
pub fn draw(panels: &[Panel], roofline: &Roofline, machine: &str) -> String {
    let rows = panels.len().div_ceil(COLUMNS);
    let (width, cell) = (COLUMNS as f64 * PANEL.0, PANEL.1 + HEAD);
    let roof_height = 330.0;
    let height = 24.0 + rows as f64 * cell + roof_height + HEAD + 20.0;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\">\
         <style>{STYLE}</style><rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\
         <text class=\"tick\" x=\"12\" y=\"17\">{}; dashed: at this machine's speeds, \
         operations as defined; Winograd's scheme executes 16/36 of them and may go below</text>",
        escape(machine)
    );
    for (i, panel) in panels.iter().enumerate() {
        let at = ((i % COLUMNS) as f64 * PANEL.0, 24.0 + (i / COLUMNS) as f64 * cell);
        draw_panel(panel, at, &mut out);
    }
    draw_roofline(roofline, (0.0, 24.0 + rows as f64 * cell), (width, roof_height), &mut out);
    out.push_str("</svg>\n");
    out
}

fn place(out: &mut String, title: &str, legend: &[(String, usize)], (x, y): (f64, f64), chart: &Chart) {
    let _ = write!(out, "<g transform=\"translate({x} {y})\"><text class=\"title\" x=\"54\" y=\"14\">{}</text>", escape(title));
    let mut left = 54.0;
    for (name, colour) in legend {
        let _ = write!(
            out,
            "<path class=\"line strong c{colour}\" d=\"M{left} 25h16\"/><text class=\"tick\" x=\"{}\" y=\"28\">{}</text>",
            left + 20.0,
            escape(name)
        );
        left += 34.0 + 6.0 * name.chars().count() as f64;
    }
    let _ = write!(out, "<g transform=\"translate(0 {HEAD})\">{}</g></g>", chart.content());
}

fn draw_panel(panel: &Panel, at: (f64, f64), out: &mut String) {
    let mut chart = Chart::new(&panel.title, &panel.x_label, "milliseconds");
    chart.log_y = true;
    chart.size = PANEL;
    for line in &panel.lines {
        let series = |points: &Vec<(f64, f64)>, stroke| Series {
            name: line.name.clone(),
            colour: line.colour,
            stroke,
            points: points.clone(),
        };
        chart.series.extend([series(&line.measured, Stroke::Strong), series(&line.bound, Stroke::Dashed)]);
    }
    let legend: Vec<_> = panel.lines.iter().map(|line| (line.name.clone(), line.colour)).collect();
    place(out, &panel.title, &legend, at, &chart);
}

fn draw_roofline(roofline: &Roofline, at: (f64, f64), (width, height): (f64, f64), out: &mut String) {
    let speeds = roofline.speeds;
    let most = roofline.spots.iter().map(|spot| spot.intensity).fold(1.0, f64::max).log2().ceil();
    // Counted as defined, Winograd's scheme could do this at most.
    let beyond = speeds.flops / WINOGRAD_SHARE;
    let roof = |bandwidth: f64, flops: f64| -> Vec<(f64, f64)> {
        let ridge = (flops / bandwidth).log2();
        let mut xs = vec![0.0, ridge, most];
        xs.sort_by(f64::total_cmp);
        xs.into_iter().filter(|x| (0.0..=most).contains(x)).map(|x| (x, flops.min(bandwidth * x.exp2()) / 1e9)).collect()
    };
    let mut chart = Chart::new("Roofline", "flops per byte that must be moved, as a power of 2", "Gflop/s");
    chart.log_y = true;
    // The right part is for the names.
    chart.size = (width - 250.0, height);
    for (name, colour, bandwidth) in [("memory", 0, speeds.memory), ("second-level cache", 1, speeds.cache)] {
        chart.series.push(Series { name: name.into(), colour, stroke: Stroke::Strong, points: roof(bandwidth, speeds.flops) });
    }
    let points = roof(speeds.cache, beyond);
    chart.series.push(Series { name: "Winograd".into(), colour: 2, stroke: Stroke::Dashed, points });
    for (i, spot) in roofline.spots.iter().enumerate() {
        chart.dots.push((spot.intensity.log2(), spot.speed / 1e9, (i + 1).to_string()));
    }
    // Axes go around the lines, so the dots need one too.
    let lowest = roofline.spots.iter().map(|spot| spot.speed / 1e9).fold(speeds.flops / 1e9, f64::min);
    chart.y_range = Some((0.7 * lowest.min(speeds.memory / 1e9), 1.3 * beyond / 1e9));
    let title =
        format!("Convolutions forward under the roofs of {} threads; list: share of the multiply-add peak", speeds.threads);
    let legend = [
        ("memory bandwidth".to_owned(), 0),
        ("second-level cache".to_owned(), 1),
        ("Winograd's scheme, operations as defined (dashed)".to_owned(), 2),
    ];
    place(out, &title, &legend, at, &chart);
    for (i, spot) in roofline.spots.iter().enumerate() {
        let share = |x: f64| format!("{:.0} %", 100.0 * x / speeds.flops);
        let executed = if spot.executed < spot.speed { format!(", {} executed", share(spot.executed)) } else { String::new() };
        let _ = write!(
            out,
            "<text class=\"tick\" x=\"{}\" y=\"{}\">{}  {}: {}{executed}</text>",
            width - 245.0,
            at.1 + HEAD + 20.0 + 17.0 * i as f64,
            i + 1,
            escape(&spot.name),
            share(spot.speed)
        );
    }
}

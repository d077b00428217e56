//! The page: everything is turned into text, charts and pictures here, the template only arranges it.

use minijinja::{Environment, Value, context};

use super::colour::{Rgb, Scale};
use super::curves::{Panel, Run, joint_panels, single_panels};
use super::picture::{Picture, depth_colour, depth_range, flow_range, median_ratio};
use super::svg::{Chart, Mark, Series, Stroke, escape};
use super::{CurveGroup, PathKind, ReportError, ReportInput, SamplePicture, TrajectoryPlot};
use crate::data::{FlowMap, Map};
use crate::eval::{Evaluation, Grid, MotionTable, RowKind};

const TEMPLATE: &str = include_str!("template.html");
/// Relative depth error that gets the last colour.
const FULL_ERROR: f64 = 0.5;

/// The page as text. All text from outside is escaped.
///
/// **Errors** when the template fails, which no input can cause.
pub fn render_html(input: &ReportInput) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.add_template("report.html", TEMPLATE)?;
    let run = Run::new(&input.curves, &input.stage_marks);
    let losses = single_panels(&run, CurveGroup::Loss);
    let other = single_panels(&run, CurveGroup::Other);
    let share = joint_panels(&run, CurveGroup::ValidShare, "Valid-pixel share per term", "share");
    let norms = joint_panels(&run, CurveGroup::GradientNorm, "Gradient norm per term", "norm");
    let page = context! {
        title => input.title.as_str(),
        command => input.command.as_str(),
        config => input.config_toml.as_str(),
        facts => list(&input.facts, |(name, value)| context! { name => name.as_str(), value => value.as_str() }),
        notes => list(&input.notes, |note| Value::from(note.as_str())),
        tiles => input.evaluation.as_ref().map_or_else(Vec::new, tiles),
        tables => input.evaluation.as_ref().map_or_else(Vec::new, tables),
        losses => list(&losses, panel),
        other => list(&other, panel),
        health => list(share.iter().chain(&norms), panel),
        samples => list(&input.samples, sample),
        wheel => safe(&Picture::flow_wheel(120).to_data_uri()),
        trajectories => list(&input.trajectories, trajectory),
        frame_errors => frame_errors(input.evaluation.as_ref()),
    };
    Ok(environment.get_template("report.html")?.render(page)?)
}

fn list<'a, T: 'a>(items: impl IntoIterator<Item = &'a T>, f: impl Fn(&T) -> Value) -> Vec<Value> {
    items.into_iter().map(f).collect()
}

fn safe(markup: &str) -> Value {
    Value::from_safe_string(markup.to_owned())
}

fn legend(entries: &[(String, usize, Stroke)]) -> Vec<Value> {
    let entry = |(name, colour, stroke): &(String, usize, Stroke)| {
        context! { name => name.as_str(), class => format!("c{} {}", colour % 8, stroke.class()) }
    };
    entries.iter().map(entry).collect()
}

fn panel(panel: &Panel) -> Value {
    context! {
        title => panel.title.as_str(),
        linear => safe(&panel.linear),
        log => safe(&panel.log),
        same => panel.linear == panel.log,
        legend => legend(&panel.legend),
    }
}

/// The three headline ratios as tiles.
fn tiles(evaluation: &Evaluation) -> Vec<Value> {
    let names = [
        ("abs_rel", "Depth AbsRel", ""),
        ("rotation_mean_deg", "Rotation error, mean", "°"),
        ("direction_mean_deg", "Direction error, mean", "°"),
        ("ate_m", "ATE", " m"),
    ];
    let depth = evaluation.depth.iter().flat_map(|t| &t.ratios);
    let motion = evaluation.motion.iter().flat_map(|t| &t.ratios);
    let ratios: Vec<_> = depth.chain(motion).collect();
    let tile = |(key, name, unit): (&str, &str, &str)| {
        let ratio = ratios.iter().find(|r| r.metric == key)?;
        Some(context! {
            name => name,
            value => format!("{:.3}{unit}", ratio.trained),
            ratio => format!("{:.2}", ratio.ratio),
            against => format!("{} ({:.3}{unit})", ratio.best_row, ratio.best_trivial),
            class => if ratio.ratio < 1.0 { "good" } else { "bad" },
        })
    };
    names.into_iter().filter_map(tile).collect()
}

fn tables(evaluation: &Evaluation) -> Vec<Value> {
    list(&evaluation.grids(), grid)
}

fn grid(grid: &Grid) -> Value {
    let rows = list(&grid.rows, |row| {
        let class = match row.kind {
            Some(RowKind::Trained) => "trained",
            Some(RowKind::Trivial) => "trivial",
            None => "ratio",
        };
        let cells = list(&row.cells, |(text, best)| context! { text => text.as_str(), best => *best });
        context! { name => row.name.as_str(), class => class, cells => cells }
    });
    context! {
        title => grid.title.as_str(),
        heads => grid.heads.iter().skip(1).map(|h| Value::from(h.as_str())).collect::<Vec<_>>(),
        rows => rows,
        notes => grid.notes.iter().map(|n| Value::from(n.as_str())).collect::<Vec<_>>(),
    }
}

fn figure(caption: String, picture: &Picture) -> Value {
    context! {
        caption => caption,
        uri => safe(&picture.to_data_uri()),
        width => picture.width,
        height => picture.height,
    }
}

fn sample(sample: &SamplePicture) -> Value {
    let mut figures = vec![figure("frame".to_owned(), &Picture::from_image(&sample.image))];
    let mut bars = Vec::new();
    depth_figures(sample, &mut figures, &mut bars);
    let flow_full = flow_figures(sample, &mut figures);
    context! {
        caption => sample.caption.as_str(),
        figures => figures,
        bars => bars,
        flow_full => flow_full.map_or_else(String::new, short),
    }
}

/// Predicted depth, and where truth of the same size is known, true depth and error, with their colour bars.
fn depth_figures(sample: &SamplePicture, figures: &mut Vec<Value>, bars: &mut Vec<Value>) {
    let prediction = &sample.predicted_depth;
    let same_size = |m: &&Map| (m.height, m.width) == (prediction.height, prediction.width);
    let truth = sample.true_depth.as_ref().filter(same_size);
    let scale = truth.map_or(1.0, |truth| median_ratio(prediction, truth));
    let shown = prediction.data.iter().map(|d| f64::from(*d) * scale);
    let known = truth.iter().flat_map(|t| t.data.iter().map(|d| f64::from(*d)));
    let (near, far) = depth_range(known).or_else(|| depth_range(shown)).unwrap_or((1.0, 10.0));
    let (caption, unit) = match truth {
        Some(_) => (format!("predicted depth × {} (median ratio)", short(scale)), "m"),
        None => ("predicted depth, own scale".to_owned(), "own unit"),
    };
    figures.push(figure(caption, &Picture::from_depth(prediction, scale, near, far)));
    bars.push(context! {
        name => format!("depth [{unit}], logarithmic"),
        svg => safe(&depth_bar(near, far)),
    });
    if let Some(truth) = truth {
        figures.push(figure("true depth".to_owned(), &Picture::from_depth(truth, 1.0, near, far)));
        let error = Picture::from_depth_error(prediction, truth, scale, FULL_ERROR);
        figures.push(figure("depth error |p − g| / g".to_owned(), &error));
        bars.push(context! { name => "relative depth error", svg => safe(&error_bar()) });
    }
}

/// The flows in common colours; gives the length in pixels of full colour.
fn flow_figures(sample: &SamplePicture, figures: &mut Vec<Value>) -> Option<f64> {
    let named = [("optical flow (network)", &sample.optical_flow), ("rigid flow (depth and motion)", &sample.rigid_flow)];
    let flows: Vec<&FlowMap> = named.iter().filter_map(|(_, flow)| flow.as_ref()).collect();
    let full = flow_range(&flows);
    for (name, flow) in named {
        if let Some(flow) = flow {
            figures.push(figure(name.to_owned(), &Picture::from_flow(flow, full)));
        }
    }
    (!flows.is_empty()).then_some(full)
}

/// Three significant digits.
fn short(value: f64) -> String {
    let decimals = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

/// A strip of colours with ticks below: `ticks` holds positions 0 to 1 and labels.
fn bar(colour: impl Fn(f64) -> Rgb, ticks: &[(f64, String)]) -> String {
    const STEPS: usize = 64;
    let mut out = String::from("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 280 34\" class=\"bar\" role=\"img\">");
    let width = 256.0 / STEPS as f64;
    for i in 0..STEPS {
        let [r, g, b] = colour((i as f64 + 0.5) / STEPS as f64);
        out.push_str(&format!(
            "<rect x=\"{:.1}\" y=\"2\" width=\"{:.1}\" height=\"12\" fill=\"#{r:02x}{g:02x}{b:02x}\"/>",
            12.0 + i as f64 * width,
            width + 0.3
        ));
    }
    for (position, label) in ticks {
        let x = 12.0 + 256.0 * position;
        out.push_str(&format!(
            "<path class=\"axis\" d=\"M{x:.1} 14v4\"/><text class=\"tick mid\" x=\"{x:.1}\" y=\"29\">{}</text>",
            escape(label)
        ));
    }
    out.push_str("</svg>");
    out
}

fn depth_bar(near: f64, far: f64) -> String {
    let axis = super::scale::Axis { low: near, high: far, log: true };
    let ticks: Vec<(f64, String)> = axis.ticks(5).into_iter().filter_map(|(v, text)| Some((axis.position(v)?, text))).collect();
    bar(|x| depth_colour(near * (far / near).powf(x), near, far), &ticks)
}

fn error_bar() -> String {
    let ticks: Vec<(f64, String)> = (0..=5)
        .map(|k| f64::from(k) / 5.0)
        .map(|x| (x, format!("{:.1}{}", x * FULL_ERROR, if x == 1.0 { "+" } else { "" })))
        .collect();
    bar(|x| Scale::Spectrum.at(x), &ticks)
}

fn trajectory(plot: &TrajectoryPlot) -> Value {
    let unit = if plot.metric { "m" } else { "own unit" };
    let mut chart = Chart::new(&plot.name, &format!("x, right [{unit}]"), &format!("z, forward [{unit}]"));
    chart.equal_units = true;
    chart.size = (440.0, 360.0);
    let mut names = Vec::new();
    for path in &plot.paths {
        let (name, colour, stroke) = match path.kind {
            PathKind::Truth => ("ground truth", 7, Stroke::Broad),
            PathKind::Predicted => ("predicted", 0, Stroke::Strong),
        };
        names.push((name.to_owned(), colour, stroke));
        chart.series.push(Series {
            name: name.to_owned(),
            colour,
            stroke,
            points: path.xz.iter().map(|[x, z]| (*x, *z)).collect(),
        });
    }
    if let Some([x, z]) = plot.paths.first().and_then(|path| path.xz.first()) {
        chart.dots.push((*x, *z, "start".to_owned()));
    }
    context! {
        title => plot.name.as_str(),
        alignment => plot.alignment.as_str(),
        svg => safe(&chart.to_svg()),
        legend => legend(&names),
    }
}

/// Rotation and direction error over frame pairs, trained beside trivial rows.
fn frame_errors(evaluation: Option<&Evaluation>) -> Vec<Value> {
    let Some(table) = evaluation.and_then(|e| e.motion.as_ref()) else {
        return Vec::new();
    };
    let rotation =
        |row: usize| -> Vec<Option<f64>> { table.rows[row].frame_to_frame.rotation_deg.iter().map(|v| Some(*v)).collect() };
    let direction = |row: usize| table.rows[row].frame_to_frame.direction_deg.clone();
    vec![
        error_chart("Rotation error per frame pair", "degrees", table, &rotation),
        error_chart("Translation-direction error per frame pair", "degrees", table, &direction),
    ]
}

fn error_chart(title: &str, y_label: &str, table: &MotionTable, get: &dyn Fn(usize) -> Vec<Option<f64>>) -> Value {
    let mut chart = Chart::new(title, "frame pair, sequences one after the other", y_label);
    chart.size = (680.0, 260.0);
    chart.marks = sequence_marks(table);
    let mut names = Vec::new();
    for row in (0..table.rows.len()).rev() {
        let values = get(row);
        if values.iter().all(Option::is_none) {
            continue;
        }
        let trained = table.rows[row].kind == RowKind::Trained;
        let stroke = if trained { Stroke::Strong } else { Stroke::Dashed };
        let colour = if trained { 0 } else { row };
        let point = |(i, value): (usize, &Option<f64>)| (i as f64, value.unwrap_or(f64::NAN));
        let name = table.rows[row].name.clone();
        chart.series.push(Series { name: name.clone(), colour, stroke, points: values.iter().enumerate().map(point).collect() });
        names.push((name, colour, stroke));
    }
    names.reverse();
    let linear = chart.to_svg();
    chart.log_y = true;
    panel(&Panel { title: title.to_owned(), linear, log: chart.to_svg(), legend: names })
}

/// Where sequences begin; empty when it is not known from the trained row.
fn sequence_marks(table: &MotionTable) -> Vec<Mark> {
    let pairs = |s: &crate::eval::motion_table::SequenceErrors| s.errors.frames.saturating_sub(1);
    let sequences = &table.rows[0].odometry.per_sequence;
    if sequences.len() < 2 || sequences.iter().map(pairs).sum::<usize>() != table.pairs {
        return Vec::new();
    }
    let mut start = 0;
    let mut marks = Vec::new();
    for sequence in sequences {
        marks.push(Mark { x: start as f64, label: sequence.sequence.clone() });
        start += pairs(sequence);
    }
    marks
}

#[cfg(test)]
#[path = "html_tests.rs"]
mod tests;

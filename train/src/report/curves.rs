//! From logged values to chart lines: running mean, thinning, one chart a loss term, one chart for other groups.

use super::svg::{Chart, Mark, Series, Stroke};
use super::{Curve, CurveGroup, StageMark};

/// Most points a line keeps.
const MAX_POINTS: usize = 360;

/// A chart in both scales with what its legend needs.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Panel {
    pub title: String,
    pub linear: String,
    pub log: String,
    pub legend: Vec<(String, usize, Stroke)>,
}

/// What all charts of a run share.
pub(crate) struct Run<'a> {
    curves: &'a [Curve],
    marks: &'a [StageMark],
    /// First and last step of any curve, so that all charts line up.
    steps: Option<(f64, f64)>,
}

impl<'a> Run<'a> {
    pub fn new(curves: &'a [Curve], marks: &'a [StageMark]) -> Self {
        let steps = curves.iter().flat_map(|c| c.points.iter().map(|p| p[0]));
        let steps = steps.fold(None, |range: Option<(f64, f64)>, x| {
            let (low, high) = range.unwrap_or((x, x));
            Some((low.min(x), high.max(x)))
        });
        Self { curves, marks, steps }
    }
}

/// Mean over the points within the same stage at most `reach` places away; the end of a stage is not mixed with the next.
pub(crate) fn running_mean(points: &[(f64, f64)], marks: &[StageMark], reach: usize) -> Vec<(f64, f64)> {
    let finite: Vec<(f64, f64)> = points.iter().copied().filter(|p| p.1.is_finite()).collect();
    let stage = |x: f64| marks.iter().filter(|mark| mark.step as f64 <= x).count();
    let mut smooth = Vec::with_capacity(finite.len());
    let mut start = 0;
    while start < finite.len() {
        let number = stage(finite[start].0);
        let rest = &finite[start..];
        let part = &rest[..rest.iter().take_while(|p| stage(p.0) == number).count()];
        let mut sums = vec![0.0];
        sums.extend(part.iter().scan(0.0, |sum, p| {
            *sum += p.1;
            Some(*sum)
        }));
        for (i, point) in part.iter().enumerate() {
            let (from, to) = (i.saturating_sub(reach), (i + reach + 1).min(part.len()));
            smooth.push((point.0, (sums[to] - sums[from]) / (to - from) as f64));
        }
        start += part.len();
    }
    smooth
}

/// Thins a line to about [`MAX_POINTS`]: of each group of neighbours the lowest and the highest stay, in order.
pub(crate) fn thin(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS {
        return points.to_vec();
    }
    let group = points.len().div_ceil(MAX_POINTS / 2);
    let mut kept = Vec::with_capacity(MAX_POINTS + 2);
    for chunk in points.chunks(group) {
        let low = (0..chunk.len()).min_by(|a, b| chunk[*a].1.total_cmp(&chunk[*b].1));
        let high = (0..chunk.len()).max_by(|a, b| chunk[*a].1.total_cmp(&chunk[*b].1));
        let (Some(low), Some(high)) = (low, high) else {
            continue;
        };
        kept.push(chunk[low.min(high)]);
        if low != high {
            kept.push(chunk[low.max(high)]);
        }
    }
    kept
}

fn lines(curve: &Curve, marks: &[StageMark], colour: usize) -> [Series; 2] {
    let reach = (curve.points.len() / 60).max(2);
    let line = |stroke, points: Vec<(f64, f64)>| Series { name: curve.name.clone(), colour, stroke, points: thin(&points) };
    let raw: Vec<(f64, f64)> = curve.points.iter().map(|[x, y]| (*x, *y)).collect();
    let smooth = running_mean(&raw, marks, reach);
    [line(Stroke::Faint, raw), line(Stroke::Strong, smooth)]
}

fn panel(title: &str, y_label: &str, curves: &[&Curve], run: &Run<'_>, wide: bool) -> Panel {
    let marks = run.marks;
    let mut chart = Chart::new(title, "optimiser step", y_label);
    chart.x_range = run.steps;
    if wide {
        chart.size = (680.0, 280.0);
    }
    let mut legend = Vec::new();
    let (mut faint, mut strong) = (Vec::new(), Vec::new());
    for (i, curve) in curves.iter().enumerate() {
        let [raw, smooth] = lines(curve, marks, i);
        faint.push(raw);
        strong.push(smooth);
        if curves.len() > 1 {
            legend.push((curve.name.clone(), i, Stroke::Strong));
        }
    }
    chart.series = faint;
    chart.series.append(&mut strong);
    let mark = |m: &StageMark| Mark { x: m.step as f64, label: m.label.clone() };
    chart.marks = marks.iter().map(mark).collect();
    if curves.iter().all(|c| c.group == CurveGroup::ValidShare) {
        chart.y_range = Some((0.0, 1.05));
        let svg = chart.to_svg();
        return Panel { title: title.to_owned(), linear: svg.clone(), log: svg, legend };
    }
    let linear = chart.to_svg();
    chart.log_y = true;
    Panel { title: title.to_owned(), linear, log: chart.to_svg(), legend }
}

/// One chart for each curve of a group.
pub(crate) fn single_panels(run: &Run<'_>, group: CurveGroup) -> Vec<Panel> {
    let chosen = run.curves.iter().filter(|c| c.group == group && !c.points.is_empty());
    chosen.map(|c| panel(&c.name, "value", &[c], run, false)).collect()
}

/// One chart for a group (several when it has more than eight curves).
pub(crate) fn joint_panels(run: &Run<'_>, group: CurveGroup, title: &str, y_label: &str) -> Vec<Panel> {
    let curves = run.curves.iter();
    let chosen: Vec<&Curve> = curves.filter(|c| c.group == group && !c.points.is_empty()).collect();
    chosen.chunks(8).map(|part| panel(title, y_label, part, run, true)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::svg::tests::assert_well_formed;
    use super::*;

    fn mark(step: u64) -> StageMark {
        StageMark { step, label: format!("from {step}") }
    }

    #[test]
    fn the_running_mean_stays_within_a_stage() {
        let points: Vec<(f64, f64)> = (0..20).map(|i| (f64::from(i), if i < 10 { 1.0 } else { 5.0 })).collect();
        let smooth = running_mean(&points, &[mark(0), mark(10)], 4);
        assert_eq!(smooth, points);
        let ramp: Vec<(f64, f64)> = (0..9).map(|i| (f64::from(i), f64::from(i))).collect();
        assert_eq!(running_mean(&ramp, &[], 3)[3..6], ramp[3..6]);
        let spike = [(0.0, 0.0), (1.0, 3.0), (2.0, 0.0), (3.0, f64::NAN)];
        assert_eq!(running_mean(&spike, &[], 1), [(0.0, 1.5), (1.0, 1.0), (2.0, 1.5)]);
    }

    #[test]
    fn thinning_keeps_the_extremes() {
        let mut points: Vec<(f64, f64)> = (0..5000).map(|i| (f64::from(i), 1.0)).collect();
        points[1234].1 = 99.0;
        points[4321].1 = -99.0;
        let kept = thin(&points);
        assert!(kept.len() <= MAX_POINTS + 2, "{}", kept.len());
        assert!(kept.contains(&(1234.0, 99.0)) && kept.contains(&(4321.0, -99.0)));
        assert!(kept.windows(2).all(|w| w[0].0 < w[1].0));
    }

    #[test]
    fn panels_are_made_per_term_and_per_group() {
        let curve = |name: &str, group: CurveGroup| Curve {
            name: name.into(),
            group,
            points: (0..50).map(|i| [f64::from(i), 0.1 + 1.0 / (1.0 + f64::from(i))]).collect(),
        };
        let curves = vec![
            curve("l_pho", CurveGroup::Loss),
            curve("l_smooth", CurveGroup::Loss),
            curve("valid l_pla", CurveGroup::ValidShare),
        ];
        let marks = [mark(0), mark(25)];
        let run = Run::new(&curves, &marks);
        assert_eq!(run.steps, Some((0.0, 49.0)));
        let single = single_panels(&run, CurveGroup::Loss);
        assert_eq!(single.len(), 2);
        assert_ne!(single[0].linear, single[0].log);
        let joint = joint_panels(&run, CurveGroup::ValidShare, "valid", "share");
        assert_eq!((joint.len(), joint[0].linear == joint[0].log), (1, true));
        for panel in single.iter().chain(&joint) {
            assert_well_formed(&panel.linear);
            assert_well_formed(&panel.log);
        }
        assert!(joint_panels(&run, CurveGroup::GradientNorm, "g", "norm").is_empty());
    }
}

//! Charts are well-formed and put points where they belong.

use super::*;

/// A small check that markup is well-formed: tags nest, attributes are quoted, no stray `<` or `&`.
pub(crate) fn assert_well_formed(svg: &str) {
    let mut open: Vec<String> = Vec::new();
    let mut rest = svg;
    while let Some(start) = rest.find('<') {
        assert_text(&rest[..start]);
        let end = rest[start..].find('>').expect("a tag that never closes") + start;
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "closing tag");
            continue;
        }
        let body = tag.strip_suffix('/').unwrap_or(tag);
        let quotes = body.matches('"').count();
        assert!(quotes.is_multiple_of(2) && body.matches("=\"").count() * 2 == quotes, "attributes of <{tag}>");
        for (i, part) in body.split('"').enumerate() {
            if i % 2 == 1 {
                assert_text(part);
            }
        }
        let name = body.split_whitespace().next().expect("a tag name");
        if !tag.ends_with('/') {
            open.push(name.to_owned());
        }
    }
    assert_text(rest);
    assert!(open.is_empty(), "left open: {open:?}");
}

fn assert_text(text: &str) {
    for part in text.split('&').skip(1) {
        let entity = part.split(';').next().expect("text after &");
        assert!(["amp", "lt", "gt", "quot", "#39"].contains(&entity), "stray & before {part:?}");
    }
}

fn chart() -> Chart {
    let mut chart = Chart::new("a < b & \"c\"", "step", "loss");
    chart.series.push(Series {
        name: "l<pho>".into(),
        colour: 9,
        stroke: Stroke::Strong,
        points: vec![(0.0, 0.0), (50.0, f64::NAN), (100.0, 1.0), (150.0, 2.0)],
    });
    chart.marks = vec![Mark { x: 0.0, label: "stage 1".into() }, Mark { x: 60.0, label: "stage 2 & more".into() }];
    chart.dots.push((0.0, 0.0, "start".into()));
    chart
}

#[test]
fn svg_is_well_formed_and_escaped() {
    let svg = chart().to_svg();
    assert_well_formed(&svg);
    assert!(svg.contains("a &lt; b &amp; &quot;c&quot;"));
    assert!(svg.contains("stage 2 &amp; more") && svg.contains("class=\"line c1 strong\""));
    let mut empty = Chart::new("nothing", "x", "y");
    assert_well_formed(&empty.to_svg());
    empty.equal_units = true;
    empty.log_y = true;
    assert_well_formed(&empty.to_svg());
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn a_line_is_broken_at_values_that_cannot_be_shown() {
    let svg = chart().to_svg();
    let path = svg.split("strong\" d=\"").nth(1).unwrap().split('"').next().unwrap();
    assert_eq!((path.matches('M').count(), path.matches('L').count()), (2, 1));
    assert!(path.starts_with("M54.0 192.0"), "{path}");
    let mut log = chart();
    log.log_y = true;
    assert!(log.to_svg().contains("strong\" d=\"M"));
}

#[test]
fn equal_units_keep_a_square_square() {
    let mut chart = Chart::new("path", "x", "z");
    chart.equal_units = true;
    chart.series.push(Series {
        name: "square".into(),
        colour: 0,
        stroke: Stroke::Strong,
        points: vec![(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)],
    });
    let frame = Frame::of(&chart);
    let width = frame.x_at(10.0).unwrap() - frame.x_at(0.0).unwrap();
    let height = frame.y_at(0.0).unwrap() - frame.y_at(10.0).unwrap();
    assert!((width - height).abs() < 1e-9);
}

#[test]
fn control_characters_do_not_reach_the_page() {
    assert_eq!(escape("a\u{0}b\u{1b}[0m"), "a b [0m");
}

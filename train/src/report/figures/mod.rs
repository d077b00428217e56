//! Pictures of the paper's claims: what the parts of a motion do to an image, how a flow is taken apart, and what the losses of
//! direction ask for. One figure a file; all numbers come from [`dimode_geometry`].

mod cuts;
mod decomposition;
mod flow_fields;
mod landscapes;
mod page;

pub use page::page;

/// A picture with what it shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Figure {
    /// Name of its file, without ending.
    pub name: &'static str,
    /// Heading.
    pub title: &'static str,
    /// What is to be seen, and which claims it belongs to.
    pub caption: &'static str,
    /// The picture, one SVG document.
    pub svg: String,
}

/// All figures, in the order in which they are told.
pub fn all() -> Vec<Figure> {
    vec![
        flow_fields::figure(),
        decomposition::exact(),
        decomposition::with_errors(),
        landscapes::axial(),
        landscapes::planar(),
        cuts::figure(),
    ]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::report::svg::tests::assert_well_formed;

    #[test]
    fn figures_stand_alone_and_have_the_same_bytes_again() {
        let (figures, again) = (all(), all());
        assert_eq!(figures, again);
        let names: BTreeSet<_> = figures.iter().map(|f| f.name).collect();
        assert_eq!(names.len(), figures.len());
        for figure in &figures {
            assert_well_formed(figure.svg.trim_end());
            assert!(figure.svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\""), "{}", figure.name);
            assert!(!figure.svg.contains("NaN") && !figure.svg.contains(" id=\"") && !figure.svg.contains("href"));
            assert!(figure.caption.len() > 80, "{}", figure.name);
        }
        let page = page(&figures).unwrap();
        for figure in &figures {
            assert!(page.contains(figure.svg.trim_end()) && page.contains(&format!("{}.svg", figure.name)));
        }
        assert!(
            !page.contains("http://") || page.matches("http://").count() == page.matches("http://www.w3.org/2000/svg").count()
        );
    }
}

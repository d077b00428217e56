//! Calibration files of the KITTI form: `LABEL: numbers`, one a line.

use std::path::Path;

use dimode_geometry::Intrinsics;

use super::DataError;
use super::text::{filled_lines, parse_numbers, read_text};

/// The labelled lines of a calibration file; numbers are read when asked for, so rows nobody needs cannot stand in the way.
#[derive(Clone, Debug)]
pub struct Calibration {
    path: std::path::PathBuf,
    rows: Vec<(usize, String, String)>,
}

const ROW_FORM: &str = "give a line such as `P0: fu 0 u0 0 0 fv v0 0 0 0 1 0` (twelve numbers, 3x4, row by row)";

impl Calibration {
    /// Reads a calibration file.
    ///
    /// **Errors** as [`Calibration::parse`], and when the file cannot be read.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        Self::parse(path, &read_text(path, "calibration file")?)
    }

    /// The rows of a calibration text; `path` only names the file in errors.
    ///
    /// **Errors** name the line that has no label or repeats one.
    pub fn parse(path: &Path, text: &str) -> Result<Self, DataError> {
        let mut rows: Vec<(usize, String, String)> = Vec::new();
        for (line, content) in filled_lines(text) {
            let Some((label, values)) = content.split_once(':') else {
                return Err(DataError::at_line(path, line, "no label such as `P0:` in front", ROW_FORM));
            };
            let label = label.trim();
            if rows.iter().any(|(_, known, _)| known == label) {
                return Err(DataError::at_line(path, line, format!("{label} appears twice"), "keep one of the lines"));
            }
            rows.push((line, label.to_owned(), values.to_owned()));
        }
        Ok(Self { path: path.to_owned(), rows })
    }

    /// The camera of projection row `label` (`P0` to `P3`) for images of the given size: the left 3x3 of the row.
    ///
    /// **Errors** when the label is missing (naming those that exist), the row has not twelve finite numbers, skew or a last
    /// row other than (0, 0, 1), a focal length that is not positive, or a principal point far outside the image.
    pub fn camera(&self, label: &str, width: usize, height: usize) -> Result<Intrinsics, DataError> {
        let Some((line, _, values)) = self.rows.iter().find(|(_, known, _)| known == label) else {
            let found: Vec<&str> = self.rows.iter().map(|(_, known, _)| known.as_str()).collect();
            let reason =
                format!("{label} missing (found {})", if found.is_empty() { "nothing".into() } else { found.join(", ") });
            return Err(DataError::malformed(&self.path, reason, ROW_FORM));
        };
        let at = |reason: String| DataError::at_line(&self.path, *line, reason, ROW_FORM);
        let p = parse_numbers(&self.path, *line, values)?;
        if p.len() != 12 {
            return Err(at(format!("{label} has {} numbers, expected 12", p.len())));
        }
        if p[1] != 0.0 || p[4] != 0.0 {
            return Err(at(format!("{label} has skew ({}, {}), only rectified images without skew can be used", p[1], p[4])));
        }
        if p[8..11] != [0.0, 0.0, 1.0] {
            return Err(at(format!("{label} has a last row {:?}, expected 0 0 1", &p[8..11])));
        }
        checked_intrinsics([p[0], p[5], p[2], p[6]], width, height).map_err(|reason| at(format!("{label}: {reason}")))
    }
}

/// Intrinsics from (fu, fv, u0, v0), refused with the reason when no camera of that image size has them.
pub(crate) fn checked_intrinsics(values: [f64; 4], width: usize, height: usize) -> Result<Intrinsics, String> {
    let [fu, fv, u0, v0] = values;
    for (name, focal) in [("fu", fu), ("fv", fv)] {
        if !(focal > 0.0 && focal.is_finite()) {
            return Err(format!("focal length {name} = {focal}, expected a positive number of pixels"));
        }
        if focal < 2.0 {
            return Err(format!("focal length {name} = {focal} looks normalised, expected pixels"));
        }
    }
    for (name, centre, side, size) in [("u0", u0, "width", width), ("v0", v0, "height", height)] {
        let half = size as f64 / 2.0;
        if !(centre >= -half && centre <= size as f64 + half) {
            return Err(format!("principal point {name} = {centre} lies outside the image {side} {size}"));
        }
    }
    Intrinsics::new(fu, fv, u0, v0, width, height).map_err(|error| error.to_string())
}

/// Projection row of a camera without baseline, in the form of a KITTI calibration file.
pub(crate) fn format_projection(label: &str, camera: &Intrinsics) -> String {
    let row = [camera.fu, 0.0, camera.u0, 0.0, 0.0, camera.fv, camera.v0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let row: Vec<String> = row.iter().map(|&value| super::text::scientific(value, 12)).collect();
    format!("{label}: {}\n", row.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const P0: &str = "P0: 700 0 600 0 0 710 180 0 0 0 1 0\n";

    fn camera(text: &str, label: &str) -> Result<Intrinsics, DataError> {
        Calibration::parse(Path::new("calib.txt"), text)?.camera(label, 1226, 370)
    }

    fn message(text: &str, label: &str) -> String {
        camera(text, label).unwrap_err().to_string()
    }

    #[test]
    fn rows_are_found_by_label() {
        let text = format!("calib_time: 09-Jan-2012 13:57:47\r\nP1: 1 2\n{P0}");
        let camera = camera(&text, "P0").unwrap();
        assert_eq!((camera.fu, camera.fv, camera.u0, camera.v0), (700.0, 710.0, 600.0, 180.0));
        assert_eq!((camera.width, camera.height), (1226, 370));
    }

    #[test]
    fn faults_are_named() {
        assert!(message(P0, "P2").starts_with("calib.txt: P2 missing (found P0)"));
        assert!(message("", "P0").starts_with("calib.txt: P0 missing (found nothing)"));
        assert!(message("700 0 600 0 0 700 180 0 0 0 1 0", "P0").starts_with("calib.txt:1: no label"));
        assert!(message(&format!("{P0}{P0}"), "P0").starts_with("calib.txt:2: P0 appears twice"));
        let row = |from: &str, to: &str| message(&format!("\n{}", P0.replacen(from, to, 1)), "P0");
        assert!(row("1 0\n", "1\n").starts_with("calib.txt:2: P0 has 11 numbers, expected 12"));
        assert!(row("700", "0").starts_with("calib.txt:2: P0: focal length fu = 0, expected a positive number"));
        assert!(row("710", "-710").starts_with("calib.txt:2: P0: focal length fv = -710"));
        assert!(row("700", "nan").starts_with("calib.txt:2: non-finite value nan"));
        assert!(row("700", "0.58").contains("fu = 0.58 looks normalised"));
        assert!(row("600", "5000").contains("principal point u0 = 5000 lies outside the image width 1226"));
        assert!(row("700 0", "700 1").contains("P0 has skew (1, 0)"));
        assert!(row("0 0 1 0", "0 1 1 0").contains("P0 has a last row"));
    }

    #[test]
    fn format_reads_back() {
        let camera = Intrinsics::new(64.123456789, 65.5, 31.5, 15.25, 64, 32).unwrap();
        let text = format_projection("P2", &camera);
        assert_eq!(Calibration::parse(Path::new("c"), &text).unwrap().camera("P2", 64, 32).unwrap(), camera);
    }

    proptest! {
        #[test]
        fn any_text_is_an_error_or_a_camera(text in "(P0|Tr|)[:P0-9eE. naif\n-]{0,120}") {
            if let Ok(calibration) = Calibration::parse(Path::new("c"), &text)
                && let Ok(camera) = calibration.camera("P0", 100, 50) {
                prop_assert!(camera.fu > 0.0 && camera.fv > 0.0);
            }
        }

        #[test]
        fn any_twelve_numbers_are_an_error_or_a_camera(row in prop::collection::vec(any::<f64>(), 12)) {
            let row: Vec<String> = row.iter().map(f64::to_string).collect();
            if let Ok(camera) = camera(&format!("P0: {}", row.join(" ")), "P0") {
                prop_assert!(camera.fu > 0.0 && camera.fv > 0.0);
            }
        }
    }
}

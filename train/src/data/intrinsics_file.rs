//! The small file that tells the camera of a folder of frames.
//!
//! `intrinsics.txt` or `intrinsics.toml`, one `key = value` a line (`:` or a blank may stand for `=`, `#` starts a comment):
//!
//! ```text
//! fu = 718.856      # focal length in pixels along the width  (also: fx)
//! fv = 718.856      # focal length in pixels along the height (also: fy)
//! u0 = 607.193      # principal point in pixels, pixel centres at whole numbers (also: cx)
//! v0 = 185.216      #                                                           (also: cy)
//! width = 1241      # image size the numbers belong to; without it, the size of the frames
//! height = 376
//! ```
//!
//! `normalized = true` tells that fu and u0 are fractions of the width, fv and v0 of the height. Distortion (`k1` to `k3`,
//! `p1`, `p2`, `skew`) may be given as 0 only. A file of bare numbers is read too: `fu fv u0 v0`, a 3x3 matrix, or
//! `width height fu fv u0 v0` (or the size behind, as long as only one reading makes sense).

use std::path::Path;

use dimode_geometry::Intrinsics;

use super::DataError;
use super::calib::checked_intrinsics;
use super::text::{filled_lines, parse_number, read_text};

/// What an intrinsics file looks like, for messages.
pub(crate) const EXAMPLE: &str = "write fu fv u0 v0 in pixels of the frames into a file intrinsics.txt beside them, for instance: \
    718.856 718.856 607.193 185.216";

const KEYS: [&str; 13] = ["fu", "fv", "u0", "v0", "width", "height", "normalized", "skew", "k1", "k2", "k3", "p1", "p2"];
/// Largest relative difference of the two ratios when intrinsics are carried to another image size.
const ASPECT_LIMIT: f64 = 0.005;

/// Numbers of an intrinsics file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicsFile {
    /// fu, fv, u0, v0 as written.
    values: [f64; 4],
    /// The (width, height) they belong to, where the file tells it.
    size: Option<(usize, usize)>,
    /// Whether the values are fractions of the size.
    normalized: bool,
}

impl IntrinsicsFile {
    /// Reads an intrinsics file; the form is described at the module.
    ///
    /// **Errors** as [`IntrinsicsFile::parse`], and when the file cannot be read.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        Self::parse(path, &read_text(path, "intrinsics file")?)
    }

    /// The numbers of an intrinsics text; `path` only names the file in errors.
    ///
    /// **Errors** name the line: unknown, repeated or missing key, no finite number, a size that is no whole number,
    /// distortion other than 0, bare numbers of an unknown or ambiguous form.
    pub fn parse(path: &Path, text: &str) -> Result<Self, DataError> {
        let lines: Vec<(usize, &str)> = filled_lines(text)
            .map(|(line, content)| (line, content.split('#').next().unwrap_or_default().trim()))
            .filter(|(_, content)| !content.is_empty())
            .collect();
        match lines.first() {
            Some((_, first)) if first.starts_with(|c: char| c.is_ascii_alphabetic() || c == '[') => keyed(path, &lines),
            Some(_) => bare(path, &lines),
            None => Err(DataError::malformed(path, "no numbers in the intrinsics file", EXAMPLE)),
        }
    }

    /// The camera for frames of the given size; intrinsics of another size are scaled when the shape is the same.
    ///
    /// **Errors** a shape that differs by more than 0.5 %, focal lengths that are not positive, a principal point far outside.
    pub fn camera(&self, path: &Path, width: usize, height: usize) -> Result<Intrinsics, DataError> {
        let (own_width, own_height) = self.size.unwrap_or((width, height));
        let (ratio_u, ratio_v) = (width as f64 / own_width as f64, height as f64 / own_height as f64);
        if (ratio_u / ratio_v - 1.0).abs() > ASPECT_LIMIT {
            let reason =
                format!("intrinsics belong to {own_width}x{own_height}, but the frames are {width}x{height} of another shape");
            return Err(DataError::malformed(path, reason, "give the intrinsics of the frames as they are stored"));
        }
        let [fu, fv, u0, v0] = self.values;
        let (w, h) = if self.normalized { (own_width as f64, own_height as f64) } else { (1.0, 1.0) };
        let camera = checked_intrinsics([fu * w, fv * h, u0 * w, v0 * h], own_width, own_height)
            .map_err(|reason| DataError::malformed(path, reason, EXAMPLE))?;
        Ok(if (own_width, own_height) == (width, height) { camera } else { camera.resized(width, height) })
    }
}

fn keyed(path: &Path, lines: &[(usize, &str)]) -> Result<IntrinsicsFile, DataError> {
    let mut found: [Option<f64>; KEYS.len()] = [None; KEYS.len()];
    for &(line, content) in lines {
        let (key, value) = split_key(content)
            .ok_or_else(|| DataError::at_line(path, line, format!("{content:?} is not `key = value`"), EXAMPLE))?;
        let Some(index) = KEYS.iter().position(|known| *known == canonical(key)) else {
            let reason = format!("unknown key {key:?}, known are {}", KEYS.join(", "));
            return Err(DataError::at_line(path, line, reason, EXAMPLE));
        };
        let number = match (KEYS[index], value) {
            ("normalized", "true") => 1.0,
            ("normalized", "false") => 0.0,
            _ => parse_number(path, line, value)?,
        };
        if index > 6 && number != 0.0 {
            let reason = format!("distortion {key} = {number} is not supported");
            return Err(DataError::at_line(path, line, reason, "undistort the frames first and give the new intrinsics"));
        }
        if found[index].replace(number).is_some() {
            return Err(DataError::at_line(path, line, format!("{key} appears twice"), "keep one of the lines"));
        }
    }
    let need =
        |index: usize| found[index].ok_or_else(|| DataError::malformed(path, format!("{} is missing", KEYS[index]), EXAMPLE));
    let values = [need(0)?, need(1)?, need(2)?, need(3)?];
    let size = match (found[4], found[5]) {
        (None, None) => None,
        _ => Some(whole_size(path, need(4)?, need(5)?)?),
    };
    Ok(IntrinsicsFile { values, size, normalized: found[6] == Some(1.0) })
}

fn split_key(content: &str) -> Option<(&str, &str)> {
    let at = content.find(|c: char| c == '=' || c == ':' || c.is_whitespace())?;
    let (key, rest) = content.split_at(at);
    Some((key, rest.trim_start_matches(|c: char| c == '=' || c == ':' || c.is_whitespace())))
}

fn canonical(key: &str) -> &str {
    match key {
        "fx" => "fu",
        "fy" => "fv",
        "cx" => "u0",
        "cy" => "v0",
        "normalised" => "normalized",
        other => other,
    }
}

fn whole_size(path: &Path, width: f64, height: f64) -> Result<(usize, usize), DataError> {
    if is_side(width) && is_side(height) {
        return Ok((width as usize, height as usize));
    }
    let reason = format!("image size {width}x{height}, expected whole numbers of pixels");
    Err(DataError::malformed(path, reason, EXAMPLE))
}

fn is_side(value: f64) -> bool {
    value.fract() == 0.0 && (1.0..=super::decode::MAX_SIDE as f64).contains(&value)
}

/// Bare numbers: four, six or nine.
fn bare(path: &Path, lines: &[(usize, &str)]) -> Result<IntrinsicsFile, DataError> {
    let mut n = Vec::new();
    for &(line, content) in lines {
        for token in content.split(|c: char| c.is_whitespace()).filter(|token| !token.is_empty()) {
            n.push(parse_number(path, line, token)?);
        }
    }
    let plain = |values, size| Ok(IntrinsicsFile { values, size, normalized: false });
    match n.len() {
        4 => plain([n[0], n[1], n[2], n[3]], None),
        6 => {
            let fits =
                |w: f64, h: f64, u0: f64, v0: f64| is_side(w) && is_side(h) && (0.0..=w).contains(&u0) && (0.0..=h).contains(&v0);
            match (fits(n[0], n[1], n[4], n[5]), fits(n[4], n[5], n[2], n[3])) {
                (true, false) => plain([n[2], n[3], n[4], n[5]], Some((n[0] as usize, n[1] as usize))),
                (false, true) => plain([n[0], n[1], n[2], n[3]], Some((n[4] as usize, n[5] as usize))),
                _ => Err(DataError::malformed(path, "six bare numbers whose order is unclear", EXAMPLE)),
            }
        }
        9 if [n[1], n[3], n[6], n[7]] == [0.0; 4] && n[8] == 1.0 => plain([n[0], n[4], n[2], n[5]], None),
        9 => Err(DataError::malformed(path, "nine numbers that are no matrix fu 0 u0 0 fv v0 0 0 1 without skew", EXAMPLE)),
        found => Err(DataError::malformed(path, format!("{found} bare numbers, expected 4, 6 or 9"), EXAMPLE)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn camera(text: &str, width: usize, height: usize) -> Result<Intrinsics, DataError> {
        let path = Path::new("intrinsics.txt");
        IntrinsicsFile::parse(path, text)?.camera(path, width, height)
    }

    fn message(text: &str) -> String {
        camera(text, 640, 480).unwrap_err().to_string()
    }

    #[test]
    fn every_form_gives_the_same_camera() {
        let forms = [
            "fu = 500\nfv = 510 # comment\nu0 = 320\nv0 = 240\nwidth = 640\nheight = 480\n",
            "# a camera\r\nfx: 500\r\nfy: 510\r\ncx: 320\r\ncy: 240\r\n",
            "fu 500\nfv 510\nu0 320\nv0 240\nk1 = 0.0\nnormalized = false",
            "500 510 320 240",
            "500 0 320\n0 510 240\n0 0 1\n",
            "640 480 500 510 320 240",
            "500 510 320 240 640 480",
            "normalized = true\nfu = 0.78125\nfv = 1.0625\nu0 = 0.5\nv0 = 0.5",
        ];
        for form in forms {
            let camera = camera(form, 640, 480).unwrap();
            assert_eq!((camera.fu, camera.fv, camera.u0, camera.v0), (500.0, 510.0, 320.0, 240.0), "{form}");
            assert_eq!((camera.width, camera.height), (640, 480));
        }
    }

    #[test]
    fn intrinsics_of_another_size_are_scaled() {
        let camera = camera("640 480 500 510 319.5 239.5", 320, 240).unwrap();
        assert_eq!((camera.fu, camera.fv, camera.u0, camera.v0), (250.0, 255.0, 159.5, 119.5));
    }

    #[test]
    fn another_shape_is_refused() {
        let message = camera("640 480 500 510 320 240", 640, 400).unwrap_err().to_string();
        assert!(message.contains("intrinsics belong to 640x480, but the frames are 640x400"), "{message}");
    }

    #[test]
    fn faults_are_named() {
        let good = "fu = 500\nfv = 510\nu0 = 320\nv0 = 240\n";
        assert!(message("").contains("no numbers in the intrinsics file"));
        assert!(message(&good.replace("fv = 510\n", "")).contains("intrinsics.txt: fv is missing"));
        assert!(message(&format!("{good}zoom = 3")).contains("intrinsics.txt:5: unknown key \"zoom\", known are fu, fv"));
        assert!(message(&format!("{good}fx = 3")).contains("intrinsics.txt:5: fx appears twice"));
        assert!(message(&format!("{good}width = 640")).contains("height is missing"));
        assert!(message(&format!("{good}width = 640.5\nheight = 480")).contains("image size 640.5x480, expected whole"));
        assert!(
            message(&format!("{good}k1 = -0.33")).contains("intrinsics.txt:5: distortion k1 = -0.33 is not supported; undistort")
        );
        assert!(message(&good.replace("500", "0")).contains("focal length fu = 0, expected a positive number"));
        assert!(message(&good.replace("500", "inf")).contains("intrinsics.txt:1: non-finite value inf"));
        assert!(message(&good.replace("500", "five")).contains("intrinsics.txt:1: \"five\" is not a number"));
        assert!(message(&good.replace("500", "0.7")).contains("fu = 0.7 looks normalised"));
        assert!(message(&good.replace("240", "9000")).contains("principal point v0 = 9000 lies outside"));
        assert!(message("[camera]\nfu = 3").contains("intrinsics.txt:1: \"[camera]\" is not `key = value`"));
        assert!(message("500 510 320").contains("3 bare numbers, expected 4, 6 or 9"));
        assert!(message("500 2 320 0 510 240 0 0 1").contains("nine numbers that are no matrix"));
        assert!(message("200 100 100 50 150 75").contains("six bare numbers whose order is unclear"));
    }

    #[test]
    fn messages_show_an_example() {
        assert!(message("").contains("for instance: 718.856 718.856 607.193 185.216"));
    }

    proptest! {
        #[test]
        fn any_text_is_an_error_or_a_camera(text in "((fu|fv|u0|v0|width|height|k1)?[ =:][-0-9e.# naif]{0,12}\n?){0,8}") {
            if let Ok(camera) = camera(&text, 64, 48) {
                prop_assert!(camera.fu > 0.0 && camera.fv > 0.0);
            }
        }

        #[test]
        fn any_numbers_are_an_error_or_a_camera(numbers in prop::collection::vec(any::<f64>(), 0..10)) {
            let text: Vec<String> = numbers.iter().map(f64::to_string).collect();
            if let Ok(camera) = camera(&text.join(" "), 64, 48) {
                prop_assert!(camera.fu > 0.0 && camera.fv > 0.0);
            }
        }
    }
}

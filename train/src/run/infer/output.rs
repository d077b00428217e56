//! Forms of depth and flow on the disk.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use dimode_autodiff::Tensor;
use dimode_autodiff::par;

use crate::data::{
    DataError, FlowMap, KnownFlow, Map, read_flo, read_flow_png, write_atomic, write_depth_png, write_flo, write_flow_png,
    write_npy,
};
use crate::eval::{resize_bilinear, resize_depth};
use crate::report::colour::Scale;
use crate::report::flow_wheel::round_scale;
use crate::report::picture::Picture;

/// The largest depth that a 16-bit picture holds.
const FARTHEST: f32 = 65535.0 / 256.0;
/// Frames that are drawn at a time.
const CHUNK: usize = 16;

/// A form of depth or flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// `depth/` and `flow/`: 16-bit pictures as in KITTI.
    Png,
    /// `depth_npy/`: arrays of 32-bit floats.
    Npy,
    /// `depth_magma/`: inverse depth in the colours of magma.
    Magma,
    /// `depth_turbo/`: inverse depth in the colours of turbo.
    Turbo,
    /// `flow/`: files of 32-bit floats.
    Flo,
    /// `flow_colour/`: pictures by the colour wheel, with its legend.
    Wheel,
}

/// The forms to write, each once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Forms(pub Vec<Form>);

impl Forms {
    /// 16-bit pictures, magma for depth and the wheel for flow.
    pub const USUAL: [Form; 3] = [Form::Png, Form::Magma, Form::Wheel];

    /// Whether a form is among them.
    pub fn has(&self, form: Form) -> bool {
        self.0.contains(&form)
    }

    /// Whether there is one for depth.
    pub fn of_depth(&self) -> bool {
        [Form::Png, Form::Npy, Form::Magma, Form::Turbo].into_iter().any(|form| self.has(form))
    }

    /// Whether there is one for flow.
    pub fn of_flow(&self) -> bool {
        [Form::Png, Form::Flo, Form::Wheel].into_iter().any(|form| self.has(form))
    }

    /// How flow is kept until its pictures are drawn.
    fn kept_flow(&self) -> Form {
        if self.has(Form::Flo) { Form::Flo } else { Form::Png }
    }
}

/// Folder of a form of depth.
fn depth_folder(form: Form) -> Option<&'static str> {
    match form {
        Form::Png => Some("depth"),
        Form::Npy => Some("depth_npy"),
        Form::Magma => Some("depth_magma"),
        Form::Turbo => Some("depth_turbo"),
        Form::Flo | Form::Wheel => None,
    }
}

/// Where depth and flow of a sequence go.
pub(super) struct Output<'a> {
    pub folder: &'a Path,
    pub forms: &'a Forms,
}

impl Output<'_> {
    /// Makes the folders that will be filled.
    pub fn prepare(&self, depth: bool, flow: bool) -> Result<(), DataError> {
        let mut folders = vec![self.folder.to_owned()];
        if depth {
            folders.extend(self.forms.0.iter().filter_map(|&form| depth_folder(form)).map(|name| self.folder.join(name)));
        }
        if flow && self.forms.of_flow() {
            folders.push(self.flow_folder());
            if self.forms.has(Form::Wheel) {
                folders.push(self.colour_folder());
            }
        }
        folders.iter().try_for_each(|folder| fs::create_dir_all(folder).map_err(|error| DataError::write(folder, error)))
    }

    fn flow_folder(&self) -> PathBuf {
        self.folder.join("flow")
    }

    fn colour_folder(&self) -> PathBuf {
        self.folder.join("flow_colour")
    }

    fn flow_file(&self, name: &str, form: Form) -> PathBuf {
        self.flow_folder().join(format!("{name}.{}", if form == Form::Flo { "flo" } else { "png" }))
    }

    /// Writes a depth `[1, 1, h, w]` in the unit of the files, at the size (width, height) of the frame.
    pub fn write_depth(&self, name: &str, depth: &Tensor<f32>, unit: f64, (width, height): (usize, usize)) -> Result<()> {
        let data = depth.data().iter().map(|z| z * unit as f32).collect();
        let depth = resize_depth(&Map::from_vec(depth.shape().h(), depth.shape().w(), data), height, width)?;
        for &form in &self.forms.0 {
            let Some(folder) = depth_folder(form).map(|name| self.folder.join(name)) else { continue };
            let picture = |scale| {
                let png = Picture::from_inverse_depth(&depth, scale).to_png();
                write_atomic(&folder.join(format!("{name}.png")), &png)
            };
            match form {
                Form::Npy => write_npy(&folder.join(format!("{name}.npy")), &depth)?,
                Form::Magma => picture(Scale::Magma)?,
                Form::Turbo => picture(Scale::Turbo)?,
                _ => {
                    let cut = depth.data.iter().map(|z| z.min(FARTHEST)).collect();
                    write_depth_png(&folder.join(format!("{name}.png")), &Map { data: cut, ..depth })?;
                }
            }
        }
        Ok(())
    }

    /// Writes a flow `[1, 2, h, w]` at the size (width, height) of the frame and gives the length that 95 of 100 of its pixels
    /// keep within.
    pub fn write_flow(&self, name: &str, flow: &Tensor<f32>, size: (usize, usize)) -> Result<f64> {
        let flow = resize_flow(flow, size);
        let known = vec![true; flow.len()];
        let kept = self.forms.kept_flow();
        for form in [Form::Png, Form::Flo].into_iter().filter(|&form| self.forms.has(form) || form == kept) {
            let file = self.flow_file(name, form);
            match form {
                Form::Flo => write_flo(&file, &flow, &known)?,
                _ => write_flow_png(&file, &flow, &known)?,
            }
        }
        let mut lengths: Vec<f64> = flow.u.iter().zip(&flow.v).map(|(u, v)| f64::from(u.hypot(*v))).collect();
        lengths.retain(|length| length.is_finite());
        lengths.sort_unstable_by(f64::total_cmp);
        Ok(lengths.len().checked_sub(1).map_or(0.0, |last| lengths[(0.95 * last as f64).round() as usize]))
    }

    /// Draws the flows of the frames with these names on one scale that holds `longest` pixels, and the legend. Gives the scale.
    pub fn draw_flows(&self, names: &[String], longest: f64) -> Result<Option<f64>> {
        if !self.forms.has(Form::Wheel) || names.is_empty() {
            return Ok(None);
        }
        let (scale, kept) = (round_scale(longest), self.forms.kept_flow());
        let draw = |name: &String| -> Result<(), DataError> {
            let file = self.flow_file(name, kept);
            let KnownFlow { flow, known } = if kept == Form::Flo { read_flo(&file)? } else { read_flow_png(&file)? };
            let picture = Picture::from_flow_by_wheel(&flow, &known, scale);
            write_atomic(&self.colour_folder().join(format!("{name}.png")), &picture.to_png())
        };
        for names in names.chunks(CHUNK) {
            par::map_indices(names.len(), |k| draw(&names[k])).into_iter().collect::<Result<(), _>>()?;
        }
        write_atomic(&self.folder.join("flow_legend.png"), &Picture::flow_legend(scale).to_png())?;
        if !self.forms.has(kept) {
            fs::remove_dir_all(self.flow_folder()).map_err(|error| DataError::write(&self.flow_folder(), error))?;
        }
        Ok(Some(scale))
    }
}

/// Displacements at another size, in its pixels.
fn resize_flow(flow: &Tensor<f32>, (width, height): (usize, usize)) -> FlowMap {
    let (old_height, old_width) = (flow.shape().h(), flow.shape().w());
    let plane = |channel: usize, new: usize, old: usize| {
        let map = Map::from_vec(old_height, old_width, flow.plane(0, channel).to_vec());
        let map = if (old_height, old_width) == (height, width) { map } else { resize_bilinear(&map, height, width) };
        let factor = (new as f64 / old as f64) as f32;
        map.data.into_iter().map(|x| x * factor).collect()
    };
    FlowMap { height, width, u: plane(0, width, old_width), v: plane(1, height, old_height) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;

    fn flow(u: f32, v: f32, (width, height): (usize, usize)) -> Tensor<f32> {
        Tensor::from_fn(Shape::new(1, 2, height, width), |_, c, _, _| if c == 0 { u } else { v })
    }

    #[test]
    fn flow_grows_with_the_frame() {
        let resized = resize_flow(&flow(2.0, -3.0, (4, 6)), (8, 18));
        assert_eq!((resized.width, resized.height, resized.u.len()), (8, 18, 144));
        assert!(resized.u.iter().all(|u| *u == 4.0) && resized.v.iter().all(|v| *v == -9.0));
    }

    #[test]
    fn only_what_is_asked_for_is_there_at_the_end() {
        for (forms, expected) in [
            (vec![Form::Wheel], &["flow_colour", "flow_legend.png"][..]),
            (vec![Form::Flo, Form::Wheel], &["flow", "flow_colour", "flow_legend.png"]),
            (vec![Form::Flo], &["flow"]),
            (vec![Form::Npy, Form::Turbo], &["depth_npy", "depth_turbo"]),
        ] {
            let place = tempfile::tempdir().unwrap();
            let forms = Forms(forms);
            let output = Output { folder: place.path(), forms: &forms };
            output.prepare(true, true).unwrap();
            output.write_depth("a", &Tensor::full(Shape::new(1, 1, 4, 4), 0.5), 10.0, (8, 4)).unwrap();
            if forms.of_flow() {
                let longest = output.write_flow("a", &flow(3.0, 4.0, (4, 4)), (4, 4)).unwrap();
                assert!((longest - 5.0).abs() < 1e-6);
                let scale = output.draw_flows(&["a".to_owned()], longest).unwrap();
                assert_eq!(scale, forms.has(Form::Wheel).then_some(6.0));
            }
            let mut found: Vec<String> =
                fs::read_dir(place.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
            found.sort();
            assert_eq!(found, expected, "{forms:?}");
        }
    }

    #[test]
    fn both_forms_of_flow_hold_the_same() {
        let place = tempfile::tempdir().unwrap();
        let forms = Forms(vec![Form::Png, Form::Flo]);
        let output = Output { folder: place.path(), forms: &forms };
        output.prepare(false, true).unwrap();
        output.write_flow("a", &flow(1.5, -0.25, (4, 4)), (4, 4)).unwrap();
        let [png, flo] = [read_flow_png(&output.flow_file("a", Form::Png)), read_flo(&output.flow_file("a", Form::Flo))];
        assert_eq!(png.unwrap(), flo.unwrap());
        assert!(!place.path().join("depth").exists());
    }
}

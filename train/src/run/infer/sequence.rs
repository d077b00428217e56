//! One sequence from frames to files.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use dimode_autodiff::{Tensor, par};
use dimode_geometry::{Intrinsics, Se3, Trajectory};

use super::SequenceSummary;
use super::networks::Networks;
use super::output::{Forms, Output};
use super::speed::Clocks;
use crate::data::{DataError, Dataset, View};
use crate::report::write_trajectory;

/// Frames that are read, and written, at a time.
const CHUNK: usize = 8;

/// A sequence, what looks at it, and where the result goes.
pub(super) struct Sequence<'a> {
    pub networks: &'a Networks,
    pub forms: &'a Forms,
    pub dataset: &'a dyn Dataset,
    pub number: usize,
    pub folder: &'a Path,
}

/// A frame as the networks see it.
struct Seen {
    name: String,
    image: Tensor<f32>,
    camera: Intrinsics,
    /// (width, height) of what is written.
    size: (usize, usize),
}

/// What the networks said of a frame.
struct Said {
    name: String,
    size: (usize, usize),
    depth: Option<Tensor<f32>>,
    flow: Option<Tensor<f32>>,
}

/// What is found on the way through a sequence.
#[derive(Default)]
struct Found {
    clocks: Clocks,
    steps: Vec<Se3>,
    /// Frames with a flow.
    flows: Vec<String>,
    /// Length that nearly all displacements keep within.
    longest: f64,
}

impl Sequence<'_> {
    /// Predicts and writes; `done` is told of every frame.
    pub fn write(&self, done: &mut dyn FnMut() -> Result<()>) -> Result<SequenceSummary> {
        let begin = Instant::now();
        let Networks { writes_depth, writes_flow, unit, .. } = *self.networks;
        let output = Output { folder: self.folder, forms: self.forms };
        let len = self.dataset.sequence_len(self.number);
        // The last frame has no flow.
        output.prepare(writes_depth, writes_flow && len > 1)?;
        let (mut found, mut seen) = (Found::default(), Vec::new());
        for start in (0..len).step_by(CHUNK) {
            // One frame more than is shown: the motion into the next chunk.
            let end = (start + CHUNK + 1).min(len);
            seen.extend(self.read(start + seen.len(), end)?);
            let shown = CHUNK.min(len - start);
            let said = (0..shown).map(|k| {
                let said = self.look(&seen[k], seen.get(k + 1), &mut found);
                done().map(|()| said)
            });
            let said = said.collect::<Result<Vec<_>>>()?;
            self.write_chunk(&output, &said, &mut found)?;
            seen.drain(..shown);
        }
        let flow_scale = output.draw_flows(&found.flows, found.longest)?;
        let path_length = if self.networks.writes_motion { Some(self.write_trajectory(&mut found.steps)?) } else { None };
        let speed = found.clocks.speed(self.networks.size(), len, begin.elapsed());
        Ok(SequenceSummary { name: self.dataset.sequence_name(self.number), frames: len, path_length, unit, flow_scale, speed })
    }

    /// The frames of a range, made to fit the networks.
    fn read(&self, start: usize, end: usize) -> Result<Vec<Seen>, DataError> {
        let (width, height) = self.networks.size();
        let cropped = self.networks.trained.config.data.center_crop;
        let frames = par::map_indices(end.saturating_sub(start), |k| {
            let frame = self.dataset.frame(self.number, start + k)?;
            let view = View::new(frame.image.clone(), frame.intrinsics, None);
            let view = if cropped { view.center_crop_to_shape(width, height) } else { view };
            let size = (view.image.width, view.image.height);
            let fitted = view.resize(width, height);
            let image = Tensor::from_vec(self.networks.shape(), fitted.image.data);
            Ok(Seen { name: frame.name.clone(), image, camera: fitted.intrinsics, size })
        });
        frames.into_iter().collect()
    }

    /// All networks on one frame and the next.
    fn look(&self, frame: &Seen, next: Option<&Seen>, found: &mut Found) -> Said {
        let (networks, clocks) = (self.networks, &mut found.clocks);
        par::awake(|| {
            let depth = networks.needs_depth().then(|| clocks.depth.time(|| networks.depth(&frame.image)));
            let mut flow = None;
            if let Some(next) = next {
                let pair = [&frame.image, &next.image];
                if networks.writes_motion {
                    found.steps.push(clocks.pose.time(|| networks.motion(pair, depth.as_ref(), frame.camera)));
                }
                flow = networks.writes_flow.then(|| clocks.flow.time(|| networks.flow(pair)));
            }
            let depth = depth.filter(|_| networks.writes_depth);
            Said { name: frame.name.clone(), size: frame.size, depth, flow }
        })
    }

    fn write_chunk(&self, output: &Output, said: &[Said], found: &mut Found) -> Result<()> {
        let longest = par::map_indices(said.len(), |k| -> Result<Option<f64>> {
            let Said { name, size, depth, flow } = &said[k];
            if let Some(depth) = depth.as_ref().filter(|_| self.forms.of_depth()) {
                output.write_depth(name, depth, self.networks.unit, *size)?;
            }
            let flow = flow.as_ref().filter(|_| self.forms.of_flow());
            flow.map(|flow| output.write_flow(name, flow, *size)).transpose()
        });
        for (said, longest) in said.iter().zip(longest) {
            if let Some(longest) = longest? {
                found.longest = found.longest.max(longest);
                found.flows.push(said.name.clone());
            }
        }
        Ok(())
    }

    /// Writes the path of the steps, in the unit of the depth files, and gives its length.
    fn write_trajectory(&self, steps: &mut [Se3]) -> Result<f64> {
        steps.iter_mut().for_each(|step| step.translation *= self.networks.unit);
        let mut trajectory = Trajectory::accumulate(steps);
        if let Some(times) = self.dataset.times(self.number) {
            for (pose, &time) in trajectory.poses.iter_mut().zip(times) {
                pose.stamp = Some(time);
            }
        }
        write_trajectory(self.folder, "trajectory", &trajectory)?;
        Ok(trajectory.path_length())
    }
}

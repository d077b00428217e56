//! Motion rows: the trained network beside zero motion and the mean training motion, all on the same sequences.

use dimode_geometry::{Se3, Trajectory};
use serde::Serialize;

use super::motion::{MotionErrors, follow, motion_errors, steps_of};
use super::odometry::{OdometryErrors, OdometryProtocol, evaluate_odometry, mean};
use super::trivial::MeanMotion;
use super::{EvalError, Ratio, RowKind};

/// Errors of the trajectory of one sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequenceErrors {
    /// Name of the sequence.
    pub sequence: String,
    /// The numbers.
    #[serde(flatten)]
    pub errors: OdometryErrors,
}

/// A sequence whose trajectory could not be aligned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unavailable {
    /// Name of the sequence.
    pub sequence: String,
    /// Why.
    pub reason: String,
}

/// Trajectory errors over sequences: plain means of the per-sequence values that are available.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct OdometrySummary {
    /// Mean of e_t over sequences, percent.
    pub e_t_percent: Option<f64>,
    /// Mean of e_r over sequences, degrees per 100 m.
    pub e_r_deg_per_100m: Option<f64>,
    /// Mean of the absolute trajectory error over sequences, metres.
    pub ate_m: Option<f64>,
    /// e_t over all sub-sequences of all sequences, which weighs long sequences more.
    pub pooled_e_t_percent: Option<f64>,
    /// e_r over all sub-sequences of all sequences.
    pub pooled_e_r_deg_per_100m: Option<f64>,
    /// Sub-sequences of all sequences.
    pub segments: usize,
    /// Each sequence.
    pub per_sequence: Vec<SequenceErrors>,
    /// Sequences without a result.
    pub unavailable: Vec<Unavailable>,
}

impl OdometrySummary {
    fn summarise(&mut self) {
        let all = &self.per_sequence;
        let average = |get: fn(&OdometryErrors) -> Option<f64>| mean(all.iter().filter_map(|s| get(&s.errors)));
        let segments: usize = all.iter().map(|s| s.errors.segments).sum();
        let pooled = |get: fn(&OdometryErrors) -> Option<f64>| {
            let parts = all.iter().filter_map(|s| Some(get(&s.errors)? * s.errors.segments as f64));
            (segments > 0).then(|| parts.sum::<f64>() / segments as f64)
        };
        self.e_t_percent = average(|e| e.e_t_percent);
        self.e_r_deg_per_100m = average(|e| e.e_r_deg_per_100m);
        self.ate_m = average(|e| Some(e.ate_m));
        self.pooled_e_t_percent = pooled(|e| e.e_t_percent);
        self.pooled_e_r_deg_per_100m = pooled(|e| e.e_r_deg_per_100m);
        self.segments = segments;
    }
}

/// One row of the motion table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionRow {
    /// Name of the row.
    pub name: String,
    /// Trained or trivial.
    pub kind: RowKind,
    /// Frame-to-frame errors over the pairs of all sequences.
    pub frame_to_frame: MotionErrors,
    /// Errors of whole trajectories.
    pub odometry: OdometrySummary,
}

/// All motion rows, made on the same sequences with the same protocol.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionTable {
    /// How the trajectory numbers were made.
    pub protocol: OdometryProtocol,
    /// In which frame translation directions are compared.
    pub direction_frame: &'static str,
    /// Sequences.
    pub sequences: usize,
    /// Frame pairs of all sequences.
    pub pairs: usize,
    /// The trained row first, then the trivial rows.
    pub rows: Vec<MotionRow>,
    /// Trained row against the best trivial row.
    pub ratios: Vec<Ratio>,
}

/// What a row predicts.
#[derive(Clone, Debug)]
enum Predictor {
    Given,
    Always(Se3),
}

#[derive(Clone, Debug)]
struct RowBuilder {
    name: String,
    predictor: Predictor,
    predicted: Vec<Se3>,
    odometry: OdometrySummary,
}

/// Feeds every sequence to the trained row and to the trivial rows.
#[derive(Clone, Debug)]
pub struct MotionTableBuilder {
    protocol: OdometryProtocol,
    truth: Vec<Se3>,
    sequences: usize,
    rows: Vec<RowBuilder>,
}

impl MotionTableBuilder {
    /// A table with one trained row called `name`, a row that never moves, and, when the training motions are known, a row
    /// of their mean.
    pub fn new(name: impl Into<String>, protocol: OdometryProtocol, mean_motion: Option<MeanMotion>) -> Self {
        let row =
            |name: String, predictor| RowBuilder { name, predictor, predicted: Vec::new(), odometry: OdometrySummary::default() };
        let mut rows = vec![row(name.into(), Predictor::Given), row("zero motion".into(), Predictor::Always(Se3::identity()))];
        if let Some(mean) = mean_motion {
            let always = Predictor::Always(mean.motion());
            rows.push(row("mean training motion".into(), always));
        }
        Self { protocol, truth: Vec::new(), sequences: 0, rows }
    }

    /// Adds one sequence: `steps[k]` is the predicted `source_from_target` with true pose k as target and k + 1 as source;
    /// `truth` holds `world_from_camera` in order.
    ///
    /// **Errors** when the counts do not fit or a value is not finite. A trajectory that cannot be aligned (a row that
    /// stands still) is noted in the row instead.
    pub fn add_sequence(&mut self, sequence: &str, steps: &[Se3], truth: &Trajectory) -> Result<(), EvalError> {
        let true_steps = steps_of(truth);
        motion_errors(steps, &true_steps)?;
        for row in &mut self.rows {
            let predicted = match row.predictor {
                Predictor::Given => steps.to_vec(),
                Predictor::Always(motion) => vec![motion; true_steps.len()],
            };
            let trajectory = follow(&predicted, truth)?;
            row.predicted.extend(predicted);
            let sequence = sequence.to_owned();
            match evaluate_odometry(&trajectory, truth, &self.protocol) {
                Ok(errors) => row.odometry.per_sequence.push(SequenceErrors { sequence, errors }),
                Err(EvalError::Degenerate { reason }) => {
                    row.odometry.unavailable.push(Unavailable { sequence, reason });
                }
                Err(other) => return Err(other),
            }
        }
        self.truth.extend(true_steps);
        self.sequences += 1;
        Ok(())
    }

    /// The table. **Errors** when no sequence was added.
    pub fn finish(self) -> Result<MotionTable, EvalError> {
        let mut rows = Vec::new();
        for mut row in self.rows {
            row.odometry.summarise();
            rows.push(MotionRow {
                kind: match row.predictor {
                    Predictor::Given => RowKind::Trained,
                    Predictor::Always(_) => RowKind::Trivial,
                },
                name: row.name,
                frame_to_frame: motion_errors(&row.predicted, &self.truth)?,
                odometry: row.odometry,
            });
        }
        Ok(MotionTable {
            protocol: self.protocol,
            direction_frame: "source camera",
            sequences: self.sequences,
            pairs: self.truth.len(),
            ratios: ratios(&rows),
            rows,
        })
    }
}

fn ratios(rows: &[MotionRow]) -> Vec<Ratio> {
    let of = |metric: &'static str, get: fn(&MotionRow) -> Option<f64>| {
        Ratio::of(metric, rows.iter().map(|row| (row.name.as_str(), row.kind, get(row))))
    };
    [
        of("rotation_mean_deg", |r| Some(r.frame_to_frame.rotation_mean_deg)),
        of("rotation_median_deg", |r| Some(r.frame_to_frame.rotation_median_deg)),
        of("direction_mean_deg", |r| r.frame_to_frame.direction_mean_deg),
        of("direction_median_deg", |r| r.frame_to_frame.direction_median_deg),
        of("e_t_percent", |r| r.odometry.e_t_percent),
        of("e_r_deg_per_100m", |r| r.odometry.e_r_deg_per_100m),
        of("ate_m", |r| r.odometry.ate_m),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn drive(count: usize, turn: f64) -> Vec<Se3> {
        (0..count)
            .map(|i| {
                let w = Vector3::new(0.0, turn * (0.3 * i as f64).sin(), 0.0);
                Se3::from_rotation_vector(&w, Vector3::new(0.0, 0.0, -1.0))
            })
            .collect()
    }

    fn table(predicted: &[Se3]) -> MotionTable {
        let truth = drive(60, 0.1);
        let mean = MeanMotion::fit(&truth).unwrap();
        let mut builder = MotionTableBuilder::new("dimode", OdometryProtocol::small_world(), Some(mean));
        builder.add_sequence("one", predicted, &Trajectory::accumulate(&truth)).unwrap();
        builder.finish().unwrap()
    }

    #[test]
    fn the_truth_beats_the_trivial_rows() {
        let table = table(&drive(60, 0.1));
        assert_eq!((table.sequences, table.pairs, table.rows.len()), (1, 60, 3));
        let names: Vec<&str> = table.rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, ["dimode", "zero motion", "mean training motion"]);
        let ratio = |metric: &str| table.ratios.iter().find(|r| r.metric == metric).unwrap();
        assert!(ratio("rotation_mean_deg").ratio < 1e-9);
        assert!(ratio("ate_m").ratio < 1e-6);
        assert_eq!(ratio("direction_mean_deg").best_row, "mean training motion");
    }

    #[test]
    fn zero_motion_has_rotation_errors_but_no_direction_and_no_alignment() {
        let table = table(&drive(60, 0.2));
        let zero = &table.rows[1];
        assert_eq!(zero.frame_to_frame.direction_mean_deg, None);
        assert_eq!(zero.odometry.ate_m, None);
        assert_eq!(zero.odometry.unavailable.len(), 1);
        let mean_turn = (0..60).map(|i| (0.1 * (0.3 * f64::from(i)).sin()).abs()).sum::<f64>() / 60.0;
        assert!((zero.frame_to_frame.rotation_mean_deg - mean_turn.to_degrees()).abs() < 1e-9);
        assert!(table.rows[0].frame_to_frame.direction_mean_deg.unwrap() < 1e-9);
    }

    #[test]
    fn wrong_counts_are_refused() {
        let truth = Trajectory::accumulate(&drive(10, 0.1));
        let mut builder = MotionTableBuilder::new("dimode", OdometryProtocol::small_world(), None);
        let error = builder.add_sequence("one", &drive(9, 0.1), &truth).unwrap_err();
        assert!(error.to_string().contains("9 predicted, but 10"));
        assert!(MotionTableBuilder::new("x", OdometryProtocol::default(), None).finish().is_err());
    }
}

//! What a network costs: parameters, multiply-accumulates, bytes on the disk, time and memory of a forward pass.

mod table;

use std::time::Instant;

use dimode_autodiff::{Pool, Shape, Tape, Tensor, par};
use dimode_nets::{
    Binder, DepthNet, FlowNet, FlowOptions, Kind, NetKind, ParamSet, PoseNet, UnfitSize, WeightError, fill, weights,
};
use serde::Serialize;

use crate::inference::{self, Buffers};
use crate::progress::Progress;

/// What to count and how.
#[derive(Clone, Debug)]
pub struct CostRequest {
    /// The networks.
    pub networks: Vec<NetKind>,
    /// Columns of the images.
    pub width: usize,
    /// Rows of the images.
    pub height: usize,
    /// Refinements of the flow; each network's own number without.
    pub iterations: Option<usize>,
    /// Timed forward passes of each network; none for no time at all.
    pub runs: usize,
}

/// What the tensors of one checkpoint file cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileCost {
    /// Name of the file without extension.
    pub file: String,
    /// Numbers in tensors that are parameters, used or not, trained or frozen.
    pub parameters: usize,
    /// Bytes of the safetensors file in single precision.
    pub bytes: usize,
    /// Multiply-accumulates of one forward pass, batch 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub macs: Option<u64>,
}

/// What one network costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NetworkCost {
    /// Role and name.
    pub network: String,
    /// All files together.
    pub parameters: usize,
    /// All files together.
    pub bytes: usize,
    /// Its checkpoint files.
    pub files: Vec<FileCost>,
    /// What a forward pass costs, or why there is none.
    #[serde(flatten)]
    pub pass: Pass,
}

/// A forward pass of a network, as far as it is possible at the size.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pass {
    /// What it costs.
    Forward(ForwardCost),
    /// The network does not take images of this size.
    Unfit(String),
}

/// What one forward pass costs: one image, or one pair of images for pose and flow.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ForwardCost {
    /// Multiply-accumulates of convolutions and matrix products as the network is defined.
    pub macs: u64,
    /// Refinements of the flow and the multiply-accumulates of each.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<Iterations>,
    /// Time and memory, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<Time>,
}

/// Refinements of a flow network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Iterations {
    /// How many.
    pub count: usize,
    /// Multiply-accumulates of each.
    pub macs_each: u64,
}

/// Time and memory of forward passes without gradients, after one to warm up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Time {
    /// The middle one of the times, seconds.
    pub median_seconds: f64,
    /// All times in order, seconds.
    pub seconds: Vec<f64>,
    /// Images, or pairs, in a second.
    pub frames_per_second: f64,
    /// Most bytes of the activations at one time; weights and images are not counted.
    pub peak_bytes: usize,
}

/// What all networks of a request cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CostReport {
    /// Columns of the images.
    pub width: usize,
    /// Rows of the images.
    pub height: usize,
    /// Threads of the timed passes.
    pub threads: usize,
    /// The networks.
    pub networks: Vec<NetworkCost>,
}

/// Counts, and times the networks one after another with weights and images that are drawn.
///
/// **Errors** [`WeightError`] when weights have no form as a file.
pub fn cost(request: &CostRequest, progress: &dyn Progress) -> Result<CostReport, WeightError> {
    progress.start(request.networks.len() as u64, "networks");
    let networks = request.networks.iter().enumerate().map(|(i, &network)| {
        let found = network_cost(network, request);
        progress.step(i as u64 + 1, &network.to_string());
        found
    });
    let networks = networks.collect::<Result<Vec<_>, _>>();
    progress.finish();
    let CostRequest { width, height, .. } = *request;
    Ok(CostReport { width, height, threads: par::threads(), networks: networks? })
}

fn network_cost(kind: NetKind, request: &CostRequest) -> Result<NetworkCost, WeightError> {
    let weights = kind.blueprint().init::<f32>(1);
    let mut files = weights.files().map(|(file, tensors)| {
        let parameters = tensors.iter().filter(|(_, entry)| entry.kind() != Kind::Buffer);
        let parameters = parameters.map(|(_, entry)| entry.tensor().shape().len()).sum();
        Ok(FileCost { file: file.to_owned(), parameters, bytes: weights::to_bytes(tensors)?.len(), macs: None })
    });
    let mut files = files.by_ref().collect::<Result<Vec<_>, WeightError>>()?;
    let subject = Subject::new(kind, &weights, request);
    let pass = match subject {
        Err(unfit) => Pass::Unfit(unfit.to_string()),
        Ok(subject) => {
            let macs = subject.macs(subject.iterations);
            files.iter_mut().zip(&macs).for_each(|(file, &macs)| file.macs = Some(macs));
            Pass::Forward(ForwardCost {
                macs: macs.iter().sum(),
                iterations: subject.iterations.map(|count| subject.each_of(count)),
                time: (request.runs > 0).then(|| subject.time(request.runs)),
            })
        }
    };
    let sum = |of: fn(&FileCost) -> usize| files.iter().map(of).sum();
    let (parameters, bytes) = (sum(|file| file.parameters), sum(|file| file.bytes));
    Ok(NetworkCost { network: kind.to_string(), parameters, bytes, files, pass })
}

/// A network with what it looks at.
struct Subject<'a> {
    net: Net,
    weights: &'a ParamSet<f32>,
    images: [Tensor<f32>; 2],
    /// Refinements of a flow network.
    iterations: Option<usize>,
}

enum Net {
    Depth(DepthNet),
    Pose(PoseNet),
    Flow(Box<FlowNet>),
}

impl<'a> Subject<'a> {
    fn new(kind: NetKind, weights: &'a ParamSet<f32>, request: &CostRequest) -> Result<Self, UnfitSize> {
        let shape = Shape::new(1, 3, request.height, request.width);
        kind.check_size(shape.h(), shape.w())?;
        let (net, iterations) = match kind {
            NetKind::Depth(kind) => (Net::Depth(DepthNet::new(kind.config_for(shape.h(), shape.w()))), None),
            NetKind::Pose(kind) => (Net::Pose(PoseNet::new(kind.config())), None),
            NetKind::Flow(kind) => {
                let config = kind.config();
                let iterations = request.iterations.unwrap_or(config.iterations);
                (Net::Flow(Box::new(FlowNet::new(config))), Some(iterations))
            }
        };
        let image = |name: &str| {
            let value = |i| (0.5 + 0.5 * fill::unit(name, i)) as f32;
            Tensor::from_vec(shape, (0..shape.len()).map(value).collect())
        };
        Ok(Self { net, weights, images: [image("first"), image("second")], iterations })
    }

    /// Multiply-accumulates of each file.
    fn macs(&self, iterations: Option<usize>) -> Vec<u64> {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, self.weights);
        let [first, second] = self.images.each_ref().map(|image| tape.constant(image.clone()));
        match &self.net {
            Net::Depth(net) => drop(net.forward(&mut binder, first)),
            Net::Pose(net) => drop(net.forward(&mut binder, first, second)),
            Net::Flow(net) => {
                let options = FlowOptions { iterations, last_only: true, ..FlowOptions::default() };
                drop(net.trace(&mut binder, first, second, &options));
            }
        }
        binder.macs_by_file()
    }

    /// Every refinement costs the same.
    fn each_of(&self, count: usize) -> Iterations {
        let [one, two] = [1, 2].map(|iterations| self.macs(Some(iterations)).iter().sum::<u64>());
        Iterations { count, macs_each: two - one }
    }

    fn time(&self, runs: usize) -> Time {
        let buffers = Pool::new();
        par::awake(|| {
            self.infer(&buffers);
            let run = |_| {
                let begin = Instant::now();
                self.infer(&buffers);
                begin.elapsed().as_secs_f64()
            };
            let seconds: Vec<f64> = (0..runs).map(run).collect();
            let median_seconds = median(&seconds);
            Time { median_seconds, frames_per_second: 1.0 / median_seconds, peak_bytes: buffers.peak_bytes(), seconds }
        })
    }

    fn infer(&self, buffers: &Buffers) {
        let [first, second] = &self.images;
        match &self.net {
            Net::Depth(net) => drop(inference::disparity(net, self.weights, first, buffers)),
            Net::Pose(net) => drop(inference::pose(net, self.weights, [first, second], buffers)),
            Net::Flow(net) => {
                let iterations = self.iterations.unwrap_or(net.config().iterations);
                drop(inference::flow(net, self.weights, [first, second], iterations, buffers));
            }
        }
    }
}

/// The middle one, or the mean of the middle two.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    if sorted.len().is_multiple_of(2) { 0.5 * (sorted[middle - 1] + sorted[middle]) } else { sorted[middle] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    fn report(names: &[&str], (width, height): (usize, usize), runs: usize) -> CostReport {
        let networks = names.iter().map(|name| name.parse().unwrap()).collect();
        cost(&CostRequest { networks, width, height, iterations: None, runs }, &Silent).unwrap()
    }

    fn forward(cost: &NetworkCost) -> &ForwardCost {
        match &cost.pass {
            Pass::Forward(forward) => forward,
            Pass::Unfit(why) => panic!("{}: {why}", cost.network),
        }
    }

    #[test]
    fn nano_networks_cost_what_published_tables_say() {
        let report = report(&["depth:nano_resnet", "pose:nano", "nano_raft"], (96, 64), 0);
        let found: Vec<(usize, String)> =
            report.networks.iter().map(|cost| (cost.parameters, format!("{:.2}", forward(cost).macs as f64 / 1e6))).collect();
        let expected = [(134_204, "13.19"), (394_700, "13.62"), (151_810, "68.32")];
        assert_eq!(found, expected.map(|(parameters, macs)| (parameters, macs.to_owned())));
        let depth = &report.networks[0];
        assert_eq!(depth.files.iter().map(|file| file.parameters).collect::<Vec<_>>(), [78_312, 55_892]);
        assert_eq!(depth.files.iter().filter_map(|file| file.macs).sum::<u64>(), forward(depth).macs);
        assert!(depth.bytes > 4 * 134_204 && depth.bytes < 5 * 134_204);
        assert!(report.networks.iter().all(|cost| forward(cost).time.is_none()));
    }

    #[test]
    fn refinements_add_up() {
        let of = |iterations| {
            let request = CostRequest {
                networks: vec!["nano_raft_d4".parse().unwrap()],
                width: 64,
                height: 64,
                iterations: Some(iterations),
                runs: 0,
            };
            let report = cost(&request, &Silent).unwrap();
            forward(&report.networks[0]).clone()
        };
        let (three, seven) = (of(3), of(7));
        let each = three.iterations.unwrap();
        assert_eq!((each.count, each.macs_each), (3, seven.iterations.unwrap().macs_each));
        assert_eq!(seven.macs - three.macs, 4 * each.macs_each);
    }

    #[test]
    fn passes_are_timed_and_their_memory_is_told() {
        let report = report(&["depth:nano_resnet"], (96, 64), 3);
        let time = forward(&report.networks[0]).time.clone().unwrap();
        assert_eq!(time.seconds.len(), 3);
        assert!(time.seconds.contains(&time.median_seconds) && time.median_seconds > 0.0);
        assert!((time.frames_per_second * time.median_seconds - 1.0).abs() < 1e-12);
        // The finest disparity alone is 24 KiB.
        assert!(time.peak_bytes > 4 * 96 * 64 && time.peak_bytes < 16 << 20, "{}", time.peak_bytes);
    }

    #[test]
    fn sizes_that_do_not_fit_are_told_and_parameters_still_counted() {
        let report = report(&["depth:resnet18"], (100, 64), 3);
        assert_eq!(report.networks[0].parameters, 11_689_512 + 3_152_724);
        assert!(matches!(&report.networks[0].pass, Pass::Unfit(why) if why.contains("100x64")));
    }

    #[test]
    fn the_middle_of_even_and_odd_numbers() {
        assert_eq!([median(&[3.0, 1.0, 2.0]), median(&[4.0, 1.0, 2.0, 8.0])], [2.0, 3.0]);
    }
}

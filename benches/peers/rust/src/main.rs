//! Convolutions of candle and burn, forward and with both gradients, behind the same requests as `../server.py`: one JSON object a
//! line on stdin, one JSON line each on stdout.
//!
//! `variant.library` of a request is `candle`, `burn-ndarray` or `burn-flex`. The number of threads is that of the environment
//! variable `RAYON_NUM_THREADS`, which both libraries read once.

mod burn;
mod candle;

use std::collections::HashMap;
use std::fs;
use std::io::{BufRead, Write, stdin, stdout};
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;
use serde_json::{Value, json};

/// Repetitions of one request at least and at most, after two that warm up.
const FEWEST: usize = 3;
const MOST: usize = 300;

/// Sizes of a convolution with square kernel, zero padding and bias.
#[derive(Clone, Debug, Deserialize)]
struct Sizes {
    name: String,
    batch: usize,
    inputs: usize,
    outputs: usize,
    height: usize,
    width: usize,
    kernel: usize,
    stride: usize,
    padding: usize,
    dilation: usize,
    groups: usize,
}

impl Sizes {
    fn input(&self) -> [usize; 4] {
        [self.batch, self.inputs, self.height, self.width]
    }

    fn weight(&self) -> [usize; 4] {
        [self.outputs, self.inputs / self.groups, self.kernel, self.kernel]
    }

    fn output(&self) -> [usize; 4] {
        let size = |n: usize| (n + 2 * self.padding - self.dilation * (self.kernel - 1) - 1) / self.stride + 1;
        [self.batch, self.outputs, size(self.height), size(self.width)]
    }
}

/// The numbers of a convolution.
struct Numbers {
    x: Vec<f32>,
    weight: Vec<f32>,
    bias: Vec<f32>,
    gy: Vec<f32>,
}

/// A convolution that is ready to run.
trait Conv {
    /// The output.
    fn forward(&self) -> Result<Vec<f32>>;
    /// Forward without reading the output.
    fn run_forward(&self) -> Result<()>;
    /// Forward and backward from `gy`; the gradients of input, weight and bias where `read`.
    fn run_forward_backward(&self, read: bool) -> Result<Vec<Vec<f32>>>;
}

fn main() -> Result<()> {
    let mut built: HashMap<String, Box<dyn Conv>> = HashMap::new();
    for line in stdin().lock().lines() {
        let reply = answer(&line?, &mut built).unwrap_or_else(|error| json!({"error": format!("{error:#}")}));
        println!("{reply}");
        stdout().flush()?;
    }
    Ok(())
}

fn answer(line: &str, built: &mut HashMap<String, Box<dyn Conv>>) -> Result<Value> {
    let request: Value = serde_json::from_str(line)?;
    let text = |key: &str| request[key].as_str().with_context(|| format!("the request has no {key}"));
    match text("do")? {
        "hello" => Ok(json!({"torch": "candle 0.11, burn 0.21"})),
        "forget" => {
            built.clear();
            Ok(json!({}))
        }
        "build" => {
            let sizes: Sizes = serde_json::from_value(request["case"].clone())?;
            let folder = Path::new(text("dir")?).join(&sizes.name);
            let library = request["variant"]["library"].as_str().context("the variant has no library")?;
            let conv = build(library, &sizes, &folder.join("inputs"))?;
            let results = folder.join(text("key")?);
            fs::create_dir_all(&results)?;
            write(&results.join("y.bin"), &conv.forward()?)?;
            for (name, gradient) in ["grad_x", "grad_weight", "grad_bias"].iter().zip(conv.run_forward_backward(true)?) {
                write(&results.join(format!("{name}.bin")), &gradient)?;
            }
            built.insert(text("key")?.to_owned(), conv);
            Ok(json!({"values": {}}))
        }
        "time" => {
            let conv = built.get(text("key")?).context("nothing was built under this key")?;
            let seconds = request["seconds"].as_f64().context("the request has no seconds")?;
            Ok(json!({"samples": measure(conv.as_ref(), text("what")?, seconds)?}))
        }
        other => bail!("no request '{other}'"),
    }
}

fn build(library: &str, sizes: &Sizes, inputs: &Path) -> Result<Box<dyn Conv>> {
    let tensor = |name: &str, shape: &[usize]| read(&inputs.join(format!("{name}.bin")), shape.iter().product());
    let numbers = Numbers {
        x: tensor("x", &sizes.input())?,
        weight: tensor("weight", &sizes.weight())?,
        bias: tensor("bias", &[sizes.outputs])?,
        gy: tensor("gy", &sizes.output())?,
    };
    match library {
        "candle" => Ok(Box::new(candle::Candle::new(sizes, numbers)?)),
        "burn-ndarray" => Ok(Box::new(burn::Burn::<burn_ndarray::NdArray<f32>>::new(sizes, numbers))),
        "burn-flex" => Ok(Box::new(burn::Burn::<burn_flex::Flex>::new(sizes, numbers))),
        _ => bail!("no library '{library}'"),
    }
}

/// Milliseconds of each repetition.
fn measure(conv: &dyn Conv, what: &str, seconds: f64) -> Result<Vec<f64>> {
    let run = || match what {
        "forward" => conv.run_forward(),
        "forward_backward" => conv.run_forward_backward(false).map(drop),
        _ => bail!("nothing called '{what}'"),
    };
    for _ in 0..2 {
        run()?;
    }
    let (start, mut samples) = (Instant::now(), Vec::new());
    while samples.len() < FEWEST || (start.elapsed().as_secs_f64() < seconds && samples.len() < MOST) {
        let before = Instant::now();
        run()?;
        samples.push(1e3 * before.elapsed().as_secs_f64());
    }
    Ok(samples)
}

fn read(path: &Path, len: usize) -> Result<Vec<f32>> {
    let bytes = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(bytes.len() == 4 * len, "{}: {} bytes, not {}", path.display(), bytes.len(), 4 * len);
    Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn write(path: &Path, numbers: &[f32]) -> Result<()> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    Ok(fs::write(path, bytes)?)
}

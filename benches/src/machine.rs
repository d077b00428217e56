//! What the machine can do: multiply-adds in registers, bytes to and from memory, and how much memory this process took.

use std::fs;
use std::time::Instant;

use dimode_autodiff::par;
use dimode_autodiff::simd::Wide;
use pulp::{Arch, Simd, WithSimd};

/// Independent sums: more than the latency of a multiply-add times the two that start in a cycle.
const SUMS: usize = 12;
/// Multiply-adds of one run in each sum.
const STEPS: usize = 1 << 20;

struct MultiplyAdds;

impl WithSimd for MultiplyAdds {
    /// Something that depends on all sums, and the floating-point operations done.
    type Output = (f32, f64);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f32, f64) {
        // Factor and summand keep the sums near 1 for ever.
        let (factor, summand) = (std::hint::black_box(0.999_f32), std::hint::black_box(0.001_f32));
        let (factor, summand) = (Wide::<S, f32>::splat(simd, factor), Wide::<S, f32>::splat(simd, summand));
        let mut sums = [Wide::<S, f32>::splat(simd, 1.0); SUMS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = sum.mul_add(factor, summand);
            }
        }
        let total = sums.into_iter().fold(0.0, |total, sum| total + sum.sum());
        (total, (2 * STEPS * SUMS * Wide::<S, f32>::lanes()) as f64)
    }
}

/// Most f32 operations a second of the threads of the current pool, each multiply-add counted twice: sums in registers only.
pub fn multiply_add_peak() -> f64 {
    let threads = par::threads();
    let run = || {
        let start = Instant::now();
        let done: Vec<_> = par::map_indices(threads, |_| Arch::new().dispatch(MultiplyAdds));
        let flops: f64 = done.iter().map(|(total, flops)| flops * f64::from(u8::from(total.is_finite()))).sum();
        flops / start.elapsed().as_secs_f64()
    };
    (0..5).map(|_| run()).fold(0.0, f64::max)
}

/// Bytes a second that `a = b + s c` moves over arrays of `bytes` each, written lines counted once more for their reading: the
/// bandwidth of the level of memory where three such arrays fit.
pub fn triad_bandwidth(bytes: usize) -> f64 {
    let len = bytes / 4;
    let (mut a, b, c) = (vec![0.0_f32; len], vec![1.0_f32; len], vec![2.0_f32; len]);
    let chunk = len.div_ceil(par::threads() * 4);
    let repetitions = (64_usize << 20).div_ceil(bytes).max(1);
    let mut run = |scale: f32| {
        let start = Instant::now();
        for _ in 0..repetitions {
            par::for_each_chunk(&mut a, chunk, |i, a| {
                let from = i * chunk;
                for ((a, b), c) in a.iter_mut().zip(&b[from..]).zip(&c[from..]) {
                    *a = b + scale * c;
                }
            });
            std::hint::black_box(&a);
        }
        4.0 * (bytes * repetitions) as f64 / start.elapsed().as_secs_f64()
    };
    run(0.5);
    (0..5).map(|_| run(0.25)).fold(0.0, f64::max)
}

/// Name and number of the processors, as the system says; empty where it does not.
pub fn processor() -> String {
    let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split(": ").nth(1)).unwrap_or("");
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    format!("{name}, {cores} cores")
}

/// The instruction set that kernels choose here.
pub fn instructions() -> String {
    format!("{:?}", Arch::new()).split('(').next().unwrap_or_default().to_owned()
}

/// The load average: threads that ran or waited to run in the last minute, of all programs, this one too; `None` where the system
/// does not say. More than there are processors means that programs waited for one another.
pub fn load_average() -> Option<f64> {
    fs::read_to_string("/proc/loadavg").ok()?.split(' ').next()?.parse().ok()
}

/// Resident memory of this process, KiB: now (`VmRSS`) or at most so far (`VmHWM`); `None` where the system does not say.
pub fn memory(key: &str) -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find(|line| line.starts_with(key))?.split_whitespace().nth(1)?.parse().ok()
}

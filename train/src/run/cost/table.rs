//! Costs as a table for a terminal.

use comfy_table::{Cell, CellAlignment, Table, presets};

use super::{CostReport, FileCost, ForwardCost, NetworkCost, Pass};

const HEADS: [&str; 7] = ["", "parameters", "MACs", "checkpoint", "time", "frames/s", "activations"];

impl CostReport {
    /// One row a network; its checkpoint files, where there are several, and the refinements of flow below it.
    pub fn render_table(&self) -> String {
        let mut table = Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        let align = |k: usize| if k == 0 { CellAlignment::Left } else { CellAlignment::Right };
        table.set_header(HEADS.iter().enumerate().map(|(k, head)| Cell::new(head).set_alignment(align(k))));
        for network in &self.networks {
            for row in rows(network) {
                table.add_row(row.iter().enumerate().map(|(k, text)| Cell::new(text.as_str()).set_alignment(align(k))));
            }
        }
        format!("{}\n{}\n{}", self.title(), table.trim_fmt(), self.notes())
    }

    fn forwards(&self) -> impl Iterator<Item = &ForwardCost> {
        self.networks.iter().filter_map(|network| match &network.pass {
            Pass::Forward(forward) => Some(forward),
            Pass::Unfit(_) => None,
        })
    }

    fn title(&self) -> String {
        let runs = self.forwards().find_map(|forward| forward.time.as_ref()).map(|time| time.seconds.len());
        let threads = if self.threads == 1 { "1 thread".to_owned() } else { format!("{} threads", self.threads) };
        let timed = runs.map_or_else(String::new, |runs| format!(", median of {runs} forward passes on {threads}"));
        format!("One forward pass at {}x{}, batch 1{timed}", self.width, self.height)
    }

    fn notes(&self) -> String {
        let mut notes =
            "  MACs: multiply-accumulates of convolutions and matrix products as the network is defined.\n".to_owned();
        if self.forwards().any(|forward| forward.time.is_some()) {
            notes +=
                "  Activations: most memory of the pass at one time, without weights. Pose and flow look at a pair of frames.\n";
        }
        for network in &self.networks {
            if let Pass::Unfit(why) = &network.pass {
                notes += &format!("  {}: {why}.\n", network.network);
            }
        }
        notes
    }
}

/// The texts of a network's rows.
fn rows(cost: &NetworkCost) -> Vec<[String; 7]> {
    let (macs, [time, speed, memory]) = match &cost.pass {
        Pass::Forward(forward) => (amount(forward.macs), timed(forward)),
        Pass::Unfit(_) => ("unfit size".to_owned(), [(); 3].map(|()| "-".to_owned())),
    };
    let mut rows = vec![[cost.network.clone(), grouped(cost.parameters), macs, megabytes(cost.bytes), time, speed, memory]];
    let blank = || [(); 3].map(|()| String::new());
    let part = |name: String, parameters: String, macs: String, bytes: String| {
        let [time, speed, memory] = blank();
        [format!("  {name}"), parameters, macs, bytes, time, speed, memory]
    };
    if cost.files.len() > 1 {
        let of_file = |file: &FileCost| {
            let macs = file.macs.map_or_else(|| "-".to_owned(), amount);
            part(file.file.clone(), grouped(file.parameters), macs, megabytes(file.bytes))
        };
        rows.extend(cost.files.iter().map(of_file));
    }
    if let Pass::Forward(ForwardCost { iterations: Some(iterations), .. }) = &cost.pass {
        let name = if iterations.count == 1 {
            "its one iteration".to_owned()
        } else {
            format!("each of {} iterations", iterations.count)
        };
        rows.push(part(name, String::new(), amount(iterations.macs_each), String::new()));
    }
    rows
}

fn timed(forward: &ForwardCost) -> [String; 3] {
    let Some(time) = &forward.time else { return [(); 3].map(|()| "-".to_owned()) };
    let seconds = time.median_seconds;
    let told = if seconds < 1.0 { format!("{:.1} ms", 1e3 * seconds) } else { format!("{seconds:.2} s") };
    let speed = time.frames_per_second;
    let decimals = if speed < 10.0 { 2 } else { 1 };
    [told, format!("{speed:.decimals$}"), megabytes(time.peak_bytes)]
}

/// Multiply-accumulates in billions with three decimals, or in millions with two.
fn amount(macs: u64) -> String {
    if macs >= 1_000_000_000 { format!("{:.3} G", macs as f64 / 1e9) } else { format!("{:.2} M", macs as f64 / 1e6) }
}

fn megabytes(bytes: usize) -> String {
    let decimals = if bytes < 10_000_000 { 2 } else { 1 };
    format!("{:.decimals$} MB", bytes as f64 / 1e6)
}

/// `11 689 512`.
fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::{Iterations, Time};
    use super::*;

    fn file(file: &str, macs: Option<u64>) -> FileCost {
        FileCost { file: file.to_owned(), parameters: 11_689_512, bytes: 46_800_000, macs }
    }

    fn report(pass: Pass) -> CostReport {
        let macs = matches!(pass, Pass::Forward(_)).then_some(4_441_000_000);
        let files = vec![file("encoder", macs), file("depth", macs.map(|_| 158_000_000))];
        let network = NetworkCost { network: "depth:x".to_owned(), parameters: 23_379_024, bytes: 93_600_000, files, pass };
        CostReport { width: 640, height: 192, threads: 2, networks: vec![network] }
    }

    #[test]
    fn numbers_stand_in_their_rows() {
        let time = Time { median_seconds: 0.1234, seconds: vec![0.1234; 5], frames_per_second: 8.104, peak_bytes: 98_765_432 };
        let iterations = Some(Iterations { count: 12, macs_each: 1_682_000_000 });
        let text = report(Pass::Forward(ForwardCost { macs: 4_599_000_000, iterations, time: Some(time) })).render_table();
        assert!(text.starts_with("One forward pass at 640x192, batch 1, median of 5 forward passes on 2 threads\n"), "{text}");
        let row = |name: &str| text.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("{name}: {text}"));
        for (name, parts) in [
            ("depth:x", &["23 379 024", "4.599 G", "93.6 MB", "123.4 ms", "8.10", "98.8 MB"][..]),
            ("  encoder", &["11 689 512", "4.441 G", "46.8 MB"]),
            ("  depth", &["158.00 M"]),
            ("each of 12 iterations", &["1.682 G"]),
        ] {
            assert!(parts.iter().all(|part| row(name).contains(part)), "{name}: {text}");
        }
    }

    #[test]
    fn a_size_that_does_not_fit_is_in_the_row_and_explained_below() {
        let text = report(Pass::Unfit("needs more rows".to_owned())).render_table();
        assert!(text.contains("unfit size") && text.contains("  depth:x: needs more rows.\n"), "{text}");
        assert!(text.starts_with("One forward pass at 640x192, batch 1\n") && !text.contains("Activations"), "{text}");
    }

    #[test]
    fn digits_are_grouped_from_the_right() {
        assert_eq!([0, 12, 123, 1234, 1_234_567].map(grouped), ["0", "12", "123", "1 234", "1 234 567"]);
    }
}

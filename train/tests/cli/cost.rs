use serde_json::Value;

use crate::dimode;

fn cost(args: &[&str]) -> Value {
    let printed = dimode(&[&["cost", "--json"], args].concat()).succeeded();
    serde_json::from_str(&printed).unwrap()
}

#[test]
fn counts_are_those_of_published_tables_with_files_and_refinements() {
    let report = cost(&["--size", "96x64", "--no-time", "nano_resnet", "pose:nano", "flow:nano_raft"]);
    let networks = report["networks"].as_array().unwrap();
    let names: Vec<&str> = networks.iter().map(|network| network["network"].as_str().unwrap()).collect();
    assert_eq!(names, ["depth:nano_resnet", "pose:nano", "flow:nano_raft"]);
    assert_eq!(networks[0]["files"][0]["parameters"], 78_312);
    let macs = |k: usize| format!("{:.2}", networks[k]["forward"]["macs"].as_f64().unwrap() / 1e6);
    assert_eq!([macs(0), macs(1), macs(2)], ["13.19", "13.62", "68.32"]);
    assert_eq!(networks[2]["forward"]["iterations"]["count"], 4);
    assert!(networks[0]["forward"].get("time").is_none());
}

#[test]
fn the_table_names_threads_and_runs() {
    let args = ["cost", "nano_resnet", "--size", "96x64", "--runs", "3", "--threads", "1"];
    let table = dimode(&args).succeeded();
    assert!(table.starts_with("One forward pass at 96x64, batch 1, median of 3 forward passes on 1 thread\n"), "{table}");
    for part in ["134 204", "13.19 M", "  encoder", "78 312", "ms"] {
        assert!(table.contains(part), "'{part}' is not in: {table}");
    }
}

#[test]
fn every_network_has_a_row_and_sizes_that_do_not_fit_say_so() {
    let report = cost(&["--size", "40x64", "--no-time"]);
    let networks = report["networks"].as_array().unwrap();
    assert!(networks.len() >= 7);
    let unfit = |name: &str| networks.iter().find(|network| network["network"] == name).unwrap()["unfit"].as_str();
    assert!(unfit("depth:resnet18").unwrap().contains("40x64"));
    assert_eq!(unfit("pose:nano"), None);
    assert!(networks.iter().all(|network| network["parameters"].as_u64() > Some(10_000)));
}

#[test]
fn networks_that_do_not_exist_or_do_not_fit_are_refused() {
    let ran = dimode(&["cost", "resnet18"]);
    assert_eq!(ran.code, 2);
    assert!(ran.err.contains("depth:resnet18 or pose:resnet18"), "{}", ran.err);
    let ran = dimode(&["cost", "resnet19"]);
    assert!(ran.code == 2 && ran.err.contains("use one of depth:"), "{}", ran.err);
    dimode(&["cost", "depth:resnet18", "--size", "100x64"]).refused(2, &["100x64", "fix: give a --size that fits"]);
    dimode(&["cost", "nano_raft", "--iterations", "0"]).refused(2, &["--iterations 0", "fix: use 1 to 64"]);
    dimode(&["cost", "--size", "0x64"]).refused(2, &["--size 0x64"]);
}

//! Settings whose default shows nothing: no value at all, or an empty list.

use toml::Table;

use super::Config;

/// How such a setting may be written.
struct Example {
    table: &'static str,
    key: &'static str,
    /// A value, as TOML.
    value: &'static str,
    /// What the setting means, and what it means to leave it out.
    meaning: &'static str,
}

const EXAMPLES: [Example; 4] = [
    Example { table: "data", key: "path", value: r#""frames""#, meaning: "folder of real frames; without it the embedded world" },
    Example { table: "data", key: "sequences", value: r#"["00", "01"]"#, meaning: "sequences of the folder; without it all" },
    Example {
        table: "loss.local_structure",
        key: "folder",
        value: r#""teacher""#,
        meaning: "folder of pseudo-depth maps for pseudo_depth = \"folder\"",
    },
    Example {
        table: "train",
        key: "only_stages",
        value: "[1, 2]",
        meaning: "train only these stages, numbered from 1; without it all",
    },
];

/// The pretty `text` of a configuration, with a comment in place of every setting that it does not name.
pub(super) fn add_unset(text: String, config: &Table) -> String {
    let is_unset = |example: &&Example| {
        let table = example.table.split('.').try_fold(config, |table, name| table.get(name)?.as_table());
        table.is_some_and(|table| table.get(example.key).is_none())
    };
    EXAMPLES.iter().filter(is_unset).fold(text, |text, Example { table, key, value, meaning }| {
        let head = format!("\n[{table}]\n");
        text.replacen(&head, &format!("{head}# {key} = {value}  # {meaning}\n"), 1)
    })
}

/// Every setting there is: the defaults, and examples where these show nothing.
pub(super) fn every_setting() -> Table {
    let mut all = Table::try_from(Config::default()).expect("a configuration holds only what TOML can hold");
    for Example { table, key, value, .. } in EXAMPLES {
        let line: Table = toml::from_str(&format!("{key} = {value}")).expect("the examples are TOML");
        let place = table.split('.').try_fold(&mut all, |table, name| table.get_mut(name)?.as_table_mut());
        place.expect("the examples belong to tables").extend(line);
    }
    all
}

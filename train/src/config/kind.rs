//! What kind of value a setting takes, in words.

use toml::{Table, Value};

use super::examples::every_setting;

/// The kind of a value, and how to write one.
#[derive(Debug, PartialEq)]
pub(super) struct Kind {
    /// For instance `a whole number, 0 or more`.
    pub name: &'static str,
    /// What to write, for instance `write for instance train.steps = 3600`.
    pub advice: String,
}

/// The kind of the setting called `key` (`table.key`); none when there is no such setting.
pub(super) fn kind_of(key: &str) -> Option<Kind> {
    let all = Value::Table(every_setting());
    let value = key.split('.').try_fold(&all, |value, part| match value {
        Value::Array(items) => items.first()?.get(part),
        value => value.get(part),
    })?;
    let advice = match value {
        Value::Table(table) => format!("set what is in it, for instance {}", assignment(key, table)?),
        Value::Array(items) if items.first().is_some_and(Value::is_table) => format!("begin each with a line [[{key}]]"),
        value => format!("write for instance {key} = {value}"),
    };
    Some(Kind { name: name(value), advice })
}

/// `table.key = value` for the first plain value of a table.
fn assignment(key: &str, table: &Table) -> Option<String> {
    let (inner, value) = table.iter().find(|(_, value)| !value.is_table() && !value.is_array())?;
    Some(format!("{key}.{inner} = {value}"))
}

fn name(value: &Value) -> &'static str {
    match value {
        Value::Integer(_) => "a whole number, 0 or more",
        Value::Float(_) => "a number",
        Value::Boolean(_) => "true or false",
        Value::String(_) => "a text",
        Value::Datetime(_) => "a date",
        Value::Table(_) => "a table",
        Value::Array(items) => match items.first() {
            Some(Value::Integer(_)) => "a list of whole numbers",
            Some(Value::Float(_)) => "a list of numbers",
            Some(Value::Boolean(_)) => "a list of true and false",
            Some(Value::Table(_)) => "a list of tables",
            _ => "a list of texts",
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(key: &str) -> (&'static str, String) {
        let Kind { name, advice } = kind_of(key).unwrap();
        (name, advice)
    }

    #[test]
    fn every_kind_has_a_name_and_an_advice() {
        let pair = |name: &'static str, advice: &str| (name, advice.to_owned());
        assert_eq!(told("train.steps"), pair("a whole number, 0 or more", "write for instance train.steps = 3600"));
        assert_eq!(told("train.learning_rate"), pair("a number", "write for instance train.learning_rate = 0.001"));
        assert_eq!(told("train.flip"), pair("true or false", "write for instance train.flip = true"));
        assert_eq!(told("data.preset"), pair("a text", "write for instance data.preset = \"street\""));
        assert_eq!(told("train.betas"), pair("a list of numbers", "write for instance train.betas = [0.9, 0.999]"));
        assert_eq!(told("data.sequences"), pair("a list of texts", "write for instance data.sequences = [\"00\", \"01\"]"));
        assert_eq!(told("train.only_stages"), pair("a list of whole numbers", "write for instance train.only_stages = [1, 2]"));
        assert_eq!(told("train.stages"), pair("a list of tables", "begin each with a line [[train.stages]]"));
        assert_eq!(told("train.stages.train_pose"), pair("true or false", "write for instance train.stages.train_pose = true"));
        assert_eq!(told("eval").0, "a table");
        assert!(told("eval").1.starts_with("set what is in it, for instance eval."));
        assert_eq!(kind_of("train.stpes"), None);
    }
}

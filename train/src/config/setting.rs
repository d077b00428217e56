//! One setting changed by its name.

use std::path::Path;

use toml::{Table, Value};

use super::{Config, ConfigError, error};

impl Config {
    /// The configuration with one setting changed, written `table.key=value`, for a stage `train.stages.2.lambda1=0.1`. Text may
    /// stand without quotes. `loss.preset=NAME` changes the whole loss and the stages.
    ///
    /// **Errors** [`ConfigError::Syntax`] when it is not written so, else as [`Config::from_toml`].
    pub fn with_setting(&self, setting: &str) -> Result<Self, ConfigError> {
        let origin = format!("--set {setting}");
        let malformed = || ConfigError::Syntax {
            path: Path::new(&origin).to_owned(),
            line: 0,
            reason: "not a setting; write it as train.warmup=50".to_owned(),
        };
        let (key, value) = setting.split_once('=').ok_or_else(malformed)?;
        let plain = toml::from_str::<Table>(&format!("{key} = {value}"));
        let change = plain.or_else(|_| toml::from_str(&format!("{key} = {}", Value::String(value.to_owned()))));
        let change = change.map_err(|_| malformed())?;
        if key.trim() == "loss.preset" {
            return self.with_preset(change, &origin);
        }
        self.check_stage(key)?;
        let mut table = self.to_table();
        merge(&mut table, change);
        Config::from_table(table, &origin)
    }

    /// **Errors** for the number of a stage that there is not.
    fn check_stage(&self, key: &str) -> Result<(), ConfigError> {
        let number = key
            .trim()
            .strip_prefix("train.stages.")
            .and_then(|rest| rest.split('.').next())
            .and_then(|n| n.parse::<usize>().ok());
        let count = self.train.stages.len();
        let known = number.is_none_or(|number| (1..=count).contains(&number));
        let advice = format!("stages are numbered from 1, and there are {count}: {}", self.stage_names());
        error::require(known, "train.stages", number.unwrap_or(0), &advice)
    }

    fn stage_names(&self) -> String {
        self.train.stages.iter().map(|stage| format!("\"{}\"", stage.name)).collect::<Vec<_>>().join(", ")
    }

    /// The configuration with the loss and the stages of the preset that `change` names.
    fn with_preset(&self, change: Table, origin: &str) -> Result<Self, ConfigError> {
        let named = Config::from_table(change, origin)?.loss.preset;
        let mut config = self.clone();
        named.apply(&mut config);
        Ok(config)
    }
}

/// Lays `change` over `base`: tables key by key, tables of a list by their numbers from 1, everything else as a whole.
pub(super) fn merge(base: &mut Table, change: Table) {
    for (key, value) in change {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(more)) => merge(inner, more),
            (Some(Value::Array(items)), Value::Table(more)) if are_numbers(&more, items.len()) => merge_items(items, more),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

/// Whether every key is the number of an item.
fn are_numbers(table: &Table, len: usize) -> bool {
    table.keys().all(|key| key.parse().is_ok_and(|number: usize| (1..=len).contains(&number)))
}

fn merge_items(items: &mut [Value], change: Table) {
    for (number, value) in change {
        let item = &mut items[number.parse::<usize>().expect("checked before") - 1];
        match (item, value) {
            (Value::Table(item), Value::Table(more)) => merge(item, more),
            (item, value) => *item = value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::LossPreset;
    use dimode_geometry::losses::PlanarForm;

    #[test]
    fn a_setting_changes_by_its_name_and_nothing_else_does() {
        let mut config = Config::quick();
        config.train.betas = [0.8, 0.9];
        config.loss.geometric.planar = PlanarForm::Literal;
        let changed = Config::quick().with_setting("train.betas=[0.8, 0.9]").unwrap();
        assert_eq!(changed.with_setting("loss.geometric.planar=literal").unwrap(), config);
    }

    #[test]
    fn one_stage_changes_by_its_number() {
        let mut config = Config::default();
        config.train.stages[1].lambda1 = 0.5;
        assert_eq!(Config::default().with_setting("train.stages.2.lambda1=0.5").unwrap(), config);
        let refusal = |setting| Config::default().with_setting(setting).unwrap_err().to_string();
        let message =
            "train.stages = 4: stages are numbered from 1, and there are 3: \"1 joint\", \"2 directions\", \"3 ratios\"";
        assert_eq!(refusal("train.stages.4.lambda1=0.5"), message);
        assert!(refusal("train.stages.2.lamda1=0.5").contains("did you mean 'lambda1'?"));
    }

    #[test]
    fn a_preset_changes_the_whole_loss_and_the_stages_and_nothing_else() {
        let mut config = Config::quick();
        config.loss.smoothness = 0.5;
        let changed = config.with_setting("loss.preset=dcpi").unwrap();
        let mut expected = Config::quick();
        LossPreset::Dcpi.apply(&mut expected);
        assert_eq!(changed, expected);
    }

    #[test]
    fn what_is_no_setting_is_refused() {
        let refusal = |setting| Config::default().with_setting(setting).unwrap_err().to_string();
        assert_eq!(refusal("steps"), "--set steps: not a setting; write it as train.warmup=50");
        assert_eq!(refusal("train.stpes=3"), "--set train.stpes=3: unknown key 'stpes'; did you mean 'steps'?");
    }
}

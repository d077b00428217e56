//! One setting changed by its name.

use std::path::Path;

use super::{Config, ConfigError};

impl Config {
    /// The configuration with one setting changed, written `table.key=value`. Text may stand without quotes.
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
        let plain = toml::from_str::<toml::Table>(&format!("{key} = {value}"));
        let change = plain.or_else(|_| toml::from_str(&format!("{key} = {}", toml::Value::String(value.to_owned()))));
        let mut table = toml::Table::try_from(self).expect("a configuration holds only what TOML can hold");
        merge(&mut table, change.map_err(|_| malformed())?);
        Config::from_table(table, &origin)
    }
}

fn merge(base: &mut toml::Table, change: toml::Table) {
    for (key, value) in change {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(more)) => merge(inner, more),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn what_is_no_setting_is_refused() {
        let refusal = |setting| Config::default().with_setting(setting).unwrap_err().to_string();
        assert_eq!(refusal("steps"), "--set steps: not a setting; write it as train.warmup=50");
        assert_eq!(refusal("train.stpes=3"), "--set train.stpes=3: unknown key 'stpes'; did you mean 'steps'?");
    }
}

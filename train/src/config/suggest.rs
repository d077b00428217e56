//! From a parser's complaint to a message that names the key, and the nearest word that exists.

use std::path::Path;

use super::ConfigError;
use super::examples::every_setting;
use super::kind::{Kind, kind_of};

/// Turns an error of the TOML reader into one that says what to change. `text` is empty for values without a file.
pub(super) fn explain(error: &toml::de::Error, text: &str, path: &Path) -> ConfigError {
    let line = error.span().map_or(usize::from(!text.is_empty()), |span| line_of(text, span.start));
    let message = error.message();
    let path = path.to_owned();
    let quoted = quoted_words(message);
    match quoted.split_first() {
        Some((key, known)) if message.starts_with("unknown field") => {
            let nearest = nearest_key(key, known);
            ConfigError::UnknownKey { path, line, key: key.clone(), nearest, known: known.to_vec() }
        }
        Some((value, known)) if message.starts_with("unknown variant") => {
            let nearest = nearest(value, known.iter().map(String::as_str)).map(str::to_owned);
            ConfigError::UnknownName { path, line, value: value.clone(), nearest, known: known.to_vec() }
        }
        Some((key, _)) if message.starts_with("missing field") => {
            let table = key_of(error).unwrap_or_default();
            ConfigError::Syntax { path, line, reason: format!("'{key}' is missing in {table}; add it") }
        }
        _ => match key_of(error).filter(|_| is_about_kind(message)).and_then(|key| Some((kind_of(&key)?, key))) {
            Some((Kind { name, advice }, key)) => ConfigError::WrongKind { path, line, key, kind: name, advice },
            None => ConfigError::Syntax { path, line, reason: message.trim().replace('\n', ", ") },
        },
    }
}

/// Whether the reader met a value of another type, range or length than a setting has.
fn is_about_kind(message: &str) -> bool {
    ["invalid type", "invalid value", "invalid length", "wanted string or table"].iter().any(|start| message.starts_with(start))
}

/// `table.key` of the value that the reader gave up at.
fn key_of(error: &toml::de::Error) -> Option<String> {
    let mut error = error.clone();
    // With the text at hand the report would show its line in place of the key.
    error.set_input(None);
    let report = error.to_string();
    report.lines().last()?.strip_prefix("in `")?.strip_suffix('`').map(str::to_owned)
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

/// The words between backticks, in order.
fn quoted_words(message: &str) -> Vec<String> {
    message.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// What an unknown key was meant to be: `table.key` when exactly this key exists in another table, else the nearest of the
/// `known` ones of its table, else `table.key` for one of another table that is almost the same.
fn nearest_key(key: &str, known: &[String]) -> Option<String> {
    let mut all = Vec::new();
    list_keys(&every_setting(), "", &mut all);
    let elsewhere = |wanted: &str| all.iter().find(|(_, name)| name == wanted).map(|(path, _)| path.clone());
    let here = || nearest(key, known.iter().map(String::as_str)).map(str::to_owned);
    let almost = || nearest_within(key.chars().count().max(4) / 4, key, all.iter().map(|(_, name)| name.as_str()));
    elsewhere(key).or_else(here).or_else(|| elsewhere(almost()?))
}

/// Adds every key below `table` as (`table.key`, `key`).
fn list_keys(table: &toml::Table, prefix: &str, keys: &mut Vec<(String, String)>) {
    for (name, value) in table {
        let path = format!("{prefix}{name}");
        keys.push((path.clone(), name.clone()));
        if let toml::Value::Table(inner) = value {
            list_keys(inner, &format!("{path}."), keys);
        }
    }
}

/// The word among `known` that is fewest edits (insert, delete, replace, swap neighbours) away from `word`; none when even
/// that one shares little with it. The first wins among equals.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    nearest_within(word.chars().count().max(3) / 2, word, known)
}

/// [`nearest`] with at most `limit` edits.
fn nearest_within<'a>(limit: usize, word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let folded = fold(word);
    known
        .into_iter()
        .map(|candidate| (distance(&folded, &fold(candidate)), candidate))
        .filter(|&(edits, _)| edits <= limit)
        .min_by_key(|&(edits, _)| edits)
        .map(|(_, candidate)| candidate)
}

/// Lower case, one separator: `Learning-Rate` is `learning_rate`.
fn fold(word: &str) -> Vec<char> {
    word.to_lowercase().chars().map(|c| if c == '-' { '_' } else { c }).collect()
}

/// Optimal string alignment distance.
fn distance(a: &[char], b: &[char]) -> usize {
    let width = b.len() + 1;
    let mut cost: Vec<usize> = vec![0; (a.len() + 1) * width];
    for i in 0..=a.len() {
        for j in 0..width {
            let at = i * width + j;
            if i == 0 || j == 0 {
                cost[at] = i + j;
                continue;
            }
            let replaced = cost[at - width - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = replaced.min(cost[at - width] + 1).min(cost[at - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(cost[at - 2 * width - 2] + 1);
            }
            cost[at] = best;
        }
    }
    cost[cost.len() - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edits(a: &str, b: &str) -> usize {
        distance(&fold(a), &fold(b))
    }

    #[test]
    fn distances_have_known_values() {
        assert_eq!(edits("kitten", "sitting"), 3);
        assert_eq!(edits("stpes", "steps"), 1);
        assert_eq!(edits("", "abc"), 3);
        assert_eq!(edits("Learning-Rate", "learning_rate"), 0);
    }

    #[test]
    fn nearest_finds_typing_errors_and_gives_up_on_strangers() {
        let known = ["steps", "batch", "learning_rate", "warmup"];
        assert_eq!(nearest("step", known), Some("steps"));
        assert_eq!(nearest("learning-rate", known), Some("learning_rate"));
        assert_eq!(nearest("zzzzzz", known), None);
    }

    #[test]
    fn words_between_backticks() {
        assert_eq!(quoted_words("unknown field `a`, expected `b` or `c`"), ["a", "b", "c"]);
    }
}

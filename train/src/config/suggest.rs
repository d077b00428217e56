//! From a parser's complaint to a message that names the nearest word that exists.

use std::path::Path;

use super::{Config, ConfigError};

/// Turns an error of the TOML reader into one that says what to change. `text` is empty for values without a file.
pub(super) fn explain(error: &toml::de::Error, text: &str, path: &Path) -> ConfigError {
    let line = error.span().map_or(usize::from(!text.is_empty()), |span| line_of(text, span.start));
    let message = error.message();
    let path = path.to_owned();
    let quoted = quoted_words(message);
    match quoted.split_first() {
        Some((key, known)) if message.starts_with("unknown field") => {
            let nearest = nearest(key, known.iter().map(String::as_str)).map(str::to_owned);
            let nearest = key_of_another_table(key, known).or(nearest);
            ConfigError::UnknownKey { path, line, key: key.clone(), nearest, known: known.to_vec() }
        }
        Some((value, known)) if message.starts_with("unknown variant") => {
            let nearest = nearest(value, known.iter().map(String::as_str)).map(str::to_owned);
            ConfigError::UnknownName { path, line, value: value.clone(), nearest, known: known.to_vec() }
        }
        _ => ConfigError::Syntax { path, line, reason: message.trim().replace('\n', ", ") },
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

/// The words between backticks, in order.
fn quoted_words(message: &str) -> Vec<String> {
    message.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// `table.key` when exactly this key exists, but in a table other than the one it was written in.
fn key_of_another_table(key: &str, known_here: &[String]) -> Option<String> {
    if known_here.iter().any(|known| known == key) {
        return None;
    }
    let everything = toml::Table::try_from(Config::default()).ok()?;
    find_key(&everything, key, "")
}

fn find_key(table: &toml::Table, key: &str, prefix: &str) -> Option<String> {
    for (name, value) in table {
        if name == key {
            return Some(format!("{prefix}{name}"));
        }
        if let toml::Value::Table(inner) = value {
            let found = find_key(inner, key, &format!("{prefix}{name}."));
            if found.is_some() {
                return found;
            }
        }
    }
    None
}

/// The word among `known` that is fewest edits (insert, delete, replace, swap neighbours) away from `word`; none when even
/// that one shares little with it. The first wins among equals.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let limit = (word.chars().count().max(3)) / 2;
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

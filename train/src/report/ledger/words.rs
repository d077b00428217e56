//! Numbers and lines as the tables have them.

/// Two or three digits, with a power of ten for what is large or small; a dash where there is nothing.
pub fn brief(value: Option<f64>) -> String {
    let Some(value) = value else { return "-".to_owned() };
    if value == 0.0 {
        return "0".to_owned();
    }
    if !(0.01..10_000.0).contains(&value.abs()) {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    let decimals = (2.0 - value.abs().log10().floor()).max(0.0) as usize;
    let digits = format!("{value:.decimals$}");
    if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.').to_owned() } else { digits }
}

/// `yes`, or a `NO` that is seen.
pub fn yes(ok: bool) -> &'static str {
    if ok { "yes" } else { "NO" }
}

/// Lines of at most `width` characters; a longer word stands alone.
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// The beginning of a text, up to its first sentence or `width` characters.
pub fn shortened(text: &str, width: usize) -> String {
    // A full stop ends a sentence when a capital follows and no abbreviation stands before it.
    let ends = |at: &usize| {
        let word = text[..*at].rsplit([' ', '(']).next().unwrap_or_default();
        text[at + 2..].starts_with(|c: char| c.is_uppercase()) && !["eq", "eqs", "Sect", "Fig", "fig", "cf"].contains(&word)
    };
    let end = text.match_indices(". ").map(|(at, _)| at).find(ends).unwrap_or(text.len());
    let sentence = text[..end].trim_end_matches('.');
    if sentence.chars().count() <= width {
        return sentence.to_owned();
    }
    format!("{} ..", wrapped(sentence, width - 3).first().map_or("", String::as_str))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_brief() {
        let few = [Some(3.42e-13), Some(1e-9), Some(0.0), None, Some(f64::NAN), Some(2e5)];
        assert_eq!(few.map(brief), ["3.4e-13", "1e-9", "0", "-", "NaN", "2e5"]);
        assert_eq!([907.18, 900.0, 1.0, 0.02, 1.5].map(|v| brief(Some(v))), ["907", "900", "1", "0.02", "1.5"]);
    }

    #[test]
    fn lines_break_at_words() {
        assert_eq!(wrapped("one two  three", 7), ["one two", "three"]);
        assert_eq!(wrapped("incomprehensible", 5), ["incomprehensible"]);
        assert_eq!(shortened("First. Second.", 20), "First");
        assert_eq!(shortened("Terms of eq. X are (see Sect. Y) 3. Then more.", 50), "Terms of eq. X are (see Sect. Y) 3");
        assert_eq!(shortened("one two three four", 12), "one two ..");
    }
}

//! Numbers of things in words.

/// `1 frame`, `6 frames`: a number and its noun in the right form.
pub(crate) fn counted(count: usize, noun: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {noun}{plural}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_singular() {
        assert_eq!([0, 1, 2].map(|n| counted(n, "frame pair")), ["0 frame pairs", "1 frame pair", "2 frame pairs"]);
    }
}

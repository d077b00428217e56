//! Values of flags that several commands share.

use std::str::FromStr;

use clap::builder::{PossibleValuesParser, TypedValueParser};

use super::failure::UsageError;
use crate::config::{LossPreset, Preset};

/// Width and height in pixels, written `128x64`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(['x', 'X']);
        let parts = parts.and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
        let (width, height) = parts.ok_or_else(|| "write width x height without spaces, for instance 128x64".to_owned())?;
        Ok(Self { width, height })
    }
}

/// Numbers of stages, written `1`, `1,2` or `1,2,3`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stages(pub Vec<usize>);

impl FromStr for Stages {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<usize>, _> = text.split(',').map(|part| part.trim().parse()).collect();
        let numbers = numbers.map_err(|_| "write numbers of stages with commas, for instance 1,2".to_owned())?;
        Ok(Self(numbers))
    }
}

/// Name of a method whose loss a run takes.
pub fn loss() -> impl TypedValueParser<Value = LossPreset> {
    PossibleValuesParser::new(LossPreset::ALL.map(LossPreset::name)).try_map(|name| name.parse::<LossPreset>())
}

/// Name of a kind of world.
pub fn preset() -> impl TypedValueParser<Value = Preset> {
    PossibleValuesParser::new(Preset::ALL.map(Preset::name)).try_map(|name| name.parse::<Preset>())
}

/// A wrong usage with an advice, unless all is well.
pub fn refuse_unless(ok: bool, what: impl FnOnce() -> String, advice: &str) -> Result<(), UsageError> {
    if ok { Ok(()) } else { Err(UsageError::new(what(), advice)) }
}

/// Refuses sizes that the networks cannot halve often enough.
pub fn refuse_unless_network_size(size: &Size) -> Result<(), UsageError> {
    let whole = |value: usize| value >= 64 && value.is_multiple_of(32);
    let what = || format!("--size {}x{}", size.width, size.height);
    refuse_unless(whole(size.width) && whole(size.height), what, "use multiples of 32, at least 64x64")
}

/// Number of threads.
pub fn threads(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|number| (1..=1024).contains(number));
    number.ok_or_else(|| "use a number from 1 to 1024".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_stages() {
        assert_eq!("128x64".parse(), Ok(Size { width: 128, height: 64 }));
        assert!("128".parse::<Size>().is_err() && "128x".parse::<Size>().is_err() && "-1x2".parse::<Size>().is_err());
        assert_eq!("1,3".parse(), Ok(Stages(vec![1, 3])));
        assert!("1,".parse::<Stages>().is_err() && "one".parse::<Stages>().is_err());
        assert!(threads("0").is_err() && threads("x").is_err());
        assert_eq!(threads("2"), Ok(2));
    }
}

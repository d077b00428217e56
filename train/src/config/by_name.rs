//! Serde for types that read and write themselves as a name (`FromStr` and `Display`).

use std::borrow::Cow;
use std::fmt::Display;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serializer, de};

/// Writes the name.
pub fn serialize<K: Display, S: Serializer>(kind: &K, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(kind)
}

/// Reads the name; the message of an unknown one is that of the type's `FromStr`.
pub fn deserialize<'de, K, D>(deserializer: D) -> Result<K, D::Error>
where
    K: FromStr,
    K::Err: Display,
    D: Deserializer<'de>,
{
    let name = Cow::<str>::deserialize(deserializer)?;
    name.parse().map_err(de::Error::custom)
}

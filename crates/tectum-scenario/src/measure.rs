//! A plant's measures: their names, and what they are to the summary.

use std::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// An entry of `measures` under `[plant]`: a name, or a table with a name and a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum MeasureConfig {
    /// The name alone. A measure called `error` has the role [`MeasureRole::Error`] if no other measure has it.
    Name(String),
    /// Name and role.
    Table(MeasureTable),
}

/// `{ name = "distance", role = "error" }`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasureTable {
    /// The name.
    pub name: String,
    /// What the measure is to the summary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<MeasureRole>,
}

/// What a measure is to summary, figure and analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MeasureRole {
    /// The distance from the target. It is reported at the end of each target.
    Error,
}

impl MeasureConfig {
    /// The name.
    pub fn name(&self) -> &str {
        match self {
            Self::Name(name) => name,
            Self::Table(table) => &table.name,
        }
    }

    /// The role that the scenario gives it.
    pub fn role(&self) -> Option<MeasureRole> {
        match self {
            Self::Name(_) => None,
            Self::Table(table) => table.role,
        }
    }
}

impl From<String> for MeasureConfig {
    fn from(name: String) -> Self {
        Self::Name(name)
    }
}

impl From<&str> for MeasureConfig {
    fn from(name: &str) -> Self {
        Self::Name(name.to_owned())
    }
}

/// The index of the measure with the role [`MeasureRole::Error`]: the one that the scenario gives it, or else the
/// one called `error`.
pub(super) fn error_index(measures: &[MeasureConfig]) -> Option<usize> {
    let given = measures.iter().position(|measure| measure.role() == Some(MeasureRole::Error));
    given.or_else(|| measures.iter().position(|measure| measure.name() == "error"))
}

impl<'de> Deserialize<'de> for MeasureConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct MeasureVisitor;
        impl<'de> Visitor<'de> for MeasureVisitor {
            type Value = MeasureConfig;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a name, or a table like { name = \"distance\", role = \"error\" }")
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<MeasureConfig, E> {
                Ok(MeasureConfig::from(name))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<MeasureConfig, A::Error> {
                MeasureTable::deserialize(MapAccessDeserializer::new(map)).map(MeasureConfig::Table)
            }
        }
        deserializer.deserialize_any(MeasureVisitor)
    }
}

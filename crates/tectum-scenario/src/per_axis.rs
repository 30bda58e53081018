//! A number for all axes of a map, or one for each.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// A number for all axes of a map, or one for each, in the order of its inputs.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerAxis {
    /// The same number for all axes.
    All(f64),
    /// One number per axis.
    Each(Vec<f64>),
}

impl PerAxis {
    /// The number of `axis`, counted from 0.
    pub fn of(&self, axis: usize) -> f64 {
        match self {
            Self::All(value) => *value,
            // A list of another length never gets into a plan: `encoder::check` refuses it.
            Self::Each(list) => list.get(axis).copied().unwrap_or(f64::NAN),
        }
    }

    /// Number of entries, if it is a list.
    pub(super) fn list_len(&self) -> Option<usize> {
        match self {
            Self::All(_) => None,
            Self::Each(list) => Some(list.len()),
        }
    }

    /// The key of the number of `axis`, for messages.
    pub(super) fn key(&self, key: &str, axis: usize) -> String {
        match self {
            Self::All(_) => key.to_owned(),
            Self::Each(_) => format!("{key}[{axis}]"),
        }
    }
}

impl<'de> Deserialize<'de> for PerAxis {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PerAxisVisitor;
        impl<'de> Visitor<'de> for PerAxisVisitor {
            type Value = PerAxis;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, or a list of numbers, one for each input of the map")
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<PerAxis, E> {
                Ok(PerAxis::All(value))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<PerAxis, E> {
                Ok(PerAxis::All(value as f64))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<PerAxis, E> {
                Ok(PerAxis::All(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<PerAxis, A::Error> {
                let mut numbers = Vec::new();
                while let Some(number) = list.next_element()? {
                    numbers.push(number);
                }
                Ok(PerAxis::Each(numbers))
            }
        }
        deserializer.deserialize_any(PerAxisVisitor)
    }
}

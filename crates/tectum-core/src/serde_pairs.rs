//! Pairs of numbers in configuration files. Serde's reader of arrays of two ignores a third number, which would
//! hide a mistake; these readers report it as an error.
//!
//! Public only for the scenario files of the `tectum` crate.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{Error, IgnoredAny, SeqAccess, Visitor},
};

/// An array of exactly two numbers.
struct ExactPair([f64; 2]);

impl<'de> Deserialize<'de> for ExactPair {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PairVisitor;
        impl<'de> Visitor<'de> for PairVisitor {
            type Value = ExactPair;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array of length 2")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<ExactPair, A::Error> {
                let mut pair = [0.0; 2];
                for (i, number) in pair.iter_mut().enumerate() {
                    *number = list.next_element()?.ok_or_else(|| A::Error::invalid_length(i, &self))?;
                }
                let mut length = 2;
                while list.next_element::<IgnoredAny>()?.is_some() {
                    length += 1;
                }
                if length == 2 { Ok(ExactPair(pair)) } else { Err(A::Error::invalid_length(length, &self)) }
            }
        }
        deserializer.deserialize_seq(PairVisitor)
    }
}

/// Reads an array of exactly two numbers.
///
/// # Errors
/// When there are fewer or more.
pub fn pair<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    ExactPair::deserialize(deserializer).map(|ExactPair(pair)| pair)
}

/// Reads a list of arrays of exactly two numbers.
///
/// # Errors
/// When one of them has fewer or more.
pub fn pairs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    Vec::<ExactPair>::deserialize(deserializer).map(|pairs| pairs.into_iter().map(|ExactPair(pair)| pair).collect())
}

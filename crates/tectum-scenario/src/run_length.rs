//! `ticks`: a number, or the word `endless` for [`ENDLESS`].

use std::fmt;

use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserializer, Serializer};

use crate::limits::ENDLESS;

/// The word for a run without a planned end.
const WORD: &str = "endless";

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
pub(super) fn serialize<S: Serializer>(ticks: &u64, to: S) -> Result<S::Ok, S::Error> {
    if *ticks == ENDLESS { to.serialize_str(WORD) } else { to.serialize_u64(*ticks) }
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<u64, D::Error> {
    from.deserialize_any(RunLength)
}

struct RunLength;

impl Visitor<'_> for RunLength {
    type Value = u64;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("u64")
    }

    fn visit_u64<E: Error>(self, ticks: u64) -> Result<u64, E> {
        Ok(ticks)
    }

    fn visit_i64<E: Error>(self, ticks: i64) -> Result<u64, E> {
        u64::try_from(ticks).map_err(|_| E::invalid_value(Unexpected::Signed(ticks), &self))
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<u64, E> {
        if word == WORD { Ok(ENDLESS) } else { Err(E::invalid_type(Unexpected::Str(word), &self)) }
    }
}

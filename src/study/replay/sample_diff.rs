//! Compares two samples bit for bit, and names the first field that differs.

use serde::Serialize;

use crate::log::flag_words;
use crate::wire::{Field, Header, Sample};

/// The first difference between a log and its replay.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The tick.
    pub tick: u64,
    /// The channel: observation, command or learning.
    pub channel: &'static str,
    /// The field, as in the sample's definition.
    pub field: String,
    /// The value in the log.
    pub logged: String,
    /// The value that the replay computed.
    pub replayed: String,
}

/// Checks that `logged` equals `replayed` to the last bit.
///
/// # Errors
/// The first field that differs.
pub(super) fn compare<S: Sample>(
    channel: &'static str,
    tick: u64,
    logged: &S,
    replayed: &S,
) -> Result<(), Box<Difference>> {
    let (a, b) = (bytemuck::bytes_of(logged), bytemuck::bytes_of(replayed));
    if a == b {
        return Ok(());
    }
    let different = S::FIELDS.iter().find_map(|field| match field.name {
        "header" => Header::FIELDS.iter().find_map(|inner| first_difference(inner, "header.", field.offset, a, b)),
        _ => first_difference(field, "", 0, a, b),
    });
    // Samples have no bytes between their fields.
    let (field, logged, replayed) = different.unwrap_or_default();
    Err(Box::new(Difference { tick, channel, field, logged, replayed }))
}

/// The field's first element that differs: its name, and both values as text.
fn first_difference(field: &Field, prefix: &str, base: usize, a: &[u8], b: &[u8]) -> Option<(String, String, String)> {
    let size = if field.element == "uint64" { 8 } else { 4 };
    (0..field.count).find_map(|i| {
        let from = base + field.offset + i * size;
        let (a, b) = (a.get(from..from + size)?, b.get(from..from + size)?);
        if a == b {
            return None;
        }
        let name = match field.count {
            1 => format!("{prefix}{}", field.name),
            _ => format!("{prefix}{}[{i}]", field.name),
        };
        Some((name, value_text(field, a), value_text(field, b)))
    })
}

/// A value as text, by the type and the meaning of its field.
fn value_text(field: &Field, bytes: &[u8]) -> String {
    let bits = bytes.iter().rev().fold(0_u64, |bits, &byte| bits << 8 | u64::from(byte));
    match (field.element, field.name) {
        (_, "run" | "weights_hash") => format!("{bits:016x}"),
        (_, "flags") if bits == 0 => "none".to_owned(),
        (_, "flags") => flag_words(bits as u32),
        ("float32", _) => {
            let x = f32::from_bits(bits as u32);
            // Different NaNs print alike; their bits tell them apart.
            if x.is_nan() { format!("NaN ({bits:#010x})") } else { format!("{x:?}") }
        }
        _ => bits.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Command, Learning, MAX_OUTPUTS, Observation, flag};

    fn difference_text<S: Sample>(logged: &S, replayed: &S) -> String {
        let d = compare("x", 3, logged, replayed).unwrap_err();
        assert_eq!((d.tick, d.channel), (3, "x"));
        format!("{}: {} {}", d.field, d.logged, d.replayed)
    }

    #[test]
    fn the_first_different_field_is_named() {
        let mut observation = Observation::default();
        assert_eq!(compare("x", 3, &observation, &observation), Ok(()));
        observation.measures[1] = -0.0;
        assert_eq!(difference_text(&observation, &Observation::default()), "measures[1]: -0.0 0.0");
        observation.header.flags = flag::MISSED | flag::HELD;
        assert_eq!(difference_text(&observation, &Observation::default()), "header.flags: MISSED|HELD none");
        let nan = |bits| Command { drawn: [f32::from_bits(bits); MAX_OUTPUTS], ..Command::default() };
        assert_eq!(
            difference_text(&nan(0x7fc0_0000), &nan(0x7fc0_0001)),
            "drawn[0]: NaN (0x7fc00000) NaN (0x7fc00001)"
        );
        let learning = Learning { weights_hash: 255, ..Learning::default() };
        assert_eq!(difference_text(&learning, &Learning::default()), "weights_hash: 00000000000000ff 0000000000000000");
    }

    /// Every byte of a sample belongs to a field.
    #[test]
    fn every_byte_is_compared() {
        fn check<S: Sample + Default>() {
            for at in 0..size_of::<S>() {
                let mut sample = S::default();
                bytemuck::bytes_of_mut(&mut sample)[at] = 1;
                assert!(!difference_text(&sample, &S::default()).starts_with(':'), "byte {at}");
            }
        }
        check::<Observation>();
        check::<Command>();
        check::<Learning>();
    }
}

//! Two samples, bit for bit, field by field.

use serde::Serialize;

use crate::log::flag_words;
use crate::wire::{Field, Header, Sample};

/// The first thing in which a log is not what its own beginning makes of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The tick.
    pub tick: u64,
    /// The channel: observation, command or learning.
    pub channel: &'static str,
    /// The field, as in the sample's definition.
    pub field: String,
    /// What the log says.
    pub logged: String,
    /// What it should say.
    pub replayed: String,
}

/// The first field of `logged` whose bits are not those of `replayed`.
pub fn compare<S: Sample>(channel: &'static str, tick: u64, logged: &S, replayed: &S) -> Result<(), Box<Difference>> {
    let (a, b) = (bytemuck::bytes_of(logged), bytemuck::bytes_of(replayed));
    if a == b {
        return Ok(());
    }
    let different = S::FIELDS.iter().find_map(|field| match field.name {
        "header" => Header::FIELDS.iter().find_map(|inner| first(inner, "header.", field.offset, a, b)),
        _ => first(field, "", 0, a, b),
    });
    // Samples have no bytes between their fields.
    let (field, logged, replayed) = different.unwrap_or_default();
    Err(Box::new(Difference { tick, channel, field, logged, replayed }))
}

/// The field's first element that differs: its name, and both values.
fn first(field: &Field, prefix: &str, base: usize, a: &[u8], b: &[u8]) -> Option<(String, String, String)> {
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
        Some((name, shown(field, a), shown(field, b)))
    })
}

fn shown(field: &Field, bytes: &[u8]) -> String {
    let bits = bytes.iter().rev().fold(0_u64, |bits, &byte| bits << 8 | u64::from(byte));
    match (field.element, field.name) {
        (_, "run" | "weights_hash") => format!("{bits:016x}"),
        (_, "flags") if bits == 0 => "none".to_owned(),
        (_, "flags") => flag_words(bits as u32),
        ("float32", _) => {
            let x = f32::from_bits(bits as u32);
            // Not-a-numbers look alike, and are not.
            if x.is_nan() { format!("NaN ({bits:#010x})") } else { format!("{x:?}") }
        }
        _ => bits.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Command, Learning, Observation, flag};

    fn says<S: Sample>(logged: &S, replayed: &S) -> String {
        let d = compare("x", 3, logged, replayed).unwrap_err();
        assert_eq!((d.tick, d.channel), (3, "x"));
        format!("{}: {} {}", d.field, d.logged, d.replayed)
    }

    #[test]
    fn the_first_field_is_named() {
        let mut observation = Observation::default();
        assert_eq!(compare("x", 3, &observation, &observation), Ok(()));
        observation.measures[1] = -0.0;
        assert_eq!(says(&observation, &Observation::default()), "measures[1]: -0.0 0.0");
        observation.header.flags = flag::MISSED | flag::HELD;
        assert_eq!(says(&observation, &Observation::default()), "header.flags: MISSED|HELD none");
        let nan = |bits| Command { drawn: [f32::from_bits(bits); 8], ..Command::default() };
        assert_eq!(says(&nan(0x7fc0_0000), &nan(0x7fc0_0001)), "drawn[0]: NaN (0x7fc00000) NaN (0x7fc00001)");
        let learning = Learning { weights_hash: 255, ..Learning::default() };
        assert_eq!(says(&learning, &Learning::default()), "weights_hash: 00000000000000ff 0000000000000000");
    }

    /// No byte of a sample is outside its fields.
    #[test]
    fn every_byte_counts() {
        fn check<S: Sample + Default>() {
            for at in 0..size_of::<S>() {
                let mut sample = S::default();
                bytemuck::bytes_of_mut(&mut sample)[at] = 1;
                assert!(!says(&sample, &S::default()).starts_with(':'), "byte {at}");
            }
        }
        check::<Observation>();
        check::<Command>();
        check::<Learning>();
    }
}

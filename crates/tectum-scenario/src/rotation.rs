//! `[log] rotate`: the size or the time after which a log goes on in another file.

use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// When a log goes on in another segment. In a scenario it is a text: a number and a unit, `64 MB` or `10 min`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LogRotation {
    /// When the segment has so many bytes.
    Bytes(u64),
    /// After so many seconds of the run's own time.
    Seconds(f64),
}

/// Units of size, bytes, and of time, s.
const SIZES: [(&str, u64); 3] = [("kB", 1_000), ("MB", 1_000_000), ("GB", 1_000_000_000)];
const TIMES: [(&str, f64); 4] = [("s", 1.0), ("min", 60.0), ("h", 3600.0), ("d", 86400.0)];
/// Least size of a segment: its description and its end take tens of kilobytes.
const LEAST_BYTES: u64 = 100_000;
/// Longest time of a segment, s: a year.
const MOST_SECONDS: f64 = 366.0 * 86400.0;

impl FromStr for LogRotation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = || "give a size or a time, such as 64 MB or 10 min (kB, MB, GB, s, min, h, d)".to_owned();
        let at = text.find(|c: char| c.is_ascii_alphabetic()).ok_or_else(form)?;
        let (number, unit) = (text[..at].trim(), text[at..].trim());
        let number: f64 = number.parse().ok().filter(|x: &f64| x.is_finite() && *x > 0.0).ok_or_else(form)?;
        if let Some((_, bytes)) = SIZES.iter().find(|(name, _)| *name == unit) {
            let bytes = (number * *bytes as f64) as u64;
            return match bytes {
                LEAST_BYTES..=1_000_000_000_000_000 => Ok(Self::Bytes(bytes)),
                _ => Err("give at least 100 kB, and at most 1000000 GB".to_owned()),
            };
        }
        let seconds = TIMES.iter().find(|(name, _)| *name == unit).map(|(_, s)| number * s).ok_or_else(form)?;
        let fits = (1.0..=MOST_SECONDS).contains(&seconds);
        if fits { Ok(Self::Seconds(seconds)) } else { Err("give at least 1 s, and at most 366 d".to_owned()) }
    }
}

impl Serialize for LogRotation {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bytes(bytes) => to.collect_str(&format_args!("{} kB", *bytes as f64 / 1000.0)),
            Self::Seconds(seconds) => to.collect_str(&format_args!("{seconds} s")),
        }
    }
}

impl<'de> Deserialize<'de> for LogRotation {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        String::deserialize(from)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_times_have_units() {
        let of = |text: &str| text.parse::<LogRotation>();
        assert_eq!(of("64 MB"), Ok(LogRotation::Bytes(64_000_000)));
        assert_eq!(of("1.5GB"), Ok(LogRotation::Bytes(1_500_000_000)));
        assert_eq!(of("10 min"), Ok(LogRotation::Seconds(600.0)));
        assert_eq!(of("1 d"), Ok(LogRotation::Seconds(86400.0)));
        for text in ["", "64", "MB", "-1 MB", "1 mb", "1 kB", "0 s", "inf s", "400 d", "1 MB 2"] {
            assert!(of(text).unwrap_err().starts_with("give "), "{text}");
        }
        for rotation in [LogRotation::Bytes(123_456), LogRotation::Seconds(0.1 + 7.2)] {
            let text = serde_json::to_string(&rotation).unwrap();
            assert_eq!(serde_json::from_str::<LogRotation>(&text).unwrap(), rotation, "{text}");
        }
    }
}

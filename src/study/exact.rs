//! Numbers in rows of JSON that are read back bit by bit: JSON has neither NaN nor infinities, so these are words.
//!
//! Finite numbers are written with as many digits as it takes to read the same number.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::stats::Window;

/// A number, or the word for one that JSON does not have.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(untagged)]
enum ExactNumber {
    Finite(f64),
    Word(String),
}

impl From<f64> for ExactNumber {
    fn from(x: f64) -> Self {
        if x.is_finite() { Self::Finite(x) } else { Self::Word(x.to_string()) }
    }
}

impl ExactNumber {
    fn value<E: serde::de::Error>(&self) -> Result<f64, E> {
        match self {
            Self::Finite(x) => Ok(*x),
            Self::Word(word) => word.parse().map_err(|_| E::custom(format!("{word:?} is not a number"))),
        }
    }
}

pub(super) fn serialize<S: Serializer>(x: &f64, to: S) -> Result<S::Ok, S::Error> {
    ExactNumber::from(*x).serialize(to)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    ExactNumber::deserialize(from)?.value()
}

/// The same for lists of numbers that may be missing.
pub(super) mod list {
    use super::*;

    pub fn serialize<S: Serializer>(numbers: &[Option<f64>], to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(numbers.iter().map(|x| x.map(ExactNumber::from)))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Option<f64>>, D::Error> {
        let numbers = Vec::<Option<ExactNumber>>::deserialize(from)?;
        numbers.iter().map(|x| x.as_ref().map(ExactNumber::value).transpose()).collect()
    }
}

/// The same for windows of a run: counts, and numbers that may be missing.
pub(super) mod windows {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct WindowRow(u64, u64, u64, #[serde(with = "super::list")] Vec<Option<f64>>);

    pub fn serialize<S: Serializer>(windows: &[Window], to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(windows.iter().map(|w| {
            let numbers = vec![Some(w.loss), Some(w.noise_share), w.mean_squared_error, w.end_error];
            WindowRow(w.from, w.ticks, w.ends, numbers)
        }))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Window>, D::Error> {
        let rows = Vec::<WindowRow>::deserialize(from)?;
        let window = |WindowRow(from, ticks, ends, numbers): WindowRow| match numbers[..] {
            [Some(loss), Some(noise_share), mean_squared_error, end_error] => {
                Ok(Window { from, ticks, loss, noise_share, mean_squared_error, end_error, ends })
            }
            _ => Err(serde::de::Error::custom("a window has four numbers")),
        };
        rows.into_iter().map(window).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Sample {
        #[serde(with = "super")]
        x: f64,
        #[serde(with = "super::list")]
        list: Vec<Option<f64>>,
        #[serde(with = "super::windows")]
        windows: Vec<Window>,
    }

    #[test]
    fn every_number_comes_back_as_it_was() {
        let numbers =
            [0.1 + 0.2, -0.0, 1.0, f64::MIN_POSITIVE / 8.0, f64::MAX, f64::NAN, f64::INFINITY, -f64::INFINITY];
        for x in numbers {
            let window = Window { from: 3, ticks: 4, loss: x, mean_squared_error: Some(x), ..Window::default() };
            let sample = Sample { x, list: vec![Some(x), None], windows: vec![window] };
            let text = serde_json::to_string(&sample).unwrap();
            let again: Sample = serde_json::from_value(serde_json::from_str(&text).unwrap()).unwrap();
            assert_eq!(again.x.to_bits(), x.to_bits(), "{text}");
            assert_eq!(again.list[0].unwrap().to_bits(), x.to_bits(), "{text}");
            assert_eq!((again.list[1], again.windows[0].end_error), (None, None));
            assert_eq!(again.windows[0].mean_squared_error.unwrap().to_bits(), x.to_bits());
        }
    }
}

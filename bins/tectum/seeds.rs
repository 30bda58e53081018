//! The seeds of a study on the command line: a number of them, or a range.

use std::str::FromStr;

use tectum::study::{SeedRange, StudyError};

/// The largest seed that a scenario can hold.
const LARGEST_SEED: u64 = i64::MAX as u64;
/// Most seeds of a study.
const MOST_SEEDS: u64 = 1_000_000;

/// `--seeds N`, `--seeds A..B` (B is not among them) or `--seeds A..=B`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeedsArgument {
    /// So many from the first seed on.
    Count(u64),
    /// These.
    Range(SeedRange),
}

impl FromStr for SeedsArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let why = "give a number of seeds, or a range such as 1000..1010, in which 1010 is not";
            text.trim().parse::<u64>().map_err(|_| why.to_owned())
        };
        let Some((first, end)) = text.split_once("..") else {
            return number(text).map(Self::Count);
        };
        let first = number(first)?;
        let end = match end.strip_prefix('=') {
            Some(last) => number(last)?.checked_add(1).ok_or("give smaller seeds")?,
            None => number(end)?,
        };
        if first >= end {
            return Err("the range is empty; give a last seed that is larger than the first".to_owned());
        }
        Ok(Self::Range(SeedRange { first, end }))
    }
}

impl SeedsArgument {
    /// The seeds; a number of them counts from `first` on.
    ///
    /// # Errors
    ///
    /// When there are none, or some that are too large.
    pub fn range(self, first: u64) -> Result<SeedRange, StudyError> {
        let asked = |text: &str| StudyError::Asked(text.to_owned());
        let range = match self {
            Self::Count(0) => return Err(asked("--seeds is 0; give at least 1")),
            Self::Count(count) => first.checked_add(count).map(|end| SeedRange { first, end }),
            Self::Range(range) => Some(range),
        };
        let range = range.filter(|range| range.end <= LARGEST_SEED + 1);
        let too_large = || asked("--first-seed and --seeds go beyond the largest seed; give smaller ones");
        let range = range.ok_or_else(too_large)?;
        if range.end - range.first > MOST_SEEDS {
            return Err(asked(&format!("--seeds gives more than {MOST_SEEDS} seeds; give fewer")));
        }
        Ok(range)
    }
}

//! The value parser of `--ticks` and of every other option that takes a number of ticks.
//!
//! Runs are millions of ticks long, so a count may be written as `1e6`, `1.5e6`, `1_000_000` or `1,000,000`. It is read
//! digit by digit, never through a floating-point number, so that every value up to the largest is exact.

const EXAMPLES: &str = "give a whole number of ticks, such as 3600, 1_000_000, 1,000,000 or 1e6";

/// Largest accepted count. Counts are 64-bit throughout; scenarios set tighter limits of their own.
const LARGEST: u64 = u64::MAX;

/// Reads a number of ticks.
///
/// # Errors
///
/// One sentence that says why the text is not a number of ticks, and what would be one.
pub fn tick_count(text: &str) -> Result<u64, String> {
    if text.trim().is_empty() {
        return Err(format!("it is empty; {EXAMPLES}"));
    }
    let not_a_number = || format!("it is not a number; {EXAMPLES}");
    let (negative, unsigned) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().map_err(|_| not_a_number())?),
        None => (unsigned, 0),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    if mantissa.ends_with('.') || !is_digits(fraction) {
        return Err(not_a_number());
    }
    let whole = without_separators(whole)?.ok_or_else(not_a_number)?;
    if negative {
        return Err(format!("it is negative; {EXAMPLES}"));
    }
    shifted(&whole, fraction, exponent)
}

/// The digits of a whole number without its separators; `None` if it is not a number.
///
/// An underscore may stand between any two digits, as in TOML and Rust. A comma must separate groups of three digits:
/// many languages write a fraction as `1,5`, which must not be read as 15.
fn without_separators(whole: &str) -> Result<Option<String>, String> {
    if whole.contains(',') {
        let groups: Vec<&str> = whole.split(',').collect();
        if !groups.iter().all(|group| is_digits(group)) {
            return Ok(None);
        }
        if !(1..=3).contains(&groups[0].len()) || groups[1..].iter().any(|group| group.len() != 3) {
            return Err(format!("a comma may only separate groups of three digits; {EXAMPLES}"));
        }
    }
    let mut parts = whole.split(['_', ',']);
    Ok(parts.all(|part| !part.is_empty() && is_digits(part)).then(|| whole.replace(['_', ','], "")))
}

/// `whole.fraction * 10^exponent`, if that is a whole number which fits.
fn shifted(whole: &str, fraction: &str, exponent: i32) -> Result<u64, String> {
    let digits = format!("{whole}{fraction}");
    let digits = digits.trim_start_matches('0');
    if digits.is_empty() {
        return Ok(0);
    }
    let zeros = i64::from(exponent) - fraction.len() as i64;
    let too_large = || format!("it is too large; give at most {LARGEST}");
    let exact = if zeros >= 0 {
        // Twenty digits are all that 64 bits can hold.
        if zeros > 20 {
            return Err(too_large());
        }
        format!("{digits}{}", "0".repeat(zeros as usize))
    } else {
        let cut = usize::try_from(-zeros).unwrap_or(usize::MAX);
        match digits.len().checked_sub(cut) {
            Some(kept) if digits[kept..].bytes().all(|digit| digit == b'0') => digits[..kept].to_owned(),
            _ => return Err(format!("it is a fraction; {EXAMPLES}")),
        }
    };
    exact.parse().map_err(|_| too_large())
}

fn is_digits(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_digit())
}

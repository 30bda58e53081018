//! Numbers as text for people.

/// A whole number with its thousands set apart: `1,234,567`.
pub fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A time in its two greatest units: `4 s`, `3:05 min`, `2:05 h`.
pub fn duration(seconds: f64) -> String {
    if !(0.0..3.6e8).contains(&seconds) {
        return "?".to_owned();
    }
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{}:{:02} min", whole / 60, whole % 60),
        _ => format!("{}:{:02} h", whole / 3600, whole % 3600 / 60),
    }
}

/// Three significant digits; `-` for what is no number.
pub(crate) fn short(x: f64) -> String {
    let size = x.abs();
    if !x.is_finite() {
        "-".to_owned()
    } else if size == 0.0 {
        "0".to_owned()
    } else if !(1e-3..1e6).contains(&size) {
        format!("{x:.1e}")
    } else {
        let digits = (2.0 - size.log10().floor()).clamp(0.0, 5.0) as usize;
        format!("{x:.digits$}")
    }
}

/// A time in us, in the unit that suits it.
pub(crate) fn micros(us: f64) -> String {
    if us.is_finite() && us.abs() < 999.5 { format!("{} us", short(us)) } else { format!("{} ms", short(us / 1e3)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!([0, 999, 1000, 1_234_567].map(thousands), ["0", "999", "1,000", "1,234,567"]);
        let times = [3.6, 59.6, 185.0, 7500.0, f64::NAN, -1.0].map(duration);
        assert_eq!(times, ["4 s", "1:00 min", "3:05 min", "2:05 h", "?", "?"]);
        let numbers = [0.0, 0.01234, 1.5, 123.4, 12345.0, 1e-7, -2.0, f64::NAN].map(short);
        assert_eq!(numbers, ["0", "0.0123", "1.50", "123", "12345", "1.0e-7", "-2.00", "-"]);
        assert_eq!([31.2, 1500.0].map(micros), ["31.2 us", "1.50 ms"]);
    }
}

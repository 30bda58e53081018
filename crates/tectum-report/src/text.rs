//! Numbers, tables and dates as text, in one form everywhere. A leaf: it knows nothing of runs or logs.

use std::fmt::Write as _;

/// Rows of cells as text: the first column to the left, the others to the right, each as wide as its widest cell.
pub fn columns<R: AsRef<[String]>>(rows: &[R]) -> String {
    let count = rows.iter().map(|row| row.as_ref().len()).max().unwrap_or(0);
    let width = |column: usize| rows.iter().filter_map(|row| row.as_ref().get(column)).map(|c| c.chars().count()).max();
    let widths: Vec<usize> = (0..count).map(|column| width(column).unwrap_or(0)).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (i, (cell, &width)) in row.as_ref().iter().zip(&widths).enumerate() {
            let _ = if i == 0 { write!(line, "{cell:<width$}") } else { write!(line, "  {cell:>width$}") };
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// A whole number with its thousands set apart: 11,999,920 instead of 11999920.
pub fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Three significant figures, which is what a mean over a window is good for; `-` for none.
pub fn figures(value: Option<f64>) -> String {
    let Some(x) = value.filter(|x| x.is_finite()) else { return "-".into() };
    if x == 0.0 {
        return "0".into();
    }
    let magnitude = x.abs().log10().floor();
    if !(-5.0..6.0).contains(&magnitude) {
        return format!("{x:.2e}");
    }
    format!("{x:.*}", (2.0 - magnitude).max(0.0) as usize)
}

/// An instant, s since 1970, as date and time: `2026-12-31 23:59:59 UTC`.
pub fn utc(seconds: u64) -> String {
    format!("{}:{:02} UTC", date_and_minute(seconds), seconds % 60)
}

/// An instant, s since 1970, as date and minute: `2026-12-31 23:59 UTC`.
pub fn utc_minute(seconds: u64) -> String {
    format!("{} UTC", date_and_minute(seconds))
}

fn date_and_minute(seconds: u64) -> String {
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    // Days to year, month and day of the proleptic Gregorian calendar, with years that begin in March (Howard
    // Hinnant's `civil_from_days`).
    let shifted = days + 719_468;
    let (era, of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}", of_day / 3600, of_day / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_set_apart() {
        assert_eq!([0, 80, 999, 1000, 11_999_920].map(thousands), ["0", "80", "999", "1,000", "11,999,920"]);
    }

    #[test]
    fn three_figures_whatever_the_size() {
        let all = [12.3456, 0.0, 1234.0, 0.00123456, 1e9, -0.5, f64::NAN].map(|x| figures(Some(x)));
        assert_eq!(all, ["12.3", "0", "1234", "0.00123", "1.00e9", "-0.500", "-"]);
    }

    #[test]
    fn instants_become_dates() {
        for (seconds, text) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_782_399, "2000-02-28 23:59:59 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (1_709_210_096, "2024-02-29 12:34:56 UTC"),
            (1_767_225_599, "2025-12-31 23:59:59 UTC"),
            (1_798_761_599, "2026-12-31 23:59:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            assert_eq!(utc(seconds), text);
        }
        assert_eq!(utc_minute(0), "1970-01-01 00:00 UTC");
        assert_eq!(utc_minute(1_767_225_599), "2025-12-31 23:59 UTC");
    }
}

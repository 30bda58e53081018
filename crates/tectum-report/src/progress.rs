//! How far a run's learner got: rows of a table, and one sentence computed from the tests.
//!
//! A policy is tested without exploration noise on a fixed set of targets; what the run itself observed is
//! beside it. Rows hold only what was measured: a missing value is `-` in the table and null in JSON.

use serde::Serialize;

use crate::text::{columns, figures};

/// One row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProgressRow {
    /// When, in words: `untrained`, `after 10 s`, `before the block`.
    pub when: String,
    /// The same as ticks done.
    pub tick: u64,
    /// Error at a target's end of the policy without exploration noise, m: the median over the test's targets.
    pub test_error_m: Option<f64>,
    /// The same of the movements of least loss.
    pub optimum_error_m: Option<f64>,
    /// Error at a target's end as the run observed it, with exploration noise, m: the median over `targets` targets of
    /// the run.
    pub error_m: Option<f64>,
    /// Loss a tick as the run observed it, likewise.
    pub loss: Option<f64>,
    /// Loss a tick of the movements of least loss: the median over the test's targets.
    pub optimum_loss: Option<f64>,
    /// Whole targets of the run over which `error_m` and `loss` are medians.
    pub targets: usize,
    /// Whether these are the first targets after `tick`; otherwise they are the last before.
    #[serde(skip)]
    pub targets_follow: bool,
}

/// How soon a learner reached its targets, and kept reaching them, in one phase of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reached {
    /// What the phase began with, such as `joint 3 blocked`; null for the beginning of the run.
    pub event: Option<String>,
    /// First tick of the phase.
    pub from_tick: u64,
    /// The smallest of [`REACHES_M`] that the test error reached and stayed within until the phase's end, m;
    /// null if none.
    pub within_m: Option<f64>,
    /// Seconds of the plant's time until then; 0 if it was so from the beginning of the phase.
    pub after_s: Option<f64>,
    /// The smallest that was reached and kept much sooner, after at most a fifth of `after_s`, m; null if none.
    pub soon_within_m: Option<f64>,
    /// Seconds until then.
    pub soon_after_s: Option<f64>,
    /// Length of the phase, s.
    pub phase_s: f64,
}

/// The distances that the sentence chooses from, m.
pub const REACHES_M: [f64; 6] = [0.05, 0.07, 0.10, 0.15, 0.20, 0.30];
/// Tests in a row that it takes to call a distance kept.
const TESTS_TO_KEEP: usize = 3;
/// Part of the time to the smallest distance within which a larger one is reported as well.
const SOON: f64 = 0.2;

impl Reached {
    /// What the tests of a phase show: pairs of seconds since its beginning and error, m, in order. `None` if
    /// they are too few to say anything.
    pub fn of(event: Option<String>, from_tick: u64, phase_s: f64, tests: &[(f64, f64)]) -> Option<Self> {
        if tests.len() < TESTS_TO_KEEP {
            return None;
        }
        let kept = |within: f64| {
            // An error that is not a number is within nothing.
            let kept = tests.iter().rev().take_while(|(_, error)| *error <= within).count();
            (kept >= TESTS_TO_KEEP).then(|| (within, tests[tests.len() - kept].0))
        };
        let found = REACHES_M.into_iter().find_map(kept);
        let is_soon = |(_, after): &(f64, f64)| found.is_some_and(|(_, last)| *after <= SOON * last && *after < last);
        let soon = REACHES_M.into_iter().filter_map(kept).find(is_soon);
        Some(Self {
            event,
            from_tick,
            within_m: found.map(|f| f.0),
            after_s: found.map(|f| f.1),
            soon_within_m: soon.map(|f| f.0),
            soon_after_s: soon.map(|f| f.1),
            phase_s,
        })
    }

    /// A part of the sentence.
    fn in_words(&self) -> String {
        let within = |m: f64| format!("within {:.0} cm", m * 100.0);
        let least = within(REACHES_M[REACHES_M.len() - 1]);
        let found = self.within_m.zip(self.after_s);
        let soon = self.soon_within_m.zip(self.soon_after_s);
        // What came first; what came later follows.
        let first = soon.or(found);
        let later = found.filter(|_| soon.is_some());
        let later = later.map_or(String::new(), |(m, after)| format!(", {} after {}", within(m), duration(after)));
        match (&self.event, first) {
            (None, Some((m, 0.0))) => format!("is {} from the start{later}", within(m)),
            (None, Some((m, after))) => format!("reaches {} after {}{later}", within(m), duration(after)),
            (None, None) => format!("does not reach and stay {least} in {}", duration(self.phase_s)),
            (Some(event), Some((m, 0.0))) => format!("stays {} after {event}{later}", within(m)),
            (Some(event), Some((m, after))) => format!("back {} {} after {event}{later}", within(m), duration(after)),
            (Some(event), None) => format!("not back {least} in the {} after {event}", duration(self.phase_s)),
        }
    }
}

/// The sentence over all phases; `None` if there is nothing to say.
pub fn sentence(reached: &[Reached]) -> Option<String> {
    let parts: Vec<String> = reached.iter().map(Reached::in_words).collect();
    let text = parts.join("; ");
    let mut letters = text.chars();
    let first = letters.next()?.to_uppercase();
    Some(format!("{first}{}", letters.as_str()))
}

/// A time in the unit that suits it: `9 s`, `12 min`, `3.5 h`, `2.1 days`.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 10.0 && s.fract() != 0.0 => format!("{s:.1} s"),
        s if s < 300.0 => format!("{s:.0} s"),
        s if s < 3.0 * 3600.0 => format!("{:.0} min", s / 60.0),
        s if s < 3.0 * 86_400.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

/// The rows as text, under a head with the units and above a line that says what they are, for a test of so
/// many targets. The first column is the test's error, or the observed one where nothing was tested.
pub fn progress_table(rows: &[ProgressRow], test_targets: usize) -> String {
    let tested = rows.iter().any(|row| row.test_error_m.is_some());
    let first = if tested { "test error (m)" } else { "error (m)" };
    let head = ["", first, "optimum (m)", "loss a tick", "optimum", "observed over"];
    let mut cells = vec![head.map(str::to_owned)];
    for row in rows {
        let which = if row.targets_follow { "next" } else { "last" };
        let targets = match row.targets {
            0 => "-".to_owned(),
            1 => format!("{which} target"),
            n => format!("{which} {n} targets"),
        };
        cells.push([
            row.when.clone(),
            figures(if tested { row.test_error_m } else { row.error_m }),
            figures(row.optimum_error_m),
            figures(row.loss),
            figures(row.optimum_loss),
            targets,
        ]);
    }
    let known = rows.iter().any(|row| row.optimum_loss.is_some());
    let optimum = |before: &str, targets: &str| match known {
        true => format!(";{before}optimum: the movements of least loss to {targets}"),
        false => String::new(),
    };
    let words = if tested {
        format!(
            "Test error: at a target's end, without exploration noise, over {test_targets} test targets;\n\
             loss: as observed, with noise{}",
            optimum(" ", "the test targets")
        )
    } else {
        format!(
            "Error at a target's end, and loss: as observed, with noise{}",
            optimum("\n", &format!("{test_targets} other targets"))
        )
    };
    format!("{}Medians. {words}.\n", columns(&cells))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Event and tests of a phase.
    type PhaseTests<'a> = (Option<&'a str>, &'a [(f64, f64)]);

    fn reached(event: Option<&str>, tests: &[(f64, f64)]) -> Option<Reached> {
        Reached::of(event.map(str::to_owned), 0, 60.0, tests)
    }

    #[test]
    fn the_smallest_distance_that_was_kept_counts() {
        let tests = [(1.0, 0.9), (2.0, 0.06), (3.0, 0.12), (4.0, 0.068), (5.0, 0.04), (6.0, 0.05), (7.0, 0.066)];
        let one = reached(None, &tests).unwrap();
        assert_eq!((one.within_m, one.after_s), (Some(0.07), Some(4.0)), "5 cm was not kept, and 7 cm not at 2 s");
        assert_eq!(reached(None, &tests[..2]), None, "too few tests");
        // The last two alone are no proof.
        let late = [(1.0, 0.9), (2.0, 0.9), (3.0, 0.01), (4.0, 0.01)];
        assert_eq!(reached(None, &late).unwrap().within_m, None);
        let diverged = [(1.0, 0.01), (2.0, 0.01), (3.0, 0.01), (4.0, f64::NAN)];
        assert_eq!(reached(None, &diverged).unwrap().within_m, None);
    }

    #[test]
    fn a_larger_distance_that_was_kept_much_sooner_is_reported_too() {
        let mut tests: Vec<_> = (1..=100).map(|s| (f64::from(s), 0.12)).collect();
        tests[..9].iter_mut().for_each(|test| test.1 = 0.8);
        tests[49..].iter_mut().for_each(|test| test.1 = 0.06);
        let one = reached(None, &tests).unwrap();
        assert_eq!((one.within_m, one.after_s), (Some(0.07), Some(50.0)));
        assert_eq!((one.soon_within_m, one.soon_after_s), (Some(0.15), Some(10.0)));
        assert_eq!(sentence(&[one]).unwrap(), "Reaches within 15 cm after 10 s, within 7 cm after 50 s");
        tests[..20].iter_mut().for_each(|test| test.1 = 0.8);
        assert_eq!(reached(None, &tests).unwrap().soon_within_m, None);
    }

    #[test]
    fn the_sentence_holds_what_was_measured() {
        let good = [(0.0, 0.9), (4.0, 0.06), (5.0, 0.06), (6.0, 0.06)];
        let bad = [(0.0, 0.9), (4.0, 0.9), (5.0, 0.9)];
        let block = Some("joint 3 blocked");
        let text = |parts: &[PhaseTests]| {
            let all: Vec<Reached> = parts.iter().filter_map(|(event, tests)| reached(*event, tests)).collect();
            sentence(&all).unwrap_or_default()
        };
        assert_eq!(
            text(&[(None, &good), (block, &good)]),
            "Reaches within 7 cm after 4 s; back within 7 cm 4 s after joint 3 blocked"
        );
        assert_eq!(
            text(&[(None, &bad), (block, &bad)]),
            "Does not reach and stay within 30 cm in 60 s; not back within 30 cm in the 60 s after joint 3 blocked"
        );
        assert_eq!(
            text(&[(block, &good[1..].iter().map(|t| (t.0 - 4.0, t.1)).collect::<Vec<_>>())]),
            "Stays within 7 cm after joint 3 blocked"
        );
        assert_eq!(text(&[]), "");
    }

    #[test]
    fn times_have_the_unit_that_people_count_in() {
        let all = [0.5, 9.0, 240.0, 720.0, 20_000.0, 300_000.0].map(duration);
        assert_eq!(all, ["0.5 s", "9 s", "240 s", "12 min", "5.6 h", "3.5 days"]);
    }

    #[test]
    fn the_table_shows_what_is_unknown_as_such() {
        let row = |when: &str, test_error_m, loss, targets, targets_follow| ProgressRow {
            when: when.to_owned(),
            tick: 0,
            test_error_m,
            optimum_error_m: None,
            error_m: Some(0.051),
            loss,
            optimum_loss: Some(0.0171),
            targets,
            targets_follow,
        };
        let rows =
            [row("untrained", Some(2.5), None, 0, false), row("just after the block", None, Some(0.0312), 1, true)];
        let text = progress_table(&rows, 40);
        let expected = [
            "                      test error (m)  optimum (m)  loss a tick  optimum  observed over",
            "untrained                       2.50            -            -   0.0171              -",
            "just after the block               -            -       0.0312   0.0171    next target",
        ];
        assert_eq!(text.lines().take(3).collect::<Vec<_>>(), expected);
        assert!(text.contains("over 40 test targets"));
        let text = progress_table(&rows[1..], 40);
        assert!(text.starts_with("                      error (m)  optimum (m)"), "{text}");
        let words = "with noise;\noptimum: the movements of least loss to 40 other targets.";
        assert!(text.contains("just after the block     0.0510") && text.ends_with(&format!("{words}\n")), "{text}");
    }
}

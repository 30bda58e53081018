//! The timestamps and headers of a run. In lockstep they are a function of the tick. In real time, only the
//! relations between them can be checked.

use super::sample_diff::Difference;
use crate::log::RunLog;
use crate::scenario::Plan;
use crate::wire::Header;

/// Computes and checks the headers of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct StampChecker {
    /// The run's id.
    pub run: u64,
    /// Whether the run was in lockstep, so that all timestamps are scheduled times.
    pub lockstep: bool,
    t0_ns: u64,
    period_ns: u64,
}

impl StampChecker {
    /// The checker for the run in `log`.
    pub fn of(log: &RunLog, plan: &Plan) -> Self {
        Self {
            run: log.run("run").and_then(|run| u64::from_str_radix(run, 16).ok()).unwrap_or(0),
            lockstep: log.run("clock") == Some(crate::log::LogClock::Virtual.name()),
            t0_ns: log.run("t0_ns").and_then(|ns| ns.parse().ok()).unwrap_or(0),
            period_ns: plan.period_ns,
        }
    }

    fn scheduled(&self, tick: u64) -> u64 {
        self.t0_ns.wrapping_add(tick.wrapping_mul(self.period_ns))
    }

    /// Sets the timestamps of an observation. In real time, those of sensing and publication stay as they
    /// are.
    pub fn stamp_observation(&self, header: &mut Header) {
        header.scheduled_ns = self.scheduled(header.tick);
        if self.lockstep {
            header.sensed_ns = header.scheduled_ns;
            header.published_ns = header.scheduled_ns;
        }
    }

    /// Sets the header of an answer to `observation`, by a writer of at least this `incarnation`. In real
    /// time, the timestamp of publication is taken from `logged`.
    pub fn stamp_answer(
        &self,
        header: &mut Header,
        observation: &Header,
        sequence: u64,
        incarnation: u32,
        logged: &Header,
    ) {
        header.run = self.run;
        header.sequence = sequence;
        header.scheduled_ns = observation.scheduled_ns;
        header.sensed_ns = observation.sensed_ns;
        header.published_ns = if self.lockstep { observation.scheduled_ns } else { logged.published_ns };
        header.incarnation = logged.incarnation.max(incarnation);
    }

    /// Checks that nothing is sensed before its scheduled time, or published before it was sensed.
    pub fn check_order(&self, header: &Header, channel: &'static str) -> Result<(), Box<Difference>> {
        let (scheduled, sensed, published) = (header.scheduled_ns, header.sensed_ns, header.published_ns);
        let at_least = |field: &str, logged: u64, bound: u64| {
            if logged >= bound {
                return Ok(());
            }
            Err(Box::new(Difference {
                tick: header.tick,
                channel,
                field: format!("header.{field}"),
                logged: logged.to_string(),
                replayed: format!("at least {bound}"),
            }))
        };
        at_least("sensed_ns", sensed, scheduled)?;
        at_least("published_ns", published, sensed)
    }
}

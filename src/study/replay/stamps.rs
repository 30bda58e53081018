//! The stamps of a run: in lockstep a function of the tick, in real time as far as one follows from another.

use super::compare::Difference;
use crate::log::RunLog;
use crate::scenario::Plan;
use crate::wire::Header;

/// What is known of a run's stamps.
#[derive(Debug, Clone, Copy)]
pub struct StampChecker {
    /// The run's id.
    pub run: u64,
    /// Time is the tick's.
    pub lockstep: bool,
    t0_ns: u64,
    period_ns: u64,
}

impl StampChecker {
    /// The clock of the run in `log`.
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

    /// The stamps of an observation; in real time, when it was sensed and published is taken as it stands.
    pub fn stamp_observation(&self, header: &mut Header) {
        header.scheduled_ns = self.scheduled(header.tick);
        if self.lockstep {
            header.sensed_ns = header.scheduled_ns;
            header.published_ns = header.scheduled_ns;
        }
    }

    /// The header of an answer to `observation`, by a writer that has been started at least `incarnation` times anew; in
    /// real time, when it was published is taken as `logged`.
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

    /// Nothing is sensed before its time, nor published before it was sensed.
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

//! The bridge's report: duration of bus instructions, and every time that torque went off.
//!
//! It is one report for all bridges of a run: a bridge that takes the place of one that was killed goes on from the
//! counts in the file.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use serde::{Deserialize, Serialize};

use crate::stats::Percentiles;

use super::safety::{SafetyState, TripCause};
use super::vision::{VisionInput, VisionReport};
use super::{Bridge, BusError};

/// An event in which torque went off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TripEvent {
    /// The tick.
    pub tick: u64,
    /// The cause.
    pub cause: TripCause,
    /// The first servo without a valid answer, if that is the cause.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub servo: Option<u8>,
}

/// The greatest number of events in a report, so that a fault that repeats for hours does not fill the memory.
pub(super) const MAX_EVENTS: usize = 1000;

/// The report that the bridge writes to `bridge.json` in the run's folder. The counts are those of all bridges of the
/// run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct BridgeReport {
    /// Number of bridges that had the run before this one, because they were killed or gave up.
    #[serde(default)]
    pub earlier_bridges: u64,
    /// Number of ticks.
    pub ticks: u64,
    /// Number of ticks in which not all servos answered.
    pub blind: u64,
    /// Number of ticks whose goals could not be written.
    pub unwritten: u64,
    /// Number of times that torque went on.
    pub armed: u64,
    /// Events in which torque went off before the end.
    pub events: Vec<TripEvent>,
    /// Number of ticks without torque, by the reason.
    #[serde(default)]
    pub without_torque: BTreeMap<String, u64>,
    /// Why torque was off at the end of the last bridge, if its safety had turned it off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off_at_end: Option<TripCause>,
    /// Duration of a tick's synchronous read by the last bridge, us.
    pub bus_read: Option<Percentiles>,
    /// Duration of a tick's synchronous write by the last bridge, us.
    pub bus_write: Option<Percentiles>,
    /// The last bridge's report on the trackers, if the scenario uses them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision: Option<VisionReport>,
}

impl BridgeReport {
    /// Counts a tick without torque in this state.
    pub(super) fn count_without_torque(&mut self, state: SafetyState) {
        let reason = match state {
            SafetyState::Tripped(cause) if cause.leaves_torque_unknown() => format!("torque unknown: {cause}"),
            SafetyState::Tripped(cause) => cause.to_string(),
            SafetyState::ReadOnly => "not armed".to_owned(),
            SafetyState::Ready | SafetyState::Driving => "no command yet".to_owned(),
        };
        *self.without_torque.entry(reason).or_default() += 1;
    }

    /// This report with the counts of the bridges before, whose report is `earlier`.
    pub(super) fn after(mut self, earlier: &Self) -> Self {
        self.earlier_bridges += earlier.earlier_bridges;
        self.ticks += earlier.ticks;
        self.blind += earlier.blind;
        self.unwritten += earlier.unwritten;
        self.armed += earlier.armed;
        let later = std::mem::replace(&mut self.events, earlier.events.clone());
        self.events.extend(later);
        self.events.truncate(MAX_EVENTS);
        for (reason, ticks) in &earlier.without_torque {
            *self.without_torque.entry(reason.clone()).or_default() += ticks;
        }
        self
    }
}

/// The report of the run's earlier bridges at `path`, with one bridge more; an empty one if there was none.
pub(super) fn earlier(path: &Path) -> Result<BridgeReport, String> {
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(BridgeReport::default()),
        Err(error) => return Err(error.to_string()),
    };
    let report: BridgeReport = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    Ok(BridgeReport { earlier_bridges: report.earlier_bridges + 1, ..report })
}

/// The report's file, written on a thread of its own, so that no tick waits for a disk.
pub(super) struct ReportFile {
    path: PathBuf,
    queue: SyncSender<BridgeReport>,
    thread: JoinHandle<()>,
}

impl ReportFile {
    pub fn new(path: PathBuf) -> Self {
        let (queue, reports) = sync_channel::<BridgeReport>(1);
        let to = path.clone();
        let thread = std::thread::spawn(move || reports.iter().for_each(|report| write(&to, &report)));
        Self { path, queue, thread }
    }

    /// Passes a report on. While the one before is still being written, it is left out.
    pub fn pass(&mut self, report: BridgeReport) {
        let _ = self.queue.try_send(report);
    }

    /// Writes the last report.
    pub fn finish(self, report: &BridgeReport) {
        drop(self.queue);
        let _ = self.thread.join();
        write(&self.path, report);
    }
}

/// Replaces the file by the report, whole. A missing report does not make the run fail.
fn write(path: &Path, report: &BridgeReport) {
    let text = serde_json::to_string_pretty(report).unwrap_or_default();
    let new = path.with_extension("json.new");
    let _ = std::fs::write(&new, text).and_then(|()| std::fs::rename(&new, path));
}

impl Bridge {
    /// Writes the report to `path` once a second, and when the bridge is dropped. The counts of a report that is there
    /// already are those of the run's earlier bridges, and are kept.
    pub fn write_report_to(&mut self, path: PathBuf) {
        match earlier(&path) {
            Ok(earlier) => self.earlier = earlier,
            Err(why) => (self.notify)(&format!("{}: {why}; the counts of earlier bridges are lost", path.display())),
        }
        // At once, so that a bridge that is killed in its first second counts too.
        write(&path, &self.whole_report());
        self.report_file = Some(ReportFile::new(path));
    }

    /// Reports a change of the safety state to the user and in the report.
    pub(super) fn report_transition(&mut self, tick: u64, before: SafetyState) {
        let state = self.safety.state();
        if state == before {
            return;
        }
        let text = match state {
            SafetyState::ReadOnly => "read-only".to_owned(),
            SafetyState::Ready => "armed; torque goes on with the next command".to_owned(),
            SafetyState::Driving => "torque is on".to_owned(),
            SafetyState::Tripped(cause) => {
                let then = match self.safety.recovers(cause) {
                    true => "it goes on by itself when that is over and all checks pass",
                    false => "arm it again to go on",
                };
                let unknown = cause.leaves_torque_unknown();
                let silence = match cause {
                    TripCause::BusLost => self.silence.as_ref(),
                    TripCause::LeaderLost => self.leader.as_ref().and_then(|leader| leader.silence.as_ref()),
                    _ => None,
                };
                let cause = match silence {
                    Some(silence) => format!("{cause} ({silence})"),
                    None => cause.to_string(),
                };
                match unknown {
                    true => format!(
                        "torque may still be on: {cause}; it is turned off first when the servos answer; {then}"
                    ),
                    false => format!("torque is off: {cause}; {then}"),
                }
            }
        };
        (self.notify)(&format!("tick {tick}: {text}"));
        match state {
            SafetyState::Driving => self.report.armed += 1,
            SafetyState::Tripped(cause) if self.report.events.len() < MAX_EVENTS => {
                let servo = match &self.silence {
                    Some(BusError::NoAnswer { id, .. }) if cause == TripCause::BusLost => Some(*id),
                    _ => None,
                };
                self.report.events.push(TripEvent { tick, cause, servo });
            }
            _ => {}
        }
        self.pass_report();
    }

    /// The report on this bridge and the run's earlier ones.
    fn whole_report(&self) -> BridgeReport {
        let mut report = self.report.clone();
        [report.bus_read, report.bus_write] = [Percentiles::of(&self.times[0]), Percentiles::of(&self.times[1])];
        report.vision = self.vision.as_ref().map(VisionInput::final_report);
        report.after(&self.earlier)
    }

    /// Passes the report on to its file, so that a bridge that is killed loses the counts of a second at most.
    pub(super) fn pass_report(&mut self) {
        if let Some(mut file) = self.report_file.take() {
            file.pass(self.whole_report());
            self.report_file = Some(file);
        }
    }

    /// Writes the report for the last time, if it has a file.
    pub(super) fn write_report(&mut self) {
        if let SafetyState::Tripped(cause) = self.safety.state() {
            self.report.off_at_end = Some(cause);
            if let Ok(mut ending) = self.presence.ending.lock() {
                *ending = Some(cause);
            }
        }
        if let Some(file) = self.report_file.take() {
            file.finish(&self.whole_report());
        }
    }
}

/// Converts ns to us.
pub(super) fn microseconds(ns: u64) -> f32 {
    ns as f32 / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bridge_goes_on_from_the_counts_of_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bridge.json");
        assert_eq!(earlier(&path).unwrap().earlier_bridges, 0);
        let count = |ticks: u64, tick: u64| {
            let mut report = BridgeReport { ticks, armed: 1, ..BridgeReport::default() };
            report.events.push(TripEvent { tick, cause: TripCause::Overload, servo: None });
            report.count_without_torque(SafetyState::Tripped(TripCause::Overload));
            report
        };
        let mut all = BridgeReport::default();
        for bridge in 0..3 {
            let before = earlier(&path).unwrap();
            assert_eq!(before.ticks, 10 * bridge);
            all = count(10, bridge).after(&before);
            // A report at the end of a second, and the last one; both have the counts of the earlier bridges once.
            let mut file = ReportFile::new(path.clone());
            file.pass(all.clone());
            file.finish(&all);
        }
        assert_eq!((all.earlier_bridges, all.ticks, all.armed), (2, 30, 3));
        assert_eq!(all.events.iter().map(|event| event.tick).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(all.without_torque["a servo is overloaded"], 3);
        std::fs::write(&path, "{").unwrap();
        assert!(earlier(&path).is_err());
    }
}

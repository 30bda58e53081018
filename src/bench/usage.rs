//! Resources that the processes of a run use while it runs: processor time, memory and cores, sampled from `/proc`.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;

use crate::clock::{cpu_ns_of_thread, monotonic_ns, pause, process_cpu_ns};

/// The beginning of a process's name in `/proc` (which has at most 15 letters), and its role.
const PROCESSES: [(&str, &str); 3] =
    [("tectum-simul", "plant"), ("tectum-contr", "controller"), ("tectum-logge", "logger")];

/// What one process used between the first sample and the last.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct ProcessUse {
    /// `plant`, `controller`, `logger` or `launcher`.
    pub process: &'static str,
    /// Processor time, ns.
    pub cpu_ns: u64,
    /// Resident memory (VmRSS) at the first sample, KiB.
    pub first_kib: u64,
    /// Resident memory at the last sample, KiB.
    pub last_kib: u64,
    /// The cores on which it ran.
    pub cores: BTreeSet<u32>,
}

/// What all processes of a run used, over one or more blocks.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct Usage {
    /// From the first sample to the last, s, all blocks together.
    pub seconds: f64,
    /// Processor time of all processes as a share of one core; null without time between the samples.
    pub share_of_a_core: Option<f64>,
    /// Each process; memory as in the longest block.
    pub processes: Vec<ProcessUse>,
    /// Duration of the longest block, s.
    #[serde(skip)]
    longest: f64,
}

impl Usage {
    /// Adds another block.
    pub fn add(&mut self, block: &Usage) {
        if block.processes.is_empty() {
            return;
        }
        let longer = block.seconds > self.longest;
        for used in &block.processes {
            match self.processes.iter_mut().find(|p| p.process == used.process) {
                Some(all) => {
                    all.cpu_ns += used.cpu_ns;
                    all.cores.extend(&used.cores);
                    if longer {
                        (all.first_kib, all.last_kib) = (used.first_kib, used.last_kib);
                    }
                }
                None => self.processes.push(used.clone()),
            }
        }
        self.seconds += block.seconds;
        self.longest = self.longest.max(block.seconds);
        let cpu: u64 = self.processes.iter().map(|p| p.cpu_ns).sum();
        self.share_of_a_core = (self.seconds > 0.0).then(|| cpu as f64 / 1e9 / self.seconds);
    }

    /// One line per process.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        if let Some(share) = self.share_of_a_core {
            let _ = writeln!(
                text,
                "processor time of all processes: {:.3} % of one core over {:.1} s",
                100.0 * share,
                self.seconds
            );
        }
        for p in &self.processes {
            let _ = writeln!(
                text,
                "  {:<11} {:>9.2} ms, resident {:.1} MiB at first, {:.1} MiB at last, on core {}",
                p.process,
                p.cpu_ns as f64 / 1e6,
                p.first_kib as f64 / 1024.0,
                p.last_kib as f64 / 1024.0,
                cores_text(&p.cores)
            );
        }
        text
    }
}

/// Core numbers, separated by commas.
pub(super) fn cores_text(cores: &BTreeSet<u32>) -> String {
    cores.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

/// The state of a process at one instant.
#[derive(Debug, Clone, Copy)]
struct UsageSample {
    cpu_ns: u64,
    resident_kib: u64,
    core: u32,
}

impl UsageSample {
    /// The state of process `pid`, all its threads together; `None` when it has ended.
    fn of(pid: u32) -> Option<Self> {
        Some(Self { cpu_ns: process_cpu_ns(pid)?, resident_kib: resident_kib(pid)?, core: core(&stat(pid)?)? })
    }
}

fn resident_kib(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().split(' ').next()?.parse().ok()
}

fn stat(pid: u32) -> Option<String> {
    fs::read_to_string(format!("/proc/{pid}/stat")).ok()
}

/// Field 39 of `stat`. The name in field 2 may contain any character.
fn core(stat: &str) -> Option<u32> {
    stat.rsplit_once(") ")?.1.split(' ').nth(36)?.parse().ok()
}

/// The core on which process `pid` ran last.
pub(super) fn core_of(pid: u32) -> Option<u32> {
    core(&stat(pid)?)
}

/// The run's processes among the children of this process, by role.
fn run_processes() -> Vec<(&'static str, u32)> {
    let parent = std::process::id().to_string();
    let mut found = Vec::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let Some(stat) = stat(pid) else { continue };
        let Some((name, rest)) = stat.split_once(" (").and_then(|(_, rest)| rest.rsplit_once(") ")) else { continue };
        if rest.split(' ').nth(1) != Some(&parent) {
            continue;
        }
        if let Some((_, role)) = PROCESSES.iter().find(|(prefix, _)| name.starts_with(prefix)) {
            found.push((*role, pid));
        }
    }
    found
}

/// Samples the processes of a run from another thread while it runs.
pub(super) struct UsageObserver {
    over: Arc<AtomicBool>,
    thread: JoinHandle<Usage>,
}

impl UsageObserver {
    /// Takes the first sample as soon as the run in `folder` has begun its ticks, then one every `every`.
    pub fn start(folder: &Path, every: Duration) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let (log, flag) = (folder.join(crate::log::LOG_FILE), Arc::clone(&over));
        // The launcher's loop runs in the calling thread.
        let launcher = rustix::thread::gettid().as_raw_pid();
        Self { over, thread: std::thread::spawn(move || observe(&log, every, &flag, launcher)) }
    }

    /// Ends the sampling. Returns what the run's processes used.
    pub fn finish(self) -> Usage {
        self.over.store(true, Ordering::Release);
        self.thread.thread().unpark();
        self.thread.join().unwrap_or_default()
    }
}

fn observe(log: &Path, every: Duration, over: &AtomicBool, launcher: i32) -> Usage {
    if !await_ticks(log, over) {
        return Usage::default();
    }
    let mut meter = UsageMeter::start(launcher);
    while sleep_unless_over(every, over) && meter.sample() {}
    meter.finish()
}

/// Waits until the ticks of a run have begun: its log then grows a second time after its first content. False
/// when the run is over before.
fn await_ticks(log: &Path, over: &AtomicBool) -> bool {
    const PACE_NS: u64 = 5_000_000;
    let (mut last, mut growths) = (0, 0);
    while growths < 3 {
        if over.load(Ordering::Acquire) {
            return false;
        }
        let size = fs::metadata(log).map_or(0, |m| m.len());
        growths += u32::from(size > last);
        last = size;
        pause(PACE_NS);
    }
    true
}

/// Sleeps for `every`. False when the run is over. The thread does not wake up in between: that would disturb
/// what is measured.
fn sleep_unless_over(every: Duration, over: &AtomicBool) -> bool {
    if over.load(Ordering::Acquire) {
        return false;
    }
    let next = monotonic_ns() + every.as_nanos() as u64;
    while monotonic_ns() < next {
        std::thread::park_timeout(Duration::from_nanos(next - monotonic_ns().min(next)));
        if over.load(Ordering::Acquire) {
            return false;
        }
    }
    true
}

/// The first sample of a run's processes, and what they have used since.
struct UsageMeter {
    /// Process id and first sample of each process.
    first: Vec<(u32, UsageSample)>,
    /// The use of each, in the same order.
    uses: Vec<ProcessUse>,
    launcher: ProcessUse,
    /// The launcher's thread, and its processor time at the first sample, ns.
    launcher_thread: i32,
    launcher_first_ns: u64,
    /// Instants of the first and the last sample, ns.
    began_ns: u64,
    ended_ns: u64,
}

impl UsageMeter {
    fn start(launcher_thread: i32) -> Self {
        let found = run_processes();
        let began_ns = monotonic_ns();
        let samples: Vec<_> =
            found.into_iter().filter_map(|(role, pid)| Some((role, pid, UsageSample::of(pid)?))).collect();
        let launcher_first_ns = cpu_ns_of_thread(launcher_thread);
        let kib = resident_kib(std::process::id()).unwrap_or(0);
        let unused = |process, kib, cores| ProcessUse { process, cpu_ns: 0, first_kib: kib, last_kib: kib, cores };
        Self {
            first: samples.iter().map(|&(_, pid, sample)| (pid, sample)).collect(),
            uses: samples.iter().map(|(role, _, s)| unused(*role, s.resident_kib, [s.core].into())).collect(),
            launcher: unused("launcher", kib, BTreeSet::new()),
            launcher_thread,
            launcher_first_ns,
            began_ns,
            ended_ns: began_ns,
        }
    }

    /// Takes another sample. False when a process has ended, because the run is then over.
    fn sample(&mut self) -> bool {
        let now: Vec<_> = self.first.iter().map_while(|&(pid, _)| UsageSample::of(pid)).collect();
        if now.len() < self.first.len() {
            return false;
        }
        self.ended_ns = monotonic_ns();
        for ((used, now), (_, first)) in self.uses.iter_mut().zip(&now).zip(&self.first) {
            used.cpu_ns = now.cpu_ns.saturating_sub(first.cpu_ns);
            used.last_kib = now.resident_kib;
            used.cores.insert(now.core);
        }
        let this = std::process::id();
        self.launcher.cpu_ns = cpu_ns_of_thread(self.launcher_thread).saturating_sub(self.launcher_first_ns);
        self.launcher.last_kib = resident_kib(this).unwrap_or(0);
        self.launcher.cores.extend(core_of(this));
        true
    }

    fn finish(mut self) -> Usage {
        let mut usage = Usage::default();
        if !self.uses.is_empty() {
            self.uses.push(self.launcher);
            let seconds = (self.ended_ns - self.began_ns) as f64 / 1e9;
            usage.add(&Usage { seconds, share_of_a_core: None, processes: self.uses, longest: 0.0 });
        }
        usage
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_running_process_can_be_sampled() {
        let sample = UsageSample::of(std::process::id()).unwrap();
        assert!(sample.cpu_ns > 0 && sample.resident_kib > 100);
        assert!(UsageSample::of(0).is_none());
        let line = "7 (a ) b) R 1 ".to_owned() + &"0 ".repeat(34) + "5 0 0";
        assert_eq!(core(&line), Some(5));
    }

    #[test]
    fn blocks_add_up_and_memory_is_that_of_the_longest() {
        let block = |seconds, cpu_ns, last_kib| Usage {
            seconds,
            processes: vec![ProcessUse { process: "plant", cpu_ns, first_kib: 5, last_kib, cores: [1].into() }],
            ..Usage::default()
        };
        let mut all = Usage::default();
        all.add(&Usage::default());
        for block in [block(1.0, 10_000_000, 6), block(2.0, 20_000_000, 7), block(1.0, 0, 8)] {
            all.add(&block);
        }
        assert_eq!((all.seconds, all.processes[0].last_kib), (4.0, 7));
        assert!((all.share_of_a_core.unwrap() - 0.0075).abs() < 1e-12);
        assert!(all.to_text().contains("0.750 % of one core") && all.to_text().contains("plant"));
    }
}

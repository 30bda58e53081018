//! What the processes of a run use while it runs: processor time, memory, cores; from `/proc`, as it stands.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;

use crate::clock::{monotonic_ns, pause};

/// The processes of a run as their names begin in `/proc` (15 letters at most), and what they are called here.
const PROCESSES: [(&str, &str); 3] =
    [("tectum-simul", "plant"), ("tectum-contr", "controller"), ("tectum-logge", "logger")];

/// What one process used between the first look and the last.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ProcessUse {
    /// `plant`, `controller`, `logger`, `launcher`.
    pub process: &'static str,
    /// Processor time, ns.
    pub cpu_ns: u64,
    /// Resident memory (VmRSS) at the first look, KiB.
    pub first_kib: u64,
    /// Resident memory at the last, KiB.
    pub last_kib: u64,
    /// The cores on which it was seen.
    pub cores: BTreeSet<u32>,
}

/// What a run's processes used together.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Usage {
    /// From the first look to the last, s, all blocks together.
    pub seconds: f64,
    /// Processor time of all processes as a share of one core; null where there was no time between the looks.
    pub share_of_a_core: Option<f64>,
    /// Each of them; memory as in the longest block.
    pub processes: Vec<ProcessUse>,
    /// The longest block, s.
    #[serde(skip)]
    longest: f64,
}

impl Usage {
    /// Takes another block in.
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

    /// One line a process.
    pub fn to_text(&self) -> String {
        use std::fmt::Write as _;
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
            let cores: Vec<_> = p.cores.iter().map(u32::to_string).collect();
            let _ = writeln!(
                text,
                "  {:<11} {:>9.2} ms, resident {:.1} MiB at first, {:.1} MiB at last, on core {}",
                p.process,
                p.cpu_ns as f64 / 1e6,
                p.first_kib as f64 / 1024.0,
                p.last_kib as f64 / 1024.0,
                cores.join(", ")
            );
        }
        text
    }
}

/// One look at a process.
#[derive(Debug, Clone, Copy)]
struct UsageSample {
    cpu_ns: u64,
    resident_kib: u64,
    core: u32,
}

impl UsageSample {
    /// All threads of process `pid`; `None` when it is gone.
    fn at(pid: u32) -> Option<Self> {
        Some(Self { cpu_ns: cpu_ns(pid)?, resident_kib: resident_kib(pid)?, core: core(&stat(pid)?)? })
    }
}

fn cpu_ns(pid: u32) -> Option<u64> {
    let mut sum = 0;
    for thread in fs::read_dir(format!("/proc/{pid}/task")).ok()?.flatten() {
        // Time on a core, time waiting for one, slices.
        // A thread that has ended meanwhile is none of the process's any more.
        let Ok(text) = fs::read_to_string(thread.path().join("schedstat")) else { continue };
        sum += text.split(' ').next()?.parse::<u64>().ok()?;
    }
    Some(sum)
}

fn resident_kib(pid: u32) -> Option<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().split(' ').next()?.parse().ok()
}

fn stat(pid: u32) -> Option<String> {
    fs::read_to_string(format!("/proc/{pid}/stat")).ok()
}

/// Field 39 of `stat`; the name in field 2 may hold anything.
fn core(stat: &str) -> Option<u32> {
    stat.rsplit_once(") ")?.1.split(' ').nth(36)?.parse().ok()
}

/// The core on which process `pid` was seen last.
pub(super) fn core_of(pid: u32) -> Option<u32> {
    core(&stat(pid)?)
}

/// The run's processes among the children of this one, and this one, their launcher.
fn processes() -> Vec<(&'static str, u32)> {
    let ours = std::process::id();
    let mut found = Vec::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let Some(stat) = stat(pid) else { continue };
        let Some((name, rest)) = stat.split_once(" (").and_then(|(_, rest)| rest.rsplit_once(") ")) else { continue };
        if rest.split(' ').nth(1) != Some(&ours.to_string()) {
            continue;
        }
        if let Some((_, role)) = PROCESSES.iter().find(|(begins, _)| name.starts_with(begins)) {
            found.push((*role, pid));
        }
    }
    found
}

/// Looks at a run's processes from another thread while it runs.
pub struct UsageObserver {
    over: Arc<AtomicBool>,
    thread: JoinHandle<Usage>,
}

impl UsageObserver {
    /// Begins to look as soon as ticks run in the run in `folder`, then every `every`.
    pub fn start(folder: &Path, every: Duration) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let (log, flag) = (folder.join(crate::log::LOG_FILE), Arc::clone(&over));
        // The launcher's loop runs in the thread that starts this one.
        let launcher = rustix::thread::gettid().as_raw_pid();
        Self { over, thread: std::thread::spawn(move || watch(&log, every, &flag, launcher)) }
    }

    /// The run is over: what its processes used.
    pub fn finish(self) -> Usage {
        self.over.store(true, Ordering::Release);
        self.thread.thread().unpark();
        self.thread.join().unwrap_or_default()
    }
}

fn watch(log: &PathBuf, every: Duration, over: &AtomicBool, launcher: i32) -> Usage {
    const PACE_NS: u64 = 5_000_000;
    let over = || over.load(Ordering::Acquire);
    let size = || fs::metadata(log).map_or(0, |m| m.len());
    // Ticks run when the log grows a second time after it came to be.
    let (mut last, mut growths) = (0, 0);
    while growths < 3 {
        if over() {
            return Usage::default();
        }
        let now = size();
        growths += u32::from(now > last);
        last = now;
        pause(PACE_NS);
    }
    let found = processes();
    let launcher_ns = || {
        let text = fs::read_to_string(format!("/proc/self/task/{launcher}/schedstat")).ok()?;
        text.split(' ').next()?.parse::<u64>().ok()
    };
    let began = monotonic_ns();
    let looks: Vec<_> = found.iter().filter_map(|&(role, pid)| Some((role, pid, UsageSample::at(pid)?))).collect();
    let first_launcher = launcher_ns().unwrap_or(0);
    let us = std::process::id();
    let mut uses: Vec<ProcessUse> = looks
        .iter()
        .map(|(process, _, look)| ProcessUse {
            process,
            cpu_ns: 0,
            first_kib: look.resident_kib,
            last_kib: look.resident_kib,
            cores: [look.core].into(),
        })
        .collect();
    let own = resident_kib(us).unwrap_or(0);
    let mut launcher_use =
        ProcessUse { process: "launcher", cpu_ns: 0, first_kib: own, last_kib: own, cores: BTreeSet::new() };
    let mut ended = began;
    'looking: while !over() {
        let next = monotonic_ns() + every.as_nanos() as u64;
        // Asleep all the while: what wakes up in between would be in the way of what is measured.
        while monotonic_ns() < next {
            std::thread::park_timeout(Duration::from_nanos(next - monotonic_ns().min(next)));
            if over() {
                break 'looking;
            }
        }
        let now: Vec<_> = looks.iter().map_while(|&(_, pid, _)| UsageSample::at(pid)).collect();
        if now.len() < looks.len() {
            // One has ended: the run is over.
            break;
        }
        ended = monotonic_ns();
        for ((used, look), (_, _, first)) in uses.iter_mut().zip(&now).zip(&looks) {
            used.cpu_ns = look.cpu_ns.saturating_sub(first.cpu_ns);
            used.last_kib = look.resident_kib;
            used.cores.insert(look.core);
        }
        launcher_use.cpu_ns = launcher_ns().unwrap_or(0).saturating_sub(first_launcher);
        launcher_use.last_kib = resident_kib(us).unwrap_or(0);
        launcher_use.cores.extend(stat(us).and_then(|s| core(&s)));
    }
    if uses.is_empty() {
        return Usage::default();
    }
    uses.push(launcher_use);
    let seconds = (ended - began) as f64 / 1e9;
    let mut usage = Usage::default();
    usage.add(&Usage { seconds, share_of_a_core: None, processes: uses, longest: 0.0 });
    usage
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_lives_is_looked_at() {
        let look = UsageSample::at(std::process::id()).unwrap();
        assert!(look.cpu_ns > 0 && look.resident_kib > 100);
        assert!(UsageSample::at(0).is_none());
        let line = "7 (a ) b) R 1 ".to_owned() + &"0 ".repeat(34) + "5 0 0";
        assert_eq!(core(&line), Some(5));
    }

    #[test]
    fn blocks_add_up_and_the_longest_tells_the_memory() {
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

//! What a process asks of the operating system for itself in real time, and what it then has: asked first, checked after.
//!
//! A request that succeeded says little: a set of cores is cut down in silence, a lock may cover what is there and not what
//! comes. So everything is read back from the kernel (`/proc`, the affinity mask), and what is not as it was asked for is
//! a [`RealtimeRefusal`] with its remedy. None of them ends a run. Requests hold for the calling thread, which must be the one that
//! runs the loop; the lock holds for the whole process.

use std::hint::black_box;
use std::num::NonZeroU64;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity, set_current_timer_slack};
use serde::{Deserialize, Serialize};
use thread_priority::{
    Error, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use super::limits::{lock_limit, lock_remedy, priority_remedy, status};
use crate::scenario::RealtimeProcess;

/// The timer slack that is always asked for in real time, ns: the least that there is.
const TIMER_SLACK_NS: u64 = 1;
/// Stack that is left alone when the rest is touched, KiB.
const SPARE_STACK_KIB: u64 = 512;

/// What a process asked for, what it has, and what it was refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeReport {
    /// What was asked for.
    pub asked: RealtimeRequest,
    /// What holds, read back after the requests.
    pub held: RealtimeGranted,
    /// What was asked for and does not hold.
    pub refused: Vec<RealtimeRefusal>,
}

/// What was asked for: the scenario's table, and the timer slack.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeRequest {
    /// Priority under SCHED_FIFO.
    pub priority: Option<u32>,
    /// Cores; none named means all.
    pub cores: Vec<u32>,
    /// All memory in RAM.
    pub lock_memory: bool,
    /// Stack touched beforehand, KiB.
    pub prefault_stack_kib: u32,
    /// Timer slack, ns.
    pub timer_slack_ns: u64,
}

/// What holds, as the kernel says it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeGranted {
    /// The thread's scheduling policy: `other`, `fifo`, `round-robin`, `batch`, `idle`, `deadline`.
    pub scheduler: String,
    /// Its real-time priority; 0 under the ordinary scheduler.
    pub priority: u32,
    /// The cores on which it may run.
    pub cores: Vec<u32>,
    /// Memory locked in RAM, KiB.
    pub locked_kib: u64,
    /// The main thread's stack, as far as it has been in use, KiB.
    pub stack_kib: u64,
    /// Timer slack, ns; 0 under a real-time policy, which has none.
    pub timer_slack_ns: u64,
}

/// Something that was asked for and does not hold.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeRefusal {
    /// What: the key and the value that was asked for.
    pub what: String,
    /// Why, as far as the system says.
    pub why: String,
    /// What a user can do about it.
    pub remedy: String,
}

impl RealtimeReport {
    /// Asks for everything in `process`, with `table` its place in the scenario (`realtime.plant`), and says what came of
    /// it. To be called by the thread that runs the loop, when most of its memory is there.
    pub fn request(process: &RealtimeProcess, table: &str) -> Self {
        let mut refused = Vec::new();
        refused.extend(take_cores(&process.cores, table));
        let stack = touch_stack(process.prefault_stack_kib, table);
        let lock = if process.lock_memory { lock_memory().err() } else { None };
        // Before the policy, because a real-time thread has no slack to set.
        let _ = NonZeroU64::new(TIMER_SLACK_NS).map(|slack| set_current_timer_slack(Some(slack)));
        let priority = process.priority.and_then(|priority| fifo(priority).err().map(|why| (priority, why)));

        let held = RealtimeGranted::now();
        refused.extend(stack.or_else(|| short_stack(process.prefault_stack_kib, &held)));
        refused.extend(lock.or_else(|| {
            (process.lock_memory && held.locked_kib == 0).then(|| RealtimeRefusal {
                what: "lock_memory".to_owned(),
                why: "the request was taken, and nothing is locked".to_owned(),
                remedy: lock_remedy(&program()),
            })
        }));
        let fallen = |wanted: &u32| held.scheduler != "fifo" || held.priority != *wanted;
        if let Some(wanted) = process.priority.filter(fallen) {
            let (_, why) = priority.unwrap_or((wanted, "the request was taken, and does not hold".to_owned()));
            refused.push(RealtimeRefusal {
                what: format!("priority = {wanted}"),
                why,
                remedy: priority_remedy(wanted, &program()),
            });
        }
        if held.timer_slack_ns > TIMER_SLACK_NS {
            refused.push(RealtimeRefusal {
                what: format!("timer slack of {TIMER_SLACK_NS} ns"),
                why: format!("it is {} ns", held.timer_slack_ns),
                remedy: "a sandbox may forbid prctl(PR_SET_TIMERSLACK); wake-ups are later by that much".to_owned(),
            });
        }
        Self { asked: RealtimeRequest::of(process), held, refused }
    }

    /// Whether nothing was asked for beyond what always is, and nothing was refused.
    pub fn is_usual(&self) -> bool {
        self.asked == RealtimeRequest::of(&RealtimeProcess::default()) && self.refused.is_empty()
    }

    /// What holds, and what was refused, on one line.
    pub fn to_text(&self) -> String {
        let held = &self.held;
        let mut parts = vec![match held.priority {
            0 => format!("scheduler {}", held.scheduler),
            priority => format!("scheduler {} {priority}", held.scheduler),
        }];
        parts.push(format!("cores {}", ranges(&held.cores)));
        if self.asked.lock_memory || held.locked_kib > 0 {
            parts.push(format!("{} KiB locked", held.locked_kib));
        }
        if self.asked.prefault_stack_kib > 0 {
            parts.push(format!("stack {} KiB", held.stack_kib));
        }
        parts.push(format!("timer slack {} ns", held.timer_slack_ns));
        let refused: Vec<_> = self.refused.iter().map(|r| r.what.as_str()).collect();
        let refused = if refused.is_empty() { String::new() } else { format!("; refused: {}", refused.join(", ")) };
        parts.join(", ") + &refused
    }
}

impl RealtimeRequest {
    fn of(process: &RealtimeProcess) -> Self {
        Self {
            priority: process.priority,
            cores: process.cores.clone(),
            lock_memory: process.lock_memory,
            prefault_stack_kib: process.prefault_stack_kib,
            timer_slack_ns: TIMER_SLACK_NS,
        }
    }
}

impl RealtimeGranted {
    /// What holds for the calling thread now.
    pub fn now() -> Self {
        let (scheduler, priority) = scheduler().unwrap_or_else(|| ("unknown".to_owned(), 0));
        Self {
            scheduler,
            priority,
            cores: cores(),
            locked_kib: status_kib("VmLck"),
            stack_kib: status_kib("VmStk"),
            timer_slack_ns: rustix::thread::current_timer_slack().unwrap_or(0),
        }
    }
}

/// Puts the calling thread under SCHED_FIFO with `priority`, 1 to 99.
///
/// # Errors
/// The operating system's reason in words.
pub fn fifo(priority: u32) -> Result<(), String> {
    let value = u8::try_from(priority).map_err(|_| "no such priority".to_owned())?;
    let value = ThreadPriorityValue::try_from(value).map_err(|why| why.to_string())?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), policy).map_err(|error| {
        match error {
            Error::OS(code) => system(std::io::Error::from_raw_os_error(code)),
            other => format!("{other:?}"),
        }
    })
}

/// This program's file.
fn program() -> String {
    std::env::current_exe().map_or_else(|_| "PROGRAM".to_owned(), |path| path.display().to_string())
}

fn system(error: std::io::Error) -> String {
    // "Operation not permitted (os error 1)": the number says nothing more.
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}

/// Moves the calling thread to `asked`.
fn take_cores(asked: &[u32], table: &str) -> Option<RealtimeRefusal> {
    if asked.is_empty() {
        return None;
    }
    let mut set = CpuSet::new();
    asked.iter().filter(|&&core| (core as usize) < CpuSet::MAX_CPU).for_each(|&core| set.set(core as usize));
    let answer = sched_setaffinity(None, &set);
    let held = cores();
    let missing: Vec<u32> = asked.iter().copied().filter(|core| !held.contains(core)).collect();
    // A request that failed changed nothing, and the thread may run on the asked cores and on others.
    if missing.is_empty() && answer.is_ok() {
        return None;
    }
    let online = std::fs::read_to_string("/sys/devices/system/cpu/online").unwrap_or_default();
    let why = match (missing.is_empty(), answer) {
        (true, Err(error)) => system(error.into()),
        _ => format!("the machine has the cores {}, and the process may run on {}", online.trim(), ranges(&held)),
    };
    let what = if missing.is_empty() { asked } else { &missing };
    Some(RealtimeRefusal {
        what: format!("cores = [{}]", what.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")),
        why,
        remedy: format!("name cores that this machine has, and that its control groups allow, as {table}.cores"),
    })
}

/// Locks what is there and, where no limit could be met later, what will come.
fn lock_memory() -> Result<(), RealtimeRefusal> {
    let refusal = |why| RealtimeRefusal { what: "lock_memory".to_owned(), why, remedy: lock_remedy(&program()) };
    let limit = lock_limit();
    // Under a limit, a process that had locked all that is to come would die of its next allocation beyond it.
    let what = if limit.is_none() { MlockAllFlags::CURRENT | MlockAllFlags::FUTURE } else { MlockAllFlags::CURRENT };
    mlockall(what).map_err(|error| refusal(system(error.into())))?;
    match limit {
        None => Ok(()),
        Some(bytes) => Err(refusal(format!(
            "the limit is {} KiB, so that only what was there is locked and not what came later",
            bytes >> 10
        ))),
    }
}

/// Touches `kib` of stack below the caller, so that no tick is the first to need it.
fn touch_stack(kib: u32, table: &str) -> Option<RealtimeRefusal> {
    let limit = getrlimit(Resource::Stack).current.map_or(u64::MAX, |bytes| bytes >> 10);
    if u64::from(kib) + SPARE_STACK_KIB + status_kib("VmStk") > limit {
        return (kib > 0).then(|| RealtimeRefusal {
            what: format!("prefault_stack_kib = {kib}"),
            why: format!("the whole stack is {limit} KiB"),
            remedy: format!("give less for {table}.prefault_stack_kib, or `ulimit -s 8192`"),
        });
    }
    touch(kib / 4);
    None
}

/// One page and those below it.
#[inline(never)]
fn touch(pages: u32) {
    let mut page = [0_u8; 4096];
    black_box(&mut page);
    if pages > 0 {
        touch(pages - 1);
    }
    black_box(&page);
}

fn short_stack(kib: u32, held: &RealtimeGranted) -> Option<RealtimeRefusal> {
    (held.stack_kib < u64::from(kib)).then(|| RealtimeRefusal {
        what: format!("prefault_stack_kib = {kib}"),
        why: format!("the main thread's stack has been in use for {} KiB", held.stack_kib),
        remedy: "run the loop in the program's main thread".to_owned(),
    })
}

/// Policy and priority of the calling thread, out of its `stat`.
fn scheduler() -> Option<(String, u32)> {
    let stat = std::fs::read_to_string("/proc/thread-self/stat").ok()?;
    // The name may hold blanks and parentheses. Behind it come fields 3 and on; priority is field 40, policy field 41.
    let fields: Vec<&str> = stat.rsplit_once(") ")?.1.split_whitespace().collect();
    let (priority, policy) = (fields.get(37)?.parse().ok()?, *fields.get(38)?);
    let name = match policy {
        "0" => "other",
        "1" => "fifo",
        "2" => "round-robin",
        "3" => "batch",
        "5" => "idle",
        "6" => "deadline",
        _ => "unknown",
    };
    Some((name.to_owned(), priority))
}

/// The cores on which the calling thread may run.
fn cores() -> Vec<u32> {
    let Ok(set) = sched_getaffinity(None) else { return Vec::new() };
    (0..CpuSet::MAX_CPU).filter(|&core| set.is_set(core)).map(|core| core as u32).collect()
}

fn status_kib(key: &str) -> u64 {
    status(key).and_then(|value| value.split(' ').next()?.parse().ok()).unwrap_or(0)
}

/// Numbers in order as the kernel writes them: `0-3,6`.
fn ranges(cores: &[u32]) -> String {
    let mut text = String::new();
    let mut rest = cores;
    while let [first, ..] = *rest {
        let run = rest.iter().zip(first..).take_while(|(core, expected)| **core == *expected).count();
        let last = first + run as u32 - 1;
        let comma = if text.is_empty() { "" } else { "," };
        text += &if run == 1 { format!("{comma}{first}") } else { format!("{comma}{first}-{last}") };
        rest = &rest[run..];
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In a thread of its own, so that neither cores nor slack stay with the test's.
    fn asked(process: RealtimeProcess) -> RealtimeReport {
        std::thread::spawn(move || RealtimeReport::request(&process, "realtime.plant")).join().unwrap()
    }

    #[test]
    fn nothing_asked_is_nothing_refused_but_the_slack_is_set() {
        let report = asked(RealtimeProcess::default());
        assert!(report.refused.is_empty(), "{report:?}");
        assert!(report.held.timer_slack_ns <= 1 && !report.held.cores.is_empty(), "{report:?}");
        assert!(report.to_text().starts_with("scheduler "), "{}", report.to_text());
    }

    #[test]
    fn a_core_is_held_alone_and_one_that_is_not_there_is_refused() {
        let first = RealtimeGranted::now().cores[0];
        let report = asked(RealtimeProcess { cores: vec![first], ..RealtimeProcess::default() });
        assert_eq!((report.held.cores.as_slice(), report.refused.len()), ([first].as_slice(), 0));
        // The kernel takes this request and drops the core in silence.
        let report = asked(RealtimeProcess { cores: vec![first, 1023], ..RealtimeProcess::default() });
        assert_eq!(report.held.cores, [first]);
        assert_eq!(report.refused[0].what, "cores = [1023]");
        assert!(report.refused[0].remedy.contains("realtime.plant.cores") && report.to_text().contains("refused"));
        // This one it refuses.
        let report = asked(RealtimeProcess { cores: vec![1023], ..RealtimeProcess::default() });
        assert_eq!(report.refused.len(), 1, "{report:?}");
    }

    #[test]
    fn a_priority_holds_or_is_refused_with_a_remedy() {
        let report = asked(RealtimeProcess { priority: Some(7), ..RealtimeProcess::default() });
        match report.refused.as_slice() {
            [] => assert_eq!((report.held.scheduler.as_str(), report.held.priority), ("fifo", 7)),
            [refusal] => {
                assert_eq!((report.held.priority, refusal.what.as_str()), (0, "priority = 7"));
                assert!(refusal.remedy.contains("rtprio 7") && refusal.remedy.contains("setcap"), "{refusal:?}");
            }
            more => panic!("{more:?}"),
        }
    }

    #[test]
    fn cores_in_the_kernels_words() {
        for (cores, text) in [(&[][..], ""), (&[3], "3"), (&[0, 1, 2, 3, 6], "0-3,6"), (&[1, 3, 4], "1,3-4")] {
            assert_eq!(ranges(cores), text);
        }
    }
}

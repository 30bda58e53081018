//! Real-time settings of a process: they are requested from the operating system and then read back.
//!
//! A request that succeeds proves little. The kernel drops cores from a set without an error, and a memory lock
//! may cover present memory but not future allocations. So every setting is read back from the kernel (`/proc`,
//! the affinity mask). A setting that does not hold as requested becomes a [`RealtimeRefusal`] with its remedy.
//! A refusal never ends a run. Requests apply to the calling thread, which must be the thread that runs the
//! loop. The memory lock applies to the whole process.

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

/// The timer slack that is always requested in real time, ns: the smallest possible one.
const TIMER_SLACK_NS: u64 = 1;
/// Stack that prefaulting leaves untouched, KiB.
const SPARE_STACK_KIB: u64 = 512;

/// What a process requested, what it has, and what it was refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeReport {
    /// The requested settings.
    pub asked: RealtimeRequest,
    /// The settings in force, read back after the requests.
    pub held: RealtimeGranted,
    /// The requested settings that are not in force.
    pub refused: Vec<RealtimeRefusal>,
}

/// The settings that a process requests. The default requests nothing but the timer slack.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeRequest {
    /// Priority under SCHED_FIFO.
    pub priority: Option<u32>,
    /// Cores on which the thread may run; an empty list means all.
    pub cores: Vec<u32>,
    /// Whether to lock all memory in RAM.
    pub lock_memory: bool,
    /// Stack that is touched before the loop starts, KiB.
    pub prefault_stack_kib: u32,
    /// Timer slack, ns.
    pub timer_slack_ns: u64,
}

/// The settings in force, as the kernel reports them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeGranted {
    /// The thread's scheduling policy: `other`, `fifo`, `round-robin`, `batch`, `idle`, `deadline`.
    pub scheduler: String,
    /// The thread's real-time priority; 0 under the ordinary scheduler.
    pub priority: u32,
    /// The cores on which it may run.
    pub cores: Vec<u32>,
    /// Memory locked in RAM, KiB.
    pub locked_kib: u64,
    /// The part of the main thread's stack that has been in use, KiB.
    pub stack_kib: u64,
    /// Timer slack, ns; 0 under a real-time policy, which has none.
    pub timer_slack_ns: u64,
}

/// A requested setting that is not in force.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeRefusal {
    /// The key and the requested value.
    pub what: String,
    /// The reason, as far as the system reports one.
    pub why: String,
    /// What a user can do about it.
    pub remedy: String,
}

impl RealtimeReport {
    /// Requests all settings in `asked`, and reports which of them are in force. `table` is the place of the
    /// settings in the scenario (`realtime.plant`), for the remedies. The thread that runs the loop must call
    /// it, after it has allocated most of its memory.
    pub fn request(asked: RealtimeRequest, table: &str) -> Self {
        let mut refused = Vec::new();
        refused.extend(restrict_to_cores(&asked.cores, table));
        let stack = touch_stack(asked.prefault_stack_kib, table);
        let lock = if asked.lock_memory { lock_memory().err() } else { None };
        // Before the scheduling policy, because a real-time thread has no slack to set.
        let _ = NonZeroU64::new(TIMER_SLACK_NS).map(|slack| set_current_timer_slack(Some(slack)));
        let priority_error = asked.priority.and_then(|priority| set_fifo_priority(priority).err());

        let held = RealtimeGranted::now();
        refused.extend(stack.or_else(|| short_stack(asked.prefault_stack_kib, &held)));
        refused.extend(lock.or_else(|| {
            (asked.lock_memory && held.locked_kib == 0).then(|| RealtimeRefusal {
                what: "lock_memory".to_owned(),
                why: "the request was accepted, but nothing is locked".to_owned(),
                remedy: lock_remedy(&program()),
            })
        }));
        let not_in_force = |wanted: &u32| held.scheduler != "fifo" || held.priority != *wanted;
        if let Some(wanted) = asked.priority.filter(not_in_force) {
            refused.push(RealtimeRefusal {
                what: format!("priority = {wanted}"),
                why: priority_error.unwrap_or("the request was accepted, but it is not in force".to_owned()),
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
        Self { asked, held, refused }
    }

    /// Whether only the timer slack was requested, and nothing was refused.
    pub fn is_usual(&self) -> bool {
        self.asked == RealtimeRequest::default() && self.refused.is_empty()
    }

    /// The settings in force and the refused ones, on one line.
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

impl Default for RealtimeRequest {
    fn default() -> Self {
        Self {
            priority: None,
            cores: Vec::new(),
            lock_memory: false,
            prefault_stack_kib: 0,
            timer_slack_ns: TIMER_SLACK_NS,
        }
    }
}

impl RealtimeGranted {
    /// The settings in force for the calling thread now.
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
/// The operating system's reason, as text.
pub fn set_fifo_priority(priority: u32) -> Result<(), String> {
    let value = u8::try_from(priority).map_err(|_| "no such priority".to_owned())?;
    let value = ThreadPriorityValue::try_from(value).map_err(|why| why.to_string())?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), policy).map_err(|error| {
        match error {
            Error::OS(code) => system_text(std::io::Error::from_raw_os_error(code)),
            other => format!("{other:?}"),
        }
    })
}

/// The path of this program's file.
fn program() -> String {
    std::env::current_exe().map_or_else(|_| "PROGRAM".to_owned(), |path| path.display().to_string())
}

/// The system's text of an error without its number: "Operation not permitted" of "Operation not permitted (os
/// error 1)".
fn system_text(error: std::io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}

/// Restricts the calling thread to the cores `asked`.
fn restrict_to_cores(asked: &[u32], table: &str) -> Option<RealtimeRefusal> {
    if asked.is_empty() {
        return None;
    }
    let mut set = CpuSet::new();
    asked.iter().filter(|&&core| (core as usize) < CpuSet::MAX_CPU).for_each(|&core| set.set(core as usize));
    let answer = sched_setaffinity(None, &set);
    let held = cores();
    let missing: Vec<u32> = asked.iter().copied().filter(|core| !held.contains(core)).collect();
    // A request that failed changed nothing. The thread may then run on the requested cores and on others.
    if missing.is_empty() && answer.is_ok() {
        return None;
    }
    let online = std::fs::read_to_string("/sys/devices/system/cpu/online").unwrap_or_default();
    let why = match (missing.is_empty(), answer) {
        (true, Err(error)) => system_text(error.into()),
        _ => format!("the machine has the cores {}, and the process may run on {}", online.trim(), ranges(&held)),
    };
    let what = if missing.is_empty() { asked } else { &missing };
    Some(RealtimeRefusal {
        what: format!("cores = [{}]", what.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")),
        why,
        remedy: format!("name cores that this machine has, and that its control groups allow, as {table}.cores"),
    })
}

/// Locks present memory, and future allocations where no limit can be reached.
fn lock_memory() -> Result<(), RealtimeRefusal> {
    let refusal = |why| RealtimeRefusal { what: "lock_memory".to_owned(), why, remedy: lock_remedy(&program()) };
    let limit = lock_limit();
    // Under a limit, a process that had locked future allocations would die of its next allocation beyond the
    // limit.
    let range = if limit.is_none() { MlockAllFlags::CURRENT | MlockAllFlags::FUTURE } else { MlockAllFlags::CURRENT };
    mlockall(range).map_err(|error| refusal(system_text(error.into())))?;
    match limit {
        None => Ok(()),
        Some(bytes) => Err(refusal(format!(
            "the limit is {} KiB, so that only what was there is locked and not what came later",
            bytes >> 10
        ))),
    }
}

/// Touches `kib` of stack below the caller, so that no tick causes a page fault there.
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

/// Touches `pages` pages and this function's own.
#[inline(never)]
fn touch(pages: u32) {
    let mut page = [0_u8; 4096];
    black_box(&mut page);
    if pages > 0 {
        touch(pages - 1);
    }
    black_box(&page);
}

/// The refusal for a stack that is still smaller than the prefaulted size.
fn short_stack(kib: u32, held: &RealtimeGranted) -> Option<RealtimeRefusal> {
    (held.stack_kib < u64::from(kib)).then(|| RealtimeRefusal {
        what: format!("prefault_stack_kib = {kib}"),
        why: format!("the main thread's stack has been in use for {} KiB", held.stack_kib),
        remedy: "run the loop in the program's main thread".to_owned(),
    })
}

/// Scheduling policy and real-time priority of the calling thread, from `/proc/thread-self/stat`.
fn scheduler() -> Option<(String, u32)> {
    let stat = std::fs::read_to_string("/proc/thread-self/stat").ok()?;
    // The program's name may hold blanks and parentheses. Fields 3 and on follow it. Field 40 is the priority
    // and field 41 the policy.
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

/// A size in `/proc/self/status`, KiB; 0 when it is missing.
fn status_kib(key: &str) -> u64 {
    status(key).and_then(|value| value.split(' ').next()?.parse().ok()).unwrap_or(0)
}

/// Sorted numbers as the kernel writes them: `0-3,6`.
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

    /// Requests in a separate thread, so that the test's own thread keeps its cores and timer slack.
    fn request(asked: RealtimeRequest) -> RealtimeReport {
        std::thread::spawn(move || RealtimeReport::request(asked, "realtime.plant")).join().unwrap()
    }

    #[test]
    fn an_empty_request_sets_only_the_timer_slack() {
        let report = request(RealtimeRequest::default());
        assert!(report.refused.is_empty(), "{report:?}");
        assert!(report.held.timer_slack_ns <= 1 && !report.held.cores.is_empty(), "{report:?}");
        assert!(report.to_text().starts_with("scheduler "), "{}", report.to_text());
    }

    #[test]
    fn a_core_is_granted_and_a_missing_core_is_refused() {
        let first = RealtimeGranted::now().cores[0];
        let report = request(RealtimeRequest { cores: vec![first], ..RealtimeRequest::default() });
        assert_eq!((report.held.cores.as_slice(), report.refused.len()), ([first].as_slice(), 0));
        // The kernel accepts this request and drops the missing core without an error.
        let report = request(RealtimeRequest { cores: vec![first, 1023], ..RealtimeRequest::default() });
        assert_eq!(report.held.cores, [first]);
        assert_eq!(report.refused[0].what, "cores = [1023]");
        assert!(report.refused[0].remedy.contains("realtime.plant.cores") && report.to_text().contains("refused"));
        // The kernel refuses this request.
        let report = request(RealtimeRequest { cores: vec![1023], ..RealtimeRequest::default() });
        assert_eq!(report.refused.len(), 1, "{report:?}");
    }

    #[test]
    fn a_priority_is_in_force_or_refused_with_a_remedy() {
        let report = request(RealtimeRequest { priority: Some(7), ..RealtimeRequest::default() });
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
    fn cores_are_written_as_the_kernel_writes_them() {
        for (cores, text) in [(&[][..], ""), (&[3], "3"), (&[0, 1, 2, 3, 6], "0-3,6"), (&[1, 3, 4], "1,3-4")] {
            assert_eq!(ranges(cores), text);
        }
    }
}

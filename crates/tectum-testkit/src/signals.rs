//! Processes by their id: signals, children, and whether one has ended.

use std::fs;
use std::path::Path;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

/// Sends a signal to a process, by the name that `kill` takes: `"KILL"`, `"STOP"`, `"CONT"`, `"TERM"`, `"INT"`,
/// `"HUP"`, `"QUIT"`, `"TSTP"`, `"USR1"` or `"USR2"`. A process that has ended meanwhile is no error: which of
/// the two comes first is often what a test leaves open.
///
/// # Panics
///
/// If there is no such signal.
#[track_caller]
pub fn signal_process(pid: u32, signal: &str) {
    let signal = match signal {
        "CONT" => Signal::CONT,
        "HUP" => Signal::HUP,
        "INT" => Signal::INT,
        "KILL" => Signal::KILL,
        "QUIT" => Signal::QUIT,
        "STOP" => Signal::STOP,
        "TERM" => Signal::TERM,
        "TSTP" => Signal::TSTP,
        "USR1" => Signal::USR1,
        "USR2" => Signal::USR2,
        _ => panic!("no signal {signal:?}; give CONT, HUP, INT, KILL, QUIT, STOP, TERM, TSTP, USR1 or USR2"),
    };
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        let _ = kill_process(pid, signal);
    }
}

/// Stops a process for this long.
pub fn stop_process_for(pid: u32, duration: Duration) {
    signal_process(pid, "STOP");
    std::thread::sleep(duration);
    signal_process(pid, "CONT");
}

/// Whether a process has ended. Its parent may not have collected it yet.
pub fn has_ended(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).map_or(true, |stat| stat.contains(") Z "))
}

/// A child process: its id, and the names by which it may be called.
struct ChildProcess {
    pid: u32,
    /// File name of the program, and of its first argument: a script's name stands behind that of its interpreter.
    names: [String; 2],
}

/// The children of a process.
fn child_processes(parent: u32) -> impl Iterator<Item = ChildProcess> {
    let parent = parent.to_string();
    fs::read_dir("/proc").into_iter().flatten().flatten().filter_map(move |entry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        let stat = fs::read_to_string(entry.path().join("stat")).ok()?;
        // The format is: pid (name) state parent ...
        let (_, rest) = stat.rsplit_once(") ")?;
        if rest.split(' ').nth(1) != Some(&parent) {
            return None;
        }
        let command = fs::read_to_string(entry.path().join("cmdline")).ok()?;
        let mut words = command.split('\0');
        let mut file_name = || {
            let name = Path::new(words.next().unwrap_or_default()).file_name();
            name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
        };
        Some(ChildProcess { pid, names: [file_name(), file_name()] })
    })
}

/// Process ids and program names of the children of `parent`.
pub fn children(parent: u32) -> Vec<(u32, String)> {
    child_processes(parent).map(|ChildProcess { pid, names: [name, _] }| (pid, name)).collect()
}

/// The child of `parent` that runs `program`, or is an interpreter that runs the script `program`. Process `except`
/// does not count.
pub(crate) fn child_running(parent: u32, program: &str, except: Option<u32>) -> Option<u32> {
    let mut children = child_processes(parent);
    children.find(|child| Some(child.pid) != except && child.names.iter().any(|name| name == program)).map(|c| c.pid)
}

//! The operating system's limits on real-time priority and locked memory for this process, and how to raise
//! them.

use rustix::process::{Resource, getrlimit};

/// The most memory that this process may lock, bytes; `None` where there is no limit, or where it does not bind
/// this process.
pub fn lock_limit() -> Option<u64> {
    /// CAP_IPC_LOCK of `linux/capability.h`.
    const IPC_LOCK: u32 = 14;
    if capable(IPC_LOCK) { None } else { getrlimit(Resource::Memlock).current }
}

/// The highest real-time priority that this process may request; 0 where it may request none.
pub fn priority_limit() -> u64 {
    /// CAP_SYS_NICE of `linux/capability.h`.
    const SYS_NICE: u32 = 23;
    if capable(SYS_NICE) { 99 } else { getrlimit(Resource::Rtprio).current.unwrap_or(99).min(99) }
}

/// Whether the process has the Linux capability with this number.
fn capable(capability: u32) -> bool {
    let set = status("CapEff").and_then(|hex| u64::from_str_radix(&hex, 16).ok());
    set.is_some_and(|set| set >> capability & 1 == 1)
}

/// How a user can allow `program` to run under SCHED_FIFO up to `priority`.
pub fn priority_remedy(priority: u32, program: &str) -> String {
    format!(
        "allow it with a line `USER - rtprio {priority}` in /etc/security/limits.conf and a new login (or `ulimit -r \
         {priority}` where the hard limit is as high), or with {}",
        setcap(program)
    )
}

/// How a user can allow `program` to lock memory.
pub fn lock_remedy(program: &str) -> String {
    format!(
        "allow it with a line `USER - memlock unlimited` in /etc/security/limits.conf and a new login (or `ulimit -l \
         unlimited`), or with {}",
        setcap(program)
    )
}

/// The command that grants both capabilities. It names both, because `setcap` with one removes the other.
fn setcap(program: &str) -> String {
    format!("`sudo setcap cap_sys_nice,cap_ipc_lock=ep {program}`")
}

/// The value behind `key` in `/proc/self/status`.
pub(super) fn status(key: &str) -> Option<String> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    Some(line.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_and_capabilities_can_be_read() {
        assert!(status("CapEff").is_some_and(|hex| u64::from_str_radix(&hex, 16).is_ok()));
        assert!(status("Cap").is_none(), "only whole keys match");
        assert!(priority_limit() <= 99);
        assert!(lock_remedy("x").contains("ep x`") && priority_remedy(7, "x").contains("rtprio 7"));
    }
}

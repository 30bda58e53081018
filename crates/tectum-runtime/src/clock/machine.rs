//! The machine of a run, for the log's header: a measured duration means little without its machine.

use std::collections::BTreeMap;
use std::fs;

use rustix::thread::{CpuSet, sched_getaffinity};

/// The cache size to assume where the kernel does not report one, bytes.
const USUAL_CACHE: usize = 32 << 20;

/// Kernel, architecture, host, cores, processor and memory, as far as the system reports them.
pub fn machine_facts() -> BTreeMap<String, String> {
    let mut facts = BTreeMap::new();
    let mut put = |key: &str, value: String| facts.insert(key.to_owned(), value);
    let uname = rustix::system::uname();
    put("kernel", format!("{} {}", uname.sysname().to_string_lossy(), uname.release().to_string_lossy()));
    put("architecture", uname.machine().to_string_lossy().into_owned());
    put("host", uname.nodename().to_string_lossy().into_owned());
    put("cores", std::thread::available_parallelism().map_or(0, usize::from).to_string());
    put("processor", processor().unwrap_or_else(|| "unknown".to_owned()));
    put("memory_mib", (rustix::system::sysinfo().totalram as u64 / (1 << 20)).to_string());
    facts
}

/// The model name of the first processor.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|l| l.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// The cores on which this process may run.
pub fn cores() -> Vec<u32> {
    let Ok(set) = sched_getaffinity(None) else { return Vec::new() };
    (0..CpuSet::MAX_CPU).filter(|&core| set.is_set(core)).map(|core| core as u32).collect()
}

/// Size of the largest cache of the first core, bytes.
pub fn last_level_cache() -> usize {
    let caches = fs::read_dir("/sys/devices/system/cpu/cpu0/cache").into_iter().flatten().flatten();
    let sizes = caches.filter_map(|cache| {
        let text = fs::read_to_string(cache.path().join("size")).ok()?;
        let text = text.trim();
        let (number, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        let shift = match unit {
            "K" => 10,
            "M" => 20,
            _ => return None,
        };
        number.parse::<usize>().ok().map(|n| n << shift)
    });
    sizes.max().unwrap_or(USUAL_CACHE)
}

//! The machine of a run, for the log's header: a measured duration means little without its machine.

use std::collections::BTreeMap;

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

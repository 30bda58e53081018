//! Checks of kernel, limits, processor and memory. Each verdict is a function of the values read from the system.

use std::collections::BTreeSet;
use std::fs;

use super::{Check, bytes};
use crate::clock::{lock_limit, lock_remedy, machine_facts, priority_limit, priority_remedy};

/// The programs that a remedy applies to; capabilities are set for each program file.
const PROGRAMS: &str =
    "PROGRAM` for each of the run's programs, `tectum-simulator`, `tectum-controller`, `tectum-logger";

/// All checks of this module.
pub(super) fn checks() -> Vec<Check> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let system = rustix::system::sysinfo();
    let unit = u64::from(system.mem_unit);
    let (swap, free) = (system.totalswap as u64 * unit, system.freeswap as u64 * unit);
    vec![
        kernel(
            machine_facts().get("kernel").map_or("unknown", String::as_str),
            &read("/proc/version"),
            read("/sys/kernel/realtime") == "1",
        ),
        priorities(priority_limit()),
        throttling(&read("/proc/sys/kernel/sched_rt_runtime_us"), &read("/proc/sys/kernel/sched_rt_period_us")),
        locking(lock_limit()),
        governor(&governors()),
        clock_source(&read("/sys/devices/system/clocksource/clocksource0/current_clocksource")),
        processors(cores),
        // A fixed-point number with 16 fractional bits.
        load(system.loads[0] as f64 / 65_536.0, cores),
        huge_pages(&read("/sys/kernel/mm/transparent_hugepage/enabled")),
        swapping(swap, swap.saturating_sub(free)),
    ]
}

/// Reads a small file of the kernel, without the newline; empty if the file does not exist.
fn read(path: &str) -> String {
    fs::read_to_string(path).unwrap_or_default().trim().to_owned()
}

fn kernel(release: &str, version: &str, realtime: bool) -> Check {
    const RT_HINT: &str = "for periods of a few ms, PREEMPT_RT would keep the worst wake-ups shorter";
    let has = |word: &str| version.split_whitespace().any(|w| w == word);
    if realtime || has("PREEMPT_RT") {
        Check::fine("kernel", format!("{release}, PREEMPT_RT"))
    } else if let Some(word) = ["PREEMPT_DYNAMIC", "PREEMPT"].into_iter().find(|word| has(word)) {
        Check::fine("kernel", format!("{release}, {word}; {RT_HINT}"))
    } else {
        let remedy = "boot a kernel with PREEMPT_DYNAMIC, as most distributions have, or PREEMPT_RT";
        Check::better("kernel", format!("{release}, which does not mention preemption"), remedy)
    }
}

fn priorities(limit: u64) -> Check {
    match limit {
        0 => Check::better("real-time priority", "SCHED_FIFO is not allowed", priority_remedy(80, PROGRAMS)),
        limit => Check::fine("real-time priority", format!("SCHED_FIFO up to {limit}")),
    }
}

fn throttling(runtime: &str, period: &str) -> Check {
    let name = "real-time share";
    match runtime.parse::<i64>() {
        Ok(0) => {
            let remedy = "`sysctl kernel.sched_rt_runtime_us=950000`";
            Check::better(name, "real-time threads get no time at all", remedy)
        }
        Ok(-1) => Check::fine(name, "unlimited: a real-time thread that does not sleep stops its core"),
        Ok(us) => Check::fine(name, format!("{us} of every {period} us")),
        Err(_) => Check::fine(name, "this kernel reports no limit"),
    }
}

fn locking(limit: Option<u64>) -> Check {
    match limit {
        None => Check::fine("locked memory", "unlimited"),
        Some(limit) => Check::better("locked memory", format!("at most {}", bytes(limit)), lock_remedy(PROGRAMS)),
    }
}

fn governors() -> BTreeSet<String> {
    let cores = fs::read_dir("/sys/devices/system/cpu").into_iter().flatten().flatten();
    cores
        .filter_map(|core| fs::read_to_string(core.path().join("cpufreq/scaling_governor")).ok())
        .map(trimmed)
        .collect()
}

fn trimmed(text: String) -> String {
    text.trim().to_owned()
}

fn governor(governors: &BTreeSet<String>) -> Check {
    let name = "frequency governor";
    let found = governors.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    if governors.is_empty() {
        Check::fine(name, "none to be seen, as usual in a virtual machine")
    } else if found == "performance" {
        Check::fine(name, found)
    } else {
        Check::better(
            name,
            found,
            "`sudo cpupower frequency-set -g performance`: a core that idles between ticks slows down",
        )
    }
}

fn clock_source(source: &str) -> Check {
    let name = "clock source";
    match source {
        "" => Check::fine(name, "not told"),
        "hpet" | "acpi_pm" | "jiffies" | "refined-jiffies" | "pit" => {
            let remedy = "every clock read is slow; see `dmesg | grep -i clocksource` for why the processor's own \
                          counter is not trusted";
            Check::better(name, source, remedy)
        }
        fast => Check::fine(name, fast),
    }
}

fn processors(cores: usize) -> Check {
    match cores {
        1 => {
            let remedy = "plant, controller and logger take turns; give the machine or the container a second core";
            Check::better("cores", "1", remedy)
        }
        n => Check::fine("cores", n.to_string()),
    }
}

fn load(load: f64, cores: usize) -> Check {
    let found = format!("{load:.1} on {cores} cores over the last minute");
    if load < cores as f64 {
        Check::fine("load", found)
    } else {
        let remedy = "end what else computes, or give the run's processes a `priority` under [realtime]";
        Check::better("load", found, remedy)
    }
}

fn huge_pages(modes: &str) -> Check {
    let name = "huge pages";
    // `always [madvise] never`: the active mode is in brackets.
    match modes.split_once('[').and_then(|(_, rest)| rest.split_once(']')) {
        Some(("always", _)) => {
            let remedy = "`echo madvise | sudo tee /sys/kernel/mm/transparent_hugepage/enabled`: putting huge pages \
                          together holds processes up";
            Check::better(name, "transparent, always", remedy)
        }
        Some((mode, _)) => Check::fine(name, format!("transparent, {mode}")),
        None => Check::fine(name, "none"),
    }
}

fn swapping(total: u64, used: u64) -> Check {
    if total == 0 {
        return Check::fine("swap", "none");
    }
    let remedy = "`lock_memory = true` under [realtime.plant], [realtime.controller] and [realtime.logger], or \
                  `sudo swapoff -a`";
    Check::better("swap", format!("{}, of which {} in use", bytes(total), bytes(used)), remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict::{CouldBeBetter, Fine};

    #[test]
    fn kernels_are_judged_by_preemption() {
        let of = |version, realtime| kernel("Linux 6.1", version, realtime);
        assert_eq!(of("Linux version 6.1 (gcc) #1 SMP PREEMPT_RT Mon", false).found, "Linux 6.1, PREEMPT_RT");
        assert_eq!(of("#1 SMP", true).found, "Linux 6.1, PREEMPT_RT");
        let dynamic = of("#1 SMP PREEMPT_DYNAMIC @0", false);
        assert!(dynamic.verdict == Fine && dynamic.found.contains("PREEMPT_DYNAMIC; for periods"), "{dynamic:?}");
        assert_eq!(of("#1 SMP Mon", false).verdict, CouldBeBetter);
    }

    #[test]
    fn limits_are_judged() {
        assert_eq!((priorities(0).verdict, priorities(99).verdict), (CouldBeBetter, Fine));
        assert!(priorities(0).remedy.unwrap().contains("rtprio 80"));
        assert_eq!((locking(Some(8 << 20)).verdict, locking(None).verdict), (CouldBeBetter, Fine));
        assert_eq!(locking(Some(8 << 20)).found, "at most 8192 KiB");
        for (runtime, verdict) in [("0", CouldBeBetter), ("-1", Fine), ("950000", Fine), ("", Fine)] {
            assert_eq!(throttling(runtime, "1000000").verdict, verdict, "{runtime}");
        }
    }

    #[test]
    fn processor_and_memory_are_judged() {
        let set = |names: &[&str]| governor(&names.iter().map(|&n| n.to_owned()).collect()).verdict;
        assert_eq!((set(&[]), set(&["performance"])), (Fine, Fine));
        assert_eq!((set(&["performance", "powersave"]), set(&["schedutil"])), (CouldBeBetter, CouldBeBetter));
        assert_eq!((clock_source("tsc").verdict, clock_source("hpet").verdict), (Fine, CouldBeBetter));
        assert_eq!((processors(1).verdict, processors(2).verdict), (CouldBeBetter, Fine));
        assert_eq!((load(0.3, 2).verdict, load(2.0, 2).verdict), (Fine, CouldBeBetter));
        assert_eq!(huge_pages("[always] madvise never").verdict, CouldBeBetter);
        assert_eq!(huge_pages("always [madvise] never").found, "transparent, madvise");
        assert_eq!((swapping(0, 0).verdict, swapping(1 << 30, 1 << 20).verdict), (Fine, CouldBeBetter));
    }
}

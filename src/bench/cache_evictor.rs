//! Cold caches on purpose: in the middle of every period, threads on all cores read through a buffer twice the size of the
//! last-level cache, so that at the next tick nothing of the tick before is in any cache.

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use rustix::thread::{CpuSet, sched_setaffinity};

use crate::clock::{monotonic_ns, sleep_until};

/// A cache line in 64-bit words.
const STRIDE: usize = 8;
/// Where the kernel does not tell the size of the cache, and at most, bytes.
const USUAL: usize = 32 << 20;
const MOST: usize = 256 << 20;

/// Walks until it is dropped.
pub struct CacheEvictor {
    over: Arc<AtomicBool>,
    longest: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl CacheEvictor {
    /// Walks once in every `period` ns, beginning half-way between two whole multiples of it on the clock, where ticks begin.
    pub fn start(period: u64) -> Self {
        let buffer = Arc::new(vec![1_u64; (2 * last_level_cache()).min(MOST) / 8]);
        let (over, longest) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let walk = |core: u32| {
            let (buffer, over, longest) = (Arc::clone(&buffer), Arc::clone(&over), Arc::clone(&longest));
            move || {
                let mut set = CpuSet::new();
                set.set(core as usize);
                // Refused where the core is not this process's: the walk then goes on on another.
                let _ = sched_setaffinity(None, &set);
                let mut at = monotonic_ns().next_multiple_of(period) + period / 2;
                while !over.load(Ordering::Relaxed) {
                    sleep_until(at);
                    let sum: u64 = buffer.iter().step_by(STRIDE).sum();
                    black_box(sum);
                    longest.fetch_max(monotonic_ns().saturating_sub(at), Ordering::Relaxed);
                    at = monotonic_ns().next_multiple_of(period) + period / 2;
                }
            }
        };
        let threads = super::machine::cores().into_iter().map(|core| std::thread::spawn(walk(core))).collect();
        Self { over, longest, threads }
    }

    /// How long after its instant the slowest walk was done, ns: below half a period, or it reached into a tick.
    pub fn longest_ns(&self) -> u64 {
        self.longest.load(Ordering::Relaxed)
    }
}

impl Drop for CacheEvictor {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Size of the largest cache of the first core, bytes.
pub fn last_level_cache() -> usize {
    let caches = std::fs::read_dir("/sys/devices/system/cpu/cpu0/cache").into_iter().flatten().flatten();
    let sizes = caches.filter_map(|cache| {
        let text = std::fs::read_to_string(cache.path().join("size")).ok()?;
        let text = text.trim();
        let (number, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        let shift = match unit {
            "K" => 10,
            "M" => 20,
            _ => return None,
        };
        number.parse::<usize>().ok().map(|n| n << shift)
    });
    sizes.max().unwrap_or(USUAL)
}

//! Makes caches cold: in the middle of every period, threads on all cores read through a buffer twice the size
//! of the last-level cache, so that at the next tick no cache holds data of the tick before.

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use rustix::thread::{CpuSet, sched_setaffinity};

use crate::clock::{cores, last_level_cache, monotonic_ns, sleep_until};

/// A cache line in 64-bit words.
const STRIDE: usize = 8;
/// The largest buffer, bytes.
const MAX_BUFFER: usize = 256 << 20;

/// Evicts caches periodically until it is dropped.
pub struct CacheEvictor {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

struct Shared {
    buffer: Vec<u64>,
    period_ns: u64,
    over: AtomicBool,
    /// The longest time from the middle of a period to the end of a pass, ns.
    longest_ns: AtomicU64,
}

impl CacheEvictor {
    /// Starts one thread per core. Each begins a pass half-way between two whole multiples of `period_ns` on
    /// the clock; ticks begin at the multiples.
    pub fn start(period_ns: u64) -> Self {
        let shared = Arc::new(Shared {
            buffer: vec![1; (2 * last_level_cache()).min(MAX_BUFFER) / 8],
            period_ns,
            over: AtomicBool::new(false),
            longest_ns: AtomicU64::new(0),
        });
        let spawn = |core: u32| {
            let shared = Arc::clone(&shared);
            std::thread::spawn(move || shared.evict_on(core))
        };
        let threads = cores().into_iter().map(spawn).collect();
        Self { shared, threads }
    }

    /// How long after the middle of its period the slowest pass ended, ns. Beyond half a period it reached into
    /// a tick.
    pub fn longest_ns(&self) -> u64 {
        self.shared.longest_ns.load(Ordering::Relaxed)
    }
}

impl Drop for CacheEvictor {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn next_pass_ns(&self) -> u64 {
        monotonic_ns().next_multiple_of(self.period_ns) + self.period_ns / 2
    }

    fn evict_on(&self, core: u32) {
        let mut set = CpuSet::new();
        set.set(core as usize);
        // Fails where this process may not use the core. The thread then runs on another one.
        let _ = sched_setaffinity(None, &set);
        let mut at = self.next_pass_ns();
        while !self.over.load(Ordering::Relaxed) {
            sleep_until(at);
            let sum: u64 = self.buffer.iter().step_by(STRIDE).sum();
            black_box(sum);
            self.longest_ns.fetch_max(monotonic_ns().saturating_sub(at), Ordering::Relaxed);
            at = self.next_pass_ns();
        }
    }
}

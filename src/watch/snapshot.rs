//! One object with the numbers of now, for scripts.

use tectum_view::page;

use super::Follower;
use crate::clock::{TerminationSignals, monotonic_ns, pause};

/// How long it looks, so that there are rates and percentiles, ns.
const LOOK_NS: u64 = 1_000_000_000;
/// Time between two looks, ns.
const EVERY_NS: u64 = 50_000_000;

/// Watches a run for a second, from its first tick on, and gives its numbers as one JSON object. `None` if a signal
/// came first.
pub fn snapshot(follower: &mut Follower, signals: &TerminationSignals) -> Option<String> {
    let began = monotonic_ns();
    let mut since = None;
    while signals.received() == 0 {
        let now = monotonic_ns();
        follower.look((now - began) as f64 / 1e9);
        if let Some(view) = follower.view() {
            if view.taken > 0 {
                since.get_or_insert(now);
            }
            if follower.is_over() || since.is_some_and(|since| now - since >= LOOK_NS) {
                return Some(page::state(view).to_string());
            }
        }
        pause(EVERY_NS);
    }
    None
}

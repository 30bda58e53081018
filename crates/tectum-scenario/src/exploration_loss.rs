//! The loss that exploration alone causes. No policy can avoid it. It is known for the built-in arm only.

use super::Plan;
use tectum_core::plant::noise_share;

impl Plan {
    /// The mean loss per tick that exploration alone causes, as steps of (first tick, loss) in the order of
    /// ticks; empty where it is not known. It changes only when a joint blocks.
    pub fn exploration_loss(&self) -> Vec<(u64, f64)> {
        let Some(arm) = &self.scenario.plant.arm else { return Vec::new() };
        let mut ticks: Vec<u64> = std::iter::once(0).chain(arm.block.iter().map(|block| block.tick)).collect();
        ticks.sort_unstable();
        ticks.dedup();
        ticks.into_iter().map(|tick| (tick, noise_share(arm, self.scenario.policy.sigma, tick))).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::Scenario;
    use tectum_core::plant::noise_share;

    #[test]
    fn steps_equal_the_arms_noise_share_in_every_tick() {
        let plan = Scenario::find("arm").unwrap().plan().unwrap();
        let arm = plan.scenario.plant.arm.as_ref().unwrap();
        assert!(!arm.block.is_empty(), "the test needs a joint that blocks");
        let steps = plan.exploration_loss();
        for tick in arm.block.iter().flat_map(|block| [0, block.tick - 1, block.tick, block.tick + 1, u64::MAX]) {
            let step = steps.iter().rev().find(|(from, _)| *from <= tick).unwrap();
            assert_eq!(step.1.to_bits(), noise_share(arm, plan.scenario.policy.sigma, tick).to_bits(), "tick {tick}");
        }
    }
}

//! How long the stages of a tick take: the last ones for percentiles, and all of them in a histogram.

/// Ticks whose times are kept: at a period of 50 ms, the last 50 seconds.
const KEPT: usize = 1000;
/// Bins of a histogram: four to a decade, from 1 us to 10 s.
const BINS: usize = 28;

/// A stage of a tick in real time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// From the scheduled instant until the observation was sent: waking up, the gate, sensing.
    Sensing = 0,
    /// From then until the command was sent: encoding, learning from the reward, drawing.
    Answer = 1,
    /// From then until the learner was done.
    Learning = 2,
    /// From then until the next tick; 0 where it was overrun.
    Slack = 3,
}

impl Stage {
    /// All stages, in the order of a tick.
    pub const ALL: [Self; 4] = [Self::Sensing, Self::Answer, Self::Learning, Self::Slack];

    /// Name for people.
    pub const fn name(self) -> &'static str {
        ["sensing", "answer", "learning", "slack"][self as usize]
    }
}

/// Times of one stage, us.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTimes {
    last: Vec<f32>,
    next: usize,
    sum: f64,
    histogram: [u64; BINS],
}

impl Default for StageTimes {
    fn default() -> Self {
        Self { last: Vec::new(), next: 0, sum: 0.0, histogram: [0; BINS] }
    }
}

impl StageTimes {
    /// Adds a time, us.
    pub fn add(&mut self, us: f64) {
        if self.last.len() < KEPT {
            self.last.push(us as f32);
        } else {
            self.last[self.next] = us as f32;
            self.next = (self.next + 1) % KEPT;
        }
        self.sum += us;
        let bin = (us.max(1.0).log10() * 4.0) as usize;
        self.histogram[bin.min(BINS - 1)] += 1;
    }

    /// The `shares` (0 to 1) of the last times, us: 0.5 gives the median. `None` before the first time.
    pub fn quantiles<const N: usize>(&self, shares: [f64; N]) -> Option<[f64; N]> {
        let mut sorted = self.last.clone();
        sorted.sort_by(f32::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        Some(shares.map(|share| f64::from(sorted[(share.clamp(0.0, 1.0) * last as f64).round() as usize])))
    }

    /// Sum of all times, us.
    pub fn sum_us(&self) -> f64 {
        self.sum
    }

    /// Number of all times.
    pub fn count(&self) -> u64 {
        self.histogram.iter().sum()
    }

    /// Bins with their lower ends, us, and how many of all times fell into each.
    pub fn histogram(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        self.histogram.iter().enumerate().map(|(i, &n)| (10_f64.powf(i as f64 / 4.0), n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_last_times_and_the_histogram_of_all() {
        let mut times = StageTimes::default();
        assert_eq!(times.quantiles([0.5]), None);
        (0..KEPT).for_each(|_| times.add(5e6));
        (1..=KEPT).for_each(|us| times.add(us as f64));
        let [p50, p99, least] = times.quantiles([0.5, 0.99, 0.0]).unwrap();
        assert!((p50 - 500.0).abs() <= 1.0 && (p99 - 990.0).abs() <= 1.0 && least == 1.0, "{p50} {p99} {least}");
        assert_eq!(times.histogram().map(|(_, n)| n).sum::<u64>(), 2 * KEPT as u64);
        assert_eq!(times.histogram().last().map(|(_, n)| n), Some(0));
    }
}

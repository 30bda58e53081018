//! A curve over a whole run in a bounded number of points.

/// Most bins of a curve; at this number, two neighbours become one.
const BINS: usize = 512;

/// Means over equal spans of ticks, from tick 0 on. The spans double whenever there would be too many of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Ticks of a bin.
    span: u64,
    /// Sum and number of the values in each bin.
    bins: Vec<(f64, u64)>,
}

impl Default for Curve {
    fn default() -> Self {
        Self { span: 1, bins: Vec::new() }
    }
}

impl Curve {
    /// Adds the value of a tick. What is not finite is left out.
    pub fn add(&mut self, tick: u64, value: f64) {
        if !value.is_finite() {
            return;
        }
        while tick / self.span >= BINS as u64 {
            self.span *= 2;
            self.bins =
                self.bins.chunks(2).map(|pair| pair.iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1))).collect();
        }
        let bin = (tick / self.span) as usize;
        if bin >= self.bins.len() {
            self.bins.resize(bin + 1, (0.0, 0));
        }
        self.bins[bin].0 += value;
        self.bins[bin].1 += 1;
    }

    /// The points: the tick in the middle of each bin with a value, and the mean of its values.
    pub fn points(&self) -> impl Iterator<Item = (u64, f64)> + '_ {
        let filled = self.bins.iter().enumerate().filter(|(_, bin)| bin.1 > 0);
        filled.map(|(i, (sum, n))| (i as u64 * self.span + self.span / 2, sum / *n as f64))
    }

    /// Ticks that a point stands for.
    pub fn span(&self) -> u64 {
        self.span
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_keeps_means_in_a_bounded_number_of_points() {
        let mut curve = Curve::default();
        (0..100_000).for_each(|tick| curve.add(tick, f64::from(u8::from(tick >= 50_000))));
        curve.add(7, f64::NAN);
        let points: Vec<_> = curve.points().collect();
        assert!(points.len() > BINS / 4 && points.len() <= BINS, "{}", points.len());
        assert_eq!((curve.span(), points[0], points[points.len() - 1].1), (256, (128, 0.0), 1.0));
        let mean: f64 = points.iter().map(|(_, value)| value).sum::<f64>() / points.len() as f64;
        assert!((mean - 0.5).abs() < 0.01, "{mean}");
        curve.add(u64::MAX, 1.0);
        assert!(curve.points().count() <= BINS);
    }
}

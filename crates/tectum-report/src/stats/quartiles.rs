//! Statistics over many movements: quartiles, and a straight line through points.

use serde::Serialize;

/// The middle half of some values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quartiles {
    /// Number of values.
    pub n: usize,
    /// A quarter of the values is smaller.
    pub q25: f64,
    /// Half of the values is smaller.
    pub median: f64,
    /// A quarter of the values is larger.
    pub q75: f64,
}

impl Quartiles {
    /// The quartiles of `values`, between neighbours where they fall between; `None` of no values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| {
            let x = share * (sorted.len() - 1) as f64;
            let (low, high) = (sorted[x.floor() as usize], sorted[x.ceil() as usize]);
            low + x.fract() * (high - low)
        };
        (!sorted.is_empty()).then(|| Self { n: sorted.len(), q25: at(0.25), median: at(0.5), q75: at(0.75) })
    }
}

/// The straight line that fits points best, by least squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fit {
    /// Number of points.
    pub n: usize,
    /// Value at 0.
    pub intercept: f64,
    /// Rise a unit.
    pub slope: f64,
    /// Pearson's correlation; null where the values are all equal.
    pub r: Option<f64>,
}

impl Fit {
    /// The line through `points`; `None` for fewer than three points, or if all have the same x.
    pub fn of(points: &[(f64, f64)]) -> Option<Self> {
        let n = points.len() as f64;
        let mean = |value: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / n;
        let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
        let (xx, yy, xy) =
            (mean(&|p| (p.0 - x) * (p.0 - x)), mean(&|p| (p.1 - y) * (p.1 - y)), mean(&|p| (p.0 - x) * (p.1 - y)));
        let slope = xy / xx;
        let fine = points.len() >= 3 && slope.is_finite() && (y - slope * x).is_finite();
        let r = Some(xy / (xx * yy).sqrt()).filter(|r| r.is_finite());
        fine.then_some(Self { n: points.len(), intercept: y - slope * x, slope, r })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_lie_between_neighbours() {
        let q = Quartiles::of([4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((q.n, q.q25, q.median, q.q75), (4, 1.75, 2.5, 3.25));
        assert_eq!(Quartiles::of([7.0]).unwrap(), Quartiles { n: 1, q25: 7.0, median: 7.0, q75: 7.0 });
        assert_eq!(Quartiles::of([]), None);
    }

    #[test]
    fn a_line_is_found_again() {
        let line: Vec<(f64, f64)> = (0..9).map(|i| (f64::from(i), 0.5 - 0.25 * f64::from(i))).collect();
        assert_eq!(Fit::of(&line), Some(Fit { n: 9, intercept: 0.5, slope: -0.25, r: Some(-1.0) }));
        let flat = Fit::of(&[(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]).unwrap();
        assert_eq!((flat.slope, flat.r), (0.0, None), "perfect isochrony has no correlation");
        assert_eq!(Fit::of(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(Fit::of(&line[..2]), None);
    }
}

//! The check of the gradient against differences.

use super::super::layout::Layout;
use super::Evidence;

impl Evidence {
    /// Compares the gradient with differences.
    pub fn check_gradient(&mut self, layout: &Layout) {
        self.evaluate(layout, 2.5, 1e-7).unwrap();
        let gradient = self.gradient.clone();
        for (k, g) in gradient.iter().enumerate().filter(|(k, _)| layout.learned[*k]) {
            let before = self.scales[k];
            let mut at = |x| {
                self.scales[k] = x;
                self.evaluate(layout, 2.5, 1e-7).unwrap()
            };
            let slope = (at(before + 1e-5) - at(before - 1e-5)) / 2e-5;
            self.scales[k] = before;
            assert!((slope - g).abs() < 1e-4 * (1.0 + g.abs()), "scale {k}: {slope} {g}");
        }
    }
}

//! Which products have a feature: those of largest prior variance.

use super::super::functions::exp;
use super::super::layout::{Layout, PAIRS, PRODUCTS, ScaleKind, TRIPLES};
use super::{MAX_GROUPS, ModelFeatures, NONE, Node};

/// A candidate: its prior variance, and which component of each group it has (0 for none).
#[derive(Debug, Clone, Copy)]
pub(super) struct ProductCandidate {
    variance: f64,
    order: u8,
    choice: [u8; MAX_GROUPS],
}

impl ModelFeatures {
    /// Most products of the first groups that are kept: all of at most two components, and as many of three, and of
    /// more, as can be chosen.
    pub(super) fn beam(&self, layout: &Layout) -> usize {
        let single = layout.components;
        1 + single + single * single.saturating_sub(1) / 2 + 2 * self.products
    }

    /// Chooses the products of largest prior variance. Keeping the best of the products of the first groups, group
    /// after group, misses none, because variances are products over groups, and the amplitude depends on their
    /// number alone.
    pub(super) fn choose_products(&mut self, layout: &Layout) {
        self.candidates.clear();
        self.candidates.push(ProductCandidate { variance: 1.0, order: 0, choice: [0; MAX_GROUPS] });
        for (g, units) in layout.groups.iter().enumerate() {
            self.spare.clear();
            for candidate in &self.candidates {
                self.spare.push(*candidate);
                for &u in units {
                    let unit = &layout.units[u];
                    let v = product_scale(&self.scales, layout, u);
                    for c in unit.component..unit.component + if unit.circle { 2 } else { 1 } {
                        let mut next = *candidate;
                        next.variance *= v * self.mean_squares[c];
                        next.order += 1;
                        next.choice[g] = c as u8 + 1;
                        self.spare.push(next);
                    }
                }
            }
            self.spare.sort_unstable_by(larger_variance);
            let mut left = [usize::MAX, self.products, self.products];
            self.spare.retain(|candidate| {
                let left = &mut left[class(candidate.order)];
                let is_kept = *left > 0;
                *left = left.saturating_sub(1);
                is_kept
            });
            std::mem::swap(&mut self.candidates, &mut self.spare);
        }
        self.candidates.retain(|c| c.order >= 2);
        for candidate in &mut self.candidates {
            candidate.variance *= amplitude(&self.scales, candidate.order);
        }
        self.candidates.sort_unstable_by(larger_variance);
        self.candidates.truncate(self.products);
        self.candidates.sort_unstable_by_key(|candidate| candidate.choice);
        self.plant_nodes(layout);
    }

    /// Makes the tree of the chosen products, which share what they begin with.
    fn plant_nodes(&mut self, layout: &Layout) {
        let parts = self.parts(layout);
        self.nodes.clear();
        let mut before = [0_u8; MAX_GROUPS];
        // The node of each group's choice in the candidate before; the first `shared` groups are equal in both.
        let mut path = [NONE; MAX_GROUPS];
        for (feature, candidate) in self.candidates.iter().enumerate() {
            let shared = (0..MAX_GROUPS).find(|&g| candidate.choice[g] != before[g]).unwrap_or(MAX_GROUPS);
            let shared = if feature == 0 { 0 } else { shared };
            let mut variance = amplitude(&self.scales, candidate.order);
            let mut parent = NONE;
            for g in (0..MAX_GROUPS).filter(|&g| candidate.choice[g] > 0) {
                let component = usize::from(candidate.choice[g]) - 1;
                let unit = layout.units.iter().rposition(|u| u.component <= component).unwrap_or(0);
                variance *= product_scale(&self.scales, layout, unit);
                if g >= shared {
                    path[g] = self.nodes.len() as u32;
                    self.nodes.push(Node { parent, component: component as u32, feature: NONE });
                }
                parent = path[g];
            }
            before = candidate.choice;
            self.nodes[parent as usize].feature = feature as u32;
            self.amplitudes[parts.products + feature] = variance.sqrt();
        }
    }
}

/// Products of so many components share an amplitude: at most two, three, more.
fn class(order: u8) -> usize {
    usize::from(order.clamp(2, 4)) - 2
}

/// The amplitude of products of so many components.
fn amplitude(scales: &[f64], order: u8) -> f64 {
    exp(scales[[PAIRS, TRIPLES, PRODUCTS][class(order)]])
}

/// The factor of a unit in products; 0 for one that the model does not look at.
fn product_scale(scales: &[f64], layout: &Layout, unit: usize) -> f64 {
    let has = layout.units[unit].scales[ScaleKind::Product as usize];
    if has { exp(scales[Layout::scale(unit, ScaleKind::Product)]) } else { 0.0 }
}

/// The order of candidates: that of larger variance comes first.
fn larger_variance(a: &ProductCandidate, b: &ProductCandidate) -> std::cmp::Ordering {
    b.variance.total_cmp(&a.variance).then(a.choice.cmp(&b.choice))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learner::model_predictive::layout::Priors;

    #[test]
    fn products_of_two_are_chosen_by_their_own_amplitude() {
        let chosen = |pairs: f64| {
            let mut layout = Layout::new(4, [1.0, pairs, 0.5, 0.5, 0.1, 1e-3]);
            for at in 0..4 {
                layout.number(at, Some(at), Priors { linear: 0.3, square: 0.2, product: 6.0, smooth: 0.2 });
            }
            let features = ModelFeatures::new(&layout, 4, 5, || 0.3);
            let orders = features.candidates.iter().map(|c| c.order).collect::<Vec<_>>();
            assert_eq!(orders.len(), 5);
            orders.iter().filter(|order| **order == 2).count()
        };
        // 6 products of two, 4 of three, 1 of four, each variance twice that of the order below but for the amplitude.
        assert_eq!([chosen(0.5), chosen(10.0)], [0, 5]);
    }
}

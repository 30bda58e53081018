//! The Hessian of a model's products, all of its rows at once.
//!
//! Along each place of `q` the derivative of the tree is carried forwards, and that of its adjoint backwards (Griewank
//! & Walther 2008, forward over reverse). The places stand side by side in groups of [`LANES`], so that one walk
//! through the tree serves them all.

use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

use super::super::features::{BasisValues, Node, parent};
use super::super::layout::Layout;
use super::super::linalg::wide;

/// Places of a group.
const LANES: usize = 4;

/// Scratch memory of the products' Hessian.
#[derive(Debug, Clone)]
pub struct ProductCurves {
    /// The rows of the Hessian that products have a part in.
    rows: Vec<usize>,
    /// Derivative of each component by the places of these rows.
    moved: Vec<f64>,
    /// That of each node.
    along: Vec<f64>,
    /// That of each node's adjoint.
    turned: Vec<f64>,
    /// That of the output's derivative by each component.
    change: Vec<f64>,
}

impl ProductCurves {
    /// For trees of at most `nodes` nodes over `components` components, and Hessians over at most `places` places.
    pub fn new(nodes: usize, components: usize, places: usize) -> Self {
        let lanes = places.next_multiple_of(LANES);
        Self {
            rows: Vec::with_capacity(places),
            moved: vec![0.0; components * lanes],
            along: vec![0.0; nodes * lanes],
            turned: vec![0.0; nodes * lanes],
            change: vec![0.0; components * lanes],
        }
    }

    /// Adds the products' part to a Hessian over `places`, given the values of all components and nodes and the
    /// `adjoint` of each node.
    pub fn add(
        &mut self,
        layout: &Layout,
        nodes: &[Node],
        (basis, adjoint): (&BasisValues, &[f64]),
        places: &[usize],
        hessian: &mut [f64],
    ) {
        let units = || layout.units.iter().filter(|unit| unit.group.is_some());
        let in_products = |row: &usize| units().any(|unit| unit.terms.factor(places[*row]) != 0.0);
        self.rows.clear();
        self.rows.extend((0..places.len()).filter(in_products));
        let lanes = self.rows.len().next_multiple_of(LANES);
        let (moved, change) =
            (&mut self.moved[..layout.components * lanes], &mut self.change[..layout.components * lanes]);
        let (along, turned) = (&mut self.along[..nodes.len() * lanes], &mut self.turned[..nodes.len() * lanes]);
        moved.fill(0.0);
        for unit in units() {
            for (lane, row) in self.rows.iter().enumerate() {
                for c in unit.component..unit.component + if unit.circle { 2 } else { 1 } {
                    moved[c * lanes + lane] = unit.terms.factor(places[*row]) * basis.slopes[c];
                }
            }
        }
        turned.fill(0.0);
        change.fill(0.0);
        walk(nodes, [&basis.e, &basis.nodes, adjoint], moved, [along, turned, &mut *change]);
        for unit in units() {
            for (at, factor) in unit.terms.each() {
                let Some(column) = places.iter().position(|p| p == at) else { continue };
                for c in unit.component..unit.component + if unit.circle { 2 } else { 1 } {
                    for (lane, row) in self.rows.iter().enumerate() {
                        hessian[row * places.len() + column] += factor * change[c * lanes + lane] * basis.slopes[c];
                    }
                }
            }
        }
    }
}

wide! {
    walk, walk_on, Walk,
    plain_walk(nodes: &'a [Node], values: [&'a [f64]; 3], moved: &'a [f64], to: [&'a mut [f64]; 3]) -> ()
}

/// Forwards and backwards through the tree.
#[inline(always)]
fn plain_walk(
    nodes: &[Node],
    [e, values, adjoint]: [&[f64]; 3],
    moved: &[f64],
    [along, turned, change]: [&mut [f64]; 3],
) {
    let (moved, along) = (moved.as_chunks::<LANES>().0, along.as_chunks_mut::<LANES>().0);
    let (turned, change) = (turned.as_chunks_mut::<LANES>().0, change.as_chunks_mut::<LANES>().0);
    let groups = moved.len() / e.len().max(1);
    for (k, node) in nodes.iter().enumerate() {
        let c = node.component as usize;
        let moved = &moved[c * groups..][..groups];
        let (before, rest) = along.split_at_mut(k * groups);
        let to = &mut rest[..groups];
        if let Some(p) = parent(node) {
            let (above, value, factor) = (&before[p * groups..][..groups], values[p], e[c]);
            for ((to, above), moved) in to.iter_mut().zip(above).zip(moved) {
                for lane in 0..LANES {
                    to[lane] = above[lane] * factor + moved[lane] * value;
                }
            }
        } else {
            to.copy_from_slice(moved);
        }
    }
    for (k, node) in nodes.iter().enumerate().rev() {
        let c = node.component as usize;
        let (moved, change) = (&moved[c * groups..][..groups], &mut change[c * groups..][..groups]);
        let (before, rest) = turned.split_at_mut(k * groups);
        let here = &rest[..groups];
        if let Some(p) = parent(node) {
            let (value, factor, slope) = (values[p], e[c], adjoint[k]);
            let (above, along) = (&mut before[p * groups..][..groups], &along[p * groups..][..groups]);
            for ((((change, above), here), along), moved) in
                change.iter_mut().zip(above).zip(here).zip(along).zip(moved)
            {
                for lane in 0..LANES {
                    change[lane] += here[lane] * value + slope * along[lane];
                    above[lane] += here[lane] * factor + moved[lane] * slope;
                }
            }
        } else {
            for (change, here) in change.iter_mut().zip(here) {
                for lane in 0..LANES {
                    change[lane] += here[lane];
                }
            }
        }
    }
}

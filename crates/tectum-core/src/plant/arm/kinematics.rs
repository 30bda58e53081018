//! Forward kinematics of the chain of segments: positions of the joints, and which segments cross.

use crate::MAX_OUTPUTS;
use crate::plant::{Angles, ArmConfig};

/// Positions of base, joints and end-effector, m, for angles `theta`, rad, and the lengths of `config`.
///
/// For figures: computed in double precision with the standard library's sine and cosine, whose last bits
/// differ between machines.
pub fn posture(config: &ArmConfig, theta: &[f32]) -> Vec<[f64; 2]> {
    let mut points = vec![config.base];
    let mut direction = 0.0;
    for (length, &theta) in config.lengths.iter().zip(theta) {
        direction = match config.angles {
            Angles::Absolute => f64::from(theta),
            Angles::Relative => direction + f64::from(theta),
        };
        let [x, y] = points[points.len() - 1];
        points.push([x + length * direction.cos(), y + length * direction.sin()]);
    }
    points
}

/// The points of a chain in single precision: the base, then the end of each segment.
#[derive(Debug, Clone, Copy)]
pub(super) struct KinematicChain {
    points: [[f32; 2]; MAX_OUTPUTS + 1],
    segments: usize,
}

impl KinematicChain {
    /// The chain of `lengths` with angles `theta`.
    pub fn new(base: [f32; 2], lengths: &[f32], theta: &[f32], angles: Angles) -> Self {
        let mut points = [base; MAX_OUTPUTS + 1];
        for_each_point(base, lengths, theta, angles, |i, point| points[i + 1] = point);
        Self { points, segments: lengths.len() }
    }

    /// The base, for 0, or the end of segment `number`, counted from 1.
    pub fn point(&self, number: usize) -> [f32; 2] {
        self.points[number]
    }

    /// Number of pairs of segments that cross or touch. Neighbours always touch and may fold back on each
    /// other; they are not counted.
    pub fn crossings(&self) -> usize {
        let segment = |i: usize| [self.points[i], self.points[i + 1]];
        let pairs = (0..self.segments).flat_map(|i| (i + 2..self.segments).map(move |j| (i, j)));
        pairs.filter(|&(i, j)| intersect(segment(i), segment(j))).count()
    }
}

/// The position of the end-effector; most ticks need no other point of the chain.
pub(super) fn end_effector(base: [f32; 2], lengths: &[f32], theta: &[f32], angles: Angles) -> [f32; 2] {
    let mut end = base;
    for_each_point(base, lengths, theta, angles, |_, point| end = point);
    end
}

/// Calls `visit` with the index and the end point of each segment in turn.
#[inline]
fn for_each_point(
    base: [f32; 2],
    lengths: &[f32],
    theta: &[f32],
    angles: Angles,
    mut visit: impl FnMut(usize, [f32; 2]),
) {
    let ([mut x, mut y], mut direction) = (base, 0.0);
    for (i, (length, &theta)) in lengths.iter().zip(theta).enumerate() {
        direction = match angles {
            Angles::Absolute => theta,
            Angles::Relative => direction + theta,
        };
        let (sin, cos) = libm::sincosf(direction);
        (x, y) = (x + length * cos, y + length * sin);
        visit(i, [x, y]);
    }
}

/// Whether two segments have a point in common; no rounding affects the result.
fn intersect([a, b]: [[f32; 2]; 2], [c, d]: [[f32; 2]; 2]) -> bool {
    let (c_side, d_side) = (side(a, b, c), side(a, b, d));
    let (a_side, b_side) = (side(c, d, a), side(c, d, b));
    if c_side * d_side < 0 && a_side * b_side < 0 {
        return true;
    }
    // A point on the line of the other segment is on the segment if it is within the segment's bounding box.
    let within = |[a, b]: [[f32; 2]; 2], p: [f32; 2]| (0..2).all(|i| (a[i].min(b[i])..=a[i].max(b[i])).contains(&p[i]));
    (c_side == 0 && within([a, b], c))
        || (d_side == 0 && within([a, b], d))
        || (a_side == 0 && within([c, d], a))
        || (b_side == 0 && within([c, d], b))
}

/// The side of the line from `a` to `b` on which the point `p` lies: 1 left, -1 right, 0 on the line.
///
/// The result is exact: differences of single-precision numbers whose magnitudes differ by less than a factor
/// of 2^29, and products of two such differences of 25 bits, have no rounding error in double precision.
fn side(a: [f32; 2], b: [f32; 2], p: [f32; 2]) -> i32 {
    let [along, across] = [0, 1].map(|i| f64::from(b[i]) - f64::from(a[i]));
    let [x, y] = [0, 1].map(|i| f64::from(p[i]) - f64::from(a[i]));
    let (left, right) = (along * y, across * x);
    i32::from(left > right) - i32::from(left < right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f32::consts::{FRAC_PI_2, PI};

    fn crossings(lengths: &[f32], theta: &[f32]) -> usize {
        KinematicChain::new([0.0, -1.0], lengths, theta, Angles::Relative).crossings()
    }

    #[test]
    fn known_postures_have_the_expected_number_of_crossings() {
        for (lengths, theta, expected) in [
            // Straight; bent without a crossing; rolled up so that the last segment crosses the first.
            (&[0.5; 4][..], &[0.0; 4][..], 0),
            (&[0.5; 4], &[0.3, 0.6, 0.6, -0.6], 0),
            (&[1.0, 1.0, 0.8, 1.5], &[0.0, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2], 1),
            // The fourth segment stays inside and the fifth crosses the second; then one that crosses the
            // first, and one that crosses the first and the third.
            (&[1.0, 1.0, 0.8, 0.5, 1.5], &[0.0, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2], 1),
            (&[1.0, 1.0, 0.8, 1.5, 0.3, 2.0], &[0.0, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2], 3),
            // Neighbours may fold back on each other.
            (&[0.5; 2], &[0.0, PI], 0),
        ] {
            assert_eq!(crossings(lengths, theta), expected, "{theta:?}");
        }
    }

    #[test]
    fn segments_intersect_where_they_touch_and_not_beside() {
        let level = [[0.0, 0.0], [1.0, 0.0]];
        assert!(intersect(level, [[0.5, -1.0], [0.5, 1.0]]), "across");
        assert!(intersect(level, [[0.5, 0.0], [0.5, 1.0]]), "a touch");
        assert!(intersect(level, [[1.0, 0.0], [2.0, 5.0]]), "an end in common");
        assert!(intersect(level, [[0.5, 0.0], [3.0, 0.0]]), "an overlap");
        assert!(!intersect(level, [[1.5, 0.0], [3.0, 0.0]]), "one line, apart");
        assert!(!intersect(level, [[0.5, 1e-7], [0.5, 1.0]]), "slightly above");
        assert!(!intersect(level, [[2.0, -1.0], [2.0, 1.0]]), "beyond the end");
    }

    proptest! {
        #[test]
        fn an_intersection_does_not_depend_on_the_order_of_points(p in prop::array::uniform8(-1.0_f32..1.0)) {
            let (a, b, c, d) = ([p[0], p[1]], [p[2], p[3]], [p[4], p[5]], [p[6], p[7]]);
            let crosses = intersect([a, b], [c, d]);
            prop_assert_eq!(crosses, intersect([c, d], [a, b]));
            prop_assert_eq!(crosses, intersect([b, a], [c, d]));
            prop_assert_eq!(crosses, intersect([a, b], [d, c]));
            // Another method: the parameters of the intersection of the lines, in double precision.
            let cross = |u: [f64; 2], v: [f64; 2]| u[0] * v[1] - u[1] * v[0];
            let from = |a: [f32; 2], b: [f32; 2]| [0, 1].map(|i| f64::from(b[i]) - f64::from(a[i]));
            let (r, s, q) = (from(a, b), from(c, d), from(a, c));
            let (t, u) = (cross(q, s) / cross(r, s), cross(q, r) / cross(r, s));
            // Cases in which rounding could decide are left out.
            let clear = |x: f64| x.abs() > 1e-9 && (x - 1.0).abs() > 1e-9;
            if cross(r, s).abs() > 1e-9 && clear(t) && clear(u) {
                prop_assert_eq!(crosses, (0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u));
            }
        }
    }

    #[test]
    fn posture_and_chain_agree() {
        for angles in [Angles::Absolute, Angles::Relative] {
            let config = ArmConfig { angles, ..ArmConfig::default() };
            let theta = [0.3, -0.8, 1.2, 0.5];
            let chain = KinematicChain::new([0.0, -1.0], &[0.5; 4], &theta, angles);
            assert_eq!(chain.points[4], end_effector([0.0, -1.0], &[0.5; 4], &theta, angles));
            let end = posture(&config, &theta)[4];
            assert!((0..2).all(|i| (end[i] - f64::from(chain.points[4][i])).abs() < 1e-6), "{angles:?}");
        }
    }
}

//! The chain of segments: where its joints are, and which of its segments cross.

use crate::MAX_OUTPUTS;
use crate::plant::{Angles, ArmConfig};

/// The joints' positions, m, from the base to the end-effector, for the table's kind of angles `theta`, rad, and its
/// lengths.
///
/// They are for pictures: double precision, with the sine and cosine of the machine.
pub fn posture(table: &ArmConfig, theta: &[f32]) -> Vec<[f64; 2]> {
    let mut points = vec![table.base];
    let mut direction = 0.0;
    for (length, &theta) in table.lengths.iter().zip(theta) {
        direction = match table.angles {
            Angles::Absolute => f64::from(theta),
            Angles::Relative => direction + f64::from(theta),
        };
        let [x, y] = points[points.len() - 1];
        points.push([x + length * direction.cos(), y + length * direction.sin()]);
    }
    points
}

/// A chain in single precision: the base, then the end of each segment.
#[derive(Debug, Clone, Copy)]
pub(super) struct KinematicChain {
    points: [[f32; 2]; MAX_OUTPUTS + 1],
    segments: usize,
}

impl KinematicChain {
    /// The chain of `lengths` with angles `theta`.
    pub fn new(base: [f32; 2], lengths: &[f32], theta: &[f32], angles: Angles) -> Self {
        let mut points = [base; MAX_OUTPUTS + 1];
        walk(base, lengths, theta, angles, |i, point| points[i + 1] = point);
        Self { points, segments: lengths.len() }
    }

    /// Pairs of segments that cross or touch each other. Neighbours always touch, and may fold back on each other: they
    /// are no pair.
    pub fn crossings(&self) -> usize {
        let segment = |i: usize| [self.points[i], self.points[i + 1]];
        let pairs = (0..self.segments).flat_map(|i| (i + 2..self.segments).map(move |j| (i, j)));
        pairs.filter(|&(i, j)| meet(segment(i), segment(j))).count()
    }
}

/// The end-effector's position, which is all that most ticks want of the chain.
pub(super) fn end(base: [f32; 2], lengths: &[f32], theta: &[f32], angles: Angles) -> [f32; 2] {
    let mut end = base;
    walk(base, lengths, theta, angles, |_, point| end = point);
    end
}

/// Calls `see` with the number and the end of each segment in turn.
#[inline]
fn walk(base: [f32; 2], lengths: &[f32], theta: &[f32], angles: Angles, mut see: impl FnMut(usize, [f32; 2])) {
    let ([mut x, mut y], mut direction) = (base, 0.0);
    for (i, (length, &theta)) in lengths.iter().zip(theta).enumerate() {
        direction = match angles {
            Angles::Absolute => theta,
            Angles::Relative => direction + theta,
        };
        let (sin, cos) = libm::sincosf(direction);
        (x, y) = (x + length * cos, y + length * sin);
        see(i, [x, y]);
    }
}

/// Whether two segments have a point in common, for the points as they are: without a rounding that matters.
fn meet([a, b]: [[f32; 2]; 2], [c, d]: [[f32; 2]; 2]) -> bool {
    let (c_side, d_side) = (side(a, b, c), side(a, b, d));
    let (a_side, b_side) = (side(c, d, a), side(c, d, b));
    if c_side * d_side < 0 && a_side * b_side < 0 {
        return true;
    }
    // A point on the other segment's line meets the segment if it lies within its box.
    let within = |[a, b]: [[f32; 2]; 2], p: [f32; 2]| (0..2).all(|i| (a[i].min(b[i])..=a[i].max(b[i])).contains(&p[i]));
    (c_side == 0 && within([a, b], c))
        || (d_side == 0 && within([a, b], d))
        || (a_side == 0 && within([c, d], a))
        || (b_side == 0 && within([c, d], b))
}

/// On which side of the line from `a` to `b` the point `p` lies: 1 left, -1 right, 0 on it.
///
/// Differences of single-precision numbers less than 2^29 apart in size, and the products of two such differences of 25
/// bits, are exact in double precision, so that comparing the products is, too.
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
    fn known_postures_cross_as_often_as_one_sees() {
        for (lengths, theta, expected) in [
            // Straight; bent, but open; a roll whose end crosses its beginning.
            (&[0.5; 4][..], &[0.0; 4][..], 0),
            (&[0.5; 4], &[0.3, 0.6, 0.6, -0.6], 0),
            (&[1.0, 1.0, 0.8, 1.5], &[0.0, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2], 1),
            // The fourth stays inside and the fifth breaks out through the second; through the first, and back through it
            // and the third.
            (&[1.0, 1.0, 0.8, 0.5, 1.5], &[0.0, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2], 1),
            (&[1.0, 1.0, 0.8, 1.5, 0.3, 2.0], &[0.0, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, FRAC_PI_2], 3),
            // Neighbours may fold back on each other.
            (&[0.5; 2], &[0.0, PI], 0),
        ] {
            assert_eq!(crossings(lengths, theta), expected, "{theta:?}");
        }
    }

    #[test]
    fn segments_meet_where_they_touch_and_not_beside() {
        let level = [[0.0, 0.0], [1.0, 0.0]];
        assert!(meet(level, [[0.5, -1.0], [0.5, 1.0]]), "across");
        assert!(meet(level, [[0.5, 0.0], [0.5, 1.0]]), "a touch");
        assert!(meet(level, [[1.0, 0.0], [2.0, 5.0]]), "an end in common");
        assert!(meet(level, [[0.5, 0.0], [3.0, 0.0]]), "an overlap");
        assert!(!meet(level, [[1.5, 0.0], [3.0, 0.0]]), "one line, apart");
        assert!(!meet(level, [[0.5, 1e-7], [0.5, 1.0]]), "just above");
        assert!(!meet(level, [[2.0, -1.0], [2.0, 1.0]]), "beyond the end");
    }

    proptest! {
        #[test]
        fn a_crossing_is_one_however_it_is_looked_at(p in prop::array::uniform8(-1.0_f32..1.0)) {
            let (a, b, c, d) = ([p[0], p[1]], [p[2], p[3]], [p[4], p[5]], [p[6], p[7]]);
            let seen = meet([a, b], [c, d]);
            prop_assert_eq!(seen, meet([c, d], [a, b]));
            prop_assert_eq!(seen, meet([b, a], [c, d]));
            prop_assert_eq!(seen, meet([a, b], [d, c]));
            // A third way: the parameters of the lines' intersection, in double precision.
            let cross = |u: [f64; 2], v: [f64; 2]| u[0] * v[1] - u[1] * v[0];
            let from = |a: [f32; 2], b: [f32; 2]| [0, 1].map(|i| f64::from(b[i]) - f64::from(a[i]));
            let (r, s, q) = (from(a, b), from(c, d), from(a, c));
            let (t, u) = (cross(q, s) / cross(r, s), cross(q, r) / cross(r, s));
            // Where rounding could decide, nothing is asked.
            let clear = |x: f64| x.abs() > 1e-9 && (x - 1.0).abs() > 1e-9;
            if cross(r, s).abs() > 1e-9 && clear(t) && clear(u) {
                prop_assert_eq!(seen, (0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u));
            }
        }
    }

    #[test]
    fn pictures_and_plant_agree_on_where_the_joints_are() {
        for angles in [Angles::Absolute, Angles::Relative] {
            let table = ArmConfig { angles, ..ArmConfig::default() };
            let theta = [0.3, -0.8, 1.2, 0.5];
            let chain = KinematicChain::new([0.0, -1.0], &[0.5; 4], &theta, angles);
            assert_eq!(chain.points[4], super::end([0.0, -1.0], &[0.5; 4], &theta, angles));
            let end = posture(&table, &theta)[4];
            assert!((0..2).all(|i| (end[i] - f64::from(chain.points[4][i])).abs() < 1e-6), "{angles:?}");
        }
    }
}

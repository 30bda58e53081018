//! Movements whose measures are known.

use super::*;
use proptest::prelude::*;

const PERIOD: f64 = 0.05;

#[track_caller]
fn near(found: Option<f64>, expected: f64, tolerance: f64) {
    let found = found.unwrap_or(f64::NAN);
    assert!((found - expected).abs() <= tolerance, "{found} for {expected}");
}

/// A movement along `points` whose target is the last of them.
fn movement(points: Vec<[f64; 2]>) -> RecordedMovement {
    let target = points[points.len() - 1];
    let errors = points[1..].iter().map(|&p| distance(p, target)).collect();
    RecordedMovement { errors, distance: distance(points[0], target), points }
}

/// Without a threshold the whole movement counts, and the numbers are those of the literature.
#[test]
fn minimum_jerk_has_the_published_measures() {
    let all = Definitions { onset: 0.0, ..Definitions::default() };
    for ticks in [20, 50, 201] {
        let m = measure(&minimum_jerk(0.8, ticks), PERIOD, &all);
        near(m.duration_s, ticks as f64 * PERIOD, 1e-12);
        near(m.onset_s, 0.0, 0.0);
        near(m.peak_to_mean, 1.875, 0.005);
        near(m.peak_speed, 1.875 * 0.8 / (ticks as f64 * PERIOD), 0.003);
        near(m.peak_position, 0.5, 1e-9);
        near(m.symmetry, 1.0, 1e-9);
        near(m.peaks, 1.0, 0.0);
        near(m.straightness, 1.0, 1e-9);
        near(m.deviation, 0.0, 1e-9);
        near(m.end_error_m, 0.0, 1e-12);
        assert_eq!(m.distance_m, 0.8);
    }
}

/// 30 t^2 (1 - t)^2 is 5 % of its peak of 1.875 at t = 0.0594: what lies between lasts 0.881 of the whole and
/// covers 0.9962.
#[test]
fn thresholds_make_the_profile_flatter() {
    let m = measure(&minimum_jerk(0.5, 1000), PERIOD, &Definitions::default());
    near(m.duration_s, 0.8812 * 1000.0 * PERIOD, 0.1);
    near(m.onset_s, 0.0594 * 1000.0 * PERIOD, 0.1);
    near(m.peak_to_mean, 1.875 * 0.8812 / 0.9962, 0.003);
    assert_eq!(m.profile.len(), PROFILE);
    near(m.profile.first().map(|&x| f64::from(x)), 0.05 * 1.6585, 0.005);
    near(m.profile.get(PROFILE / 2).map(|&x| f64::from(x)), 1.6585, 0.005);
}

/// A fifth of what is left in every tick: as long for every distance, with a peak at once. docs/results.md compares
/// what was learned with it.
#[test]
fn an_exponential_approach_lasts_as_long_for_every_distance() {
    for length in [0.1, 0.4, 1.6] {
        let point = |tick: i32| [length * (1.0 - 0.8_f64.powi(tick)), 0.0];
        let m = measure(&movement((0..=80).map(point).collect()), PERIOD, &Definitions::default());
        // 0.8^13 is the last power above 5 %.
        near(m.duration_s, 14.0 * PERIOD, 1e-9);
        near(m.peak_speed, 0.2 * length / PERIOD, 1e-9);
        near(m.peak_to_mean, 14.0 * 0.2 / (1.0 - 0.8_f64.powi(14)), 1e-6);
    }
}

/// 10 t^3 - 15 t^4 + 6 t^5 is 0.9 at t = 0.7534 and 0.8 at t = 0.6734.
#[test]
fn settling_is_when_the_error_stays_within_the_tolerance() {
    let m = measure(&minimum_jerk(0.5, 1000), 0.001, &Definitions::default());
    near(m.settled_share_s, 0.7534, 0.001);
    near(m.settled_s, 0.6734, 0.001);

    let errors = |errors: &[f64]| RecordedMovement {
        points: vec![[0.0; 2]; errors.len() + 1],
        errors: errors.to_vec(),
        distance: 1.0,
    };
    let settled = |movement: &RecordedMovement| measure(movement, 1.0, &Definitions::default()).settled_s;
    assert_eq!(settled(&errors(&[0.5, 0.05, 0.3, 0.1, 0.0])), Some(4.0), "within, out again, and back");
    assert_eq!(settled(&errors(&[0.5, 0.05, 0.3])), None);
    assert_eq!(settled(&errors(&[0.05, 0.05])), Some(1.0));
    assert_eq!(
        settled(&RecordedMovement { distance: 0.1, ..errors(&[0.05, 0.05]) }),
        Some(0.0),
        "within the tolerance from the beginning"
    );
    assert_eq!(settled(&errors(&[])), None);
}

#[test]
fn a_detour_is_not_straight() {
    // Half a circle and then rest: its length is pi/2 of the straight line, its deviation half of it.
    let angle = |i: usize| std::f64::consts::PI * (1.0 - i.min(400) as f64 / 400.0);
    let circle = (0..=500).map(|i| [angle(i).cos(), angle(i).sin()]).collect();
    let m = measure(&movement(circle), PERIOD, &Definitions::default());
    near(m.straightness, std::f64::consts::FRAC_PI_2, 1e-4);
    near(m.deviation, 0.5, 1e-6);
    near(m.peak_to_mean, 1.0, 1e-6);
    // It ends where it began, so there is no straight line to compare with.
    let m = measure(&movement(vec![[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]), PERIOD, &Definitions::default());
    assert_eq!((m.straightness, m.deviation, m.peaks), (None, None, Some(1.0)));
}

#[test]
fn sub_movements_are_counted() {
    let bell = |ticks: usize| minimum_jerk(0.4, ticks).points.into_iter().take(ticks + 1);
    let two: Vec<[f64; 2]> = bell(20).chain(bell(20).skip(1).map(|p| [p[0] + 0.4, 0.0])).collect();
    near(measure(&movement(two), PERIOD, &Definitions::default()).peaks, 2.0, 0.0);
    // Ripples of less than a tenth are not peaks; a sudden start is one.
    assert_eq!(peaks(&[1.0, 0.95, 1.0, 0.93, 0.99, 0.5, 0.55, 0.0], 0.1), 1);
    assert_eq!(peaks(&[1.0, 0.6, 0.3, 0.2, 0.1], 0.1), 1);
    assert_eq!(peaks(&[0.3, 1.0, 0.3, 0.6, 0.2], 0.1), 2);
}

/// A controller that starts at full speed and slows down, as a policy linear in the error does.
#[test]
fn a_sudden_start_is_not_bell_shaped() {
    let m =
        measure(&movement((0..80).map(|i| [1.0 - 0.8_f64.powi(i), 0.0]).collect()), PERIOD, &Definitions::default());
    near(m.onset_s, 0.0, 0.0);
    assert!(m.peak_position.unwrap() < 0.1 && m.symmetry.unwrap() < 0.6 && m.peaks == Some(1.0), "{m:?}");
}

#[test]
fn a_reach_that_has_not_ended_has_no_duration() {
    let mut cut = minimum_jerk(0.8, 40);
    cut.points.truncate(31);
    cut.errors.truncate(30);
    let m = measure(&cut, PERIOD, &Definitions::default());
    assert_eq!((m.duration_s, m.mean_speed, m.peak_to_mean, m.symmetry), (None, None, None, None));
    assert!(m.profile.is_empty());
    // These measures exist without a duration.
    near(m.peak_speed, 1.875 * 0.8 / 2.0, 0.003);
    near(m.straightness, 1.0, 1e-9);
}

#[test]
fn an_arm_that_never_moves_has_no_speeds() {
    let m = measure(&movement(vec![[0.3, 0.2]; 5]), PERIOD, &Definitions::default());
    assert_eq!((m.duration_s, m.peak_speed, m.straightness, m.end_error_m), (None, None, None, Some(0.0)));
    assert!(m.profile.is_empty());
    let none = measure(&RecordedMovement::default(), PERIOD, &Definitions::default());
    assert_eq!(none, Measures::default());
}

proptest! {
    /// For any positions in single precision, the measures are numbers within their ranges.
    #[test]
    fn measures_are_numbers(
        points in proptest::collection::vec(
            prop_oneof![[-2.0_f32..2.0, -2.0_f32..2.0], [proptest::num::f32::NORMAL, proptest::num::f32::ANY]],
            1..60,
        ),
        repeat in 1_usize..4,
    ) {
        let points: Vec<[f64; 2]> = points
            .into_iter()
            .map(|p| p.map(|x| if x.is_finite() { f64::from(x) } else { 0.0 }))
            .flat_map(|p| std::iter::repeat_n(p, repeat))
            .collect();
        let m = measure(&movement(points), PERIOD, &Definitions::default());
        for x in [
            m.onset_s, m.duration_s, m.peak_speed, m.mean_speed, m.peak_to_mean, m.peak_position, m.symmetry, m.peaks,
            m.straightness, m.deviation, m.settled_s, m.settled_share_s, m.end_error_m,
        ] {
            prop_assert!(x.is_none_or(f64::is_finite), "{:?}", m);
        }
        prop_assert!(m.profile.iter().all(|x| x.is_finite()), "{:?}", m);
        prop_assert!(m.straightness.is_none_or(|s| s > 0.999_999), "{:?}", m);
        prop_assert!(m.symmetry.is_none_or(|s| (-1e-9..=1.0).contains(&s)), "{:?}", m);
        prop_assert!(m.peak_to_mean.is_none_or(|r| r > 0.999_999), "{:?}", m);
        prop_assert!(m.duration_s.is_none() == m.profile.is_empty());
    }
}

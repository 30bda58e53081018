//! Motion of a servo's shaft towards a speed or a position, with limited speed and acceleration. It is computed
//! in closed form where possible, and in steps of a millisecond otherwise (towards a position with limited
//! acceleration).
//!
//! There is no mass and no gravity: without torque a shaft does not move.

/// Longest step of a stepped motion, s.
const STEP_S: f64 = 0.001;

/// The goal of the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotorGoal {
    /// No motion: no torque, or held fixed. The shaft stops at once.
    Rest,
    /// A speed, steps/s.
    Speed(f64),
    /// A position, with limited speed.
    Position {
        /// The position, steps.
        at: f64,
        /// Greatest speed, steps/s; may be infinite.
        speed: f64,
    },
}

/// Position and speed of a shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    /// Position, steps, counted over turns.
    pub at: f64,
    /// Speed, steps/s.
    pub speed: f64,
}

impl Shaft {
    /// Advances by `seconds` towards `goal`, with an acceleration of at most `acceleration` steps/s^2, which
    /// may be infinite.
    pub fn advance(&mut self, goal: MotorGoal, acceleration: f64, seconds: f64) {
        if seconds <= 0.0 {
            return;
        }
        match goal {
            MotorGoal::Rest => self.speed = 0.0,
            MotorGoal::Speed(speed) => self.towards_speed(speed, acceleration, seconds),
            MotorGoal::Position { at, speed } if acceleration.is_infinite() => {
                let distance = at - self.at;
                let reach = speed * seconds;
                if distance.abs() <= reach {
                    (self.at, self.speed) = (at, 0.0);
                } else {
                    self.speed = speed.copysign(distance);
                    self.at += reach.copysign(distance);
                }
            }
            MotorGoal::Position { at, .. } if self.at == at && self.speed == 0.0 => {}
            MotorGoal::Position { at, speed } => {
                let steps = (seconds / STEP_S).ceil().max(1.0);
                let h = seconds / steps;
                for _ in 0..steps as u64 {
                    self.step(at, speed, acceleration, h);
                }
            }
        }
    }

    fn towards_speed(&mut self, goal: f64, acceleration: f64, seconds: f64) {
        let change = goal - self.speed;
        let ramp = if acceleration.is_infinite() { 0.0 } else { (change.abs() / acceleration).min(seconds) };
        let reached = if ramp < seconds { goal } else { self.speed + acceleration.copysign(change) * ramp };
        self.at += 0.5 * (self.speed + reached) * ramp + reached * (seconds - ramp);
        self.speed = reached;
    }

    /// One short step towards a position, at a speed from which the shaft can stop there.
    fn step(&mut self, goal: f64, max_speed: f64, acceleration: f64, h: f64) {
        let distance = goal - self.at;
        // The correction by half a step makes braking in whole steps exact.
        let half = 0.5 * acceleration * h;
        let stoppable = (half * half + 2.0 * acceleration * distance.abs()).sqrt() - half;
        let wanted = stoppable.min(max_speed).min(distance.abs() / h).copysign(distance);
        let change = (wanted - self.speed).clamp(-acceleration * h, acceleration * h);
        self.speed += change;
        self.at += self.speed * h;
        if (goal - self.at).abs() < 0.01 && self.speed.abs() <= acceleration * h {
            (self.at, self.speed) = (goal, 0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_speed_is_reached_with_the_acceleration_and_kept() {
        let mut shaft = Shaft { at: 0.0, speed: 0.0 };
        shaft.advance(MotorGoal::Speed(100.0), 200.0, 1.0);
        assert_eq!(shaft, Shaft { at: 75.0, speed: 100.0 });
        shaft.advance(MotorGoal::Speed(-100.0), f64::INFINITY, 1.0);
        assert_eq!(shaft, Shaft { at: -25.0, speed: -100.0 });
        shaft.advance(MotorGoal::Rest, 200.0, 1.0);
        assert_eq!(shaft, Shaft { at: -25.0, speed: 0.0 });
    }

    proptest! {
        #[test]
        fn a_position_is_reached_and_not_overshot_by_much(goal in -4000.0_f64..4000.0, acceleration in 100.0_f64..1e5) {
            let mut shaft = Shaft { at: 0.0, speed: 0.0 };
            let mut farthest: f64 = 0.0;
            for _ in 0..2000 {
                shaft.advance(MotorGoal::Position { at: goal, speed: 2000.0 }, acceleration, 0.01);
                farthest = farthest.max(shaft.at * goal.signum());
                prop_assert!(shaft.speed.abs() <= 2000.0 + 1e-6);
            }
            prop_assert!((shaft.at - goal).abs() < 0.5, "{shaft:?}");
            prop_assert!(farthest <= goal.abs() + 0.5 + acceleration * 1e-5, "{farthest}");
        }

        #[test]
        fn speed_goals_do_not_depend_on_how_time_is_split(goal in -5000.0_f64..5000.0, cut in 0.001_f64..0.999) {
            let start = Shaft { at: 3.0, speed: 250.0 };
            let (mut whole, mut parts) = (start, start);
            whole.advance(MotorGoal::Speed(goal), 3000.0, 1.0);
            parts.advance(MotorGoal::Speed(goal), 3000.0, cut);
            parts.advance(MotorGoal::Speed(goal), 3000.0, 1.0 - cut);
            prop_assert!((whole.at - parts.at).abs() < 1e-6);
        }
    }
}

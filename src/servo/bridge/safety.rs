//! When torque may be on: a state machine, independent of bus and clock.
//!
//! ```text
//! read-only --arm--> ready --command--> driving --cause--> tripped
//! ```
//!
//! Torque is on only in the state *driving*. The causes that turn it off, and the conditions under which it
//! returns:
//!
//! | Cause | Torque goes off | Torque returns |
//! |---|---|---|
//! | bus lost | after `lost_after` ticks without answer | after [`RECOVERY`] ticks with all answers, and checks |
//! | leader lost | after `lost_after` ticks without answer, at once when its port is gone | likewise |
//! | cable out, machine or bridge stood still | at once | after [`RECOVERY`] ticks with all answers, and checks |
//! | no commands | after the gate's hold and decay | with the next command and the gate's ramp |
//! | overload, heat, voltage, torque lost, guard lost | in the tick that reports it | after it is armed again |
//! | a servo of the leader reports an error | in that tick | likewise |
//!
//! With `rearm = "by-hand"` torque returns after the causes of the first three rows only when it is armed again.
//!
//! From the first tick without an answer on, and while nothing is seen, the arm holds its position.

use std::fmt;

use crate::wire::flag;

/// Number of consecutive ticks in which all servos must answer before a lost bus counts as recovered.
pub const RECOVERY: u32 = 20;

/// The cause for which torque went off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TripCause {
    /// No valid answers.
    BusLost,
    /// A servo reports an overload.
    Overload,
    /// A servo is too hot.
    Heat,
    /// A servo's voltage is outside its limits.
    Voltage,
    /// A servo has no torque although it was not turned off: it has restarted, or reports an unknown error.
    TorqueLost,
    /// The port is gone: its cable was pulled out.
    Unplugged,
    /// The machine was asleep.
    Suspended,
    /// The bridge stood still for several periods.
    Stalled,
    /// The guard process has died.
    Unguarded,
    /// No commands arrive.
    CommandsAway,
    /// The checks before torque failed.
    Refused,
    /// No valid answers of the leader.
    LeaderLost,
    /// A servo of the leader reports an error.
    LeaderFault,
}

impl TripCause {
    /// Whether the connection was lost, and torque can return when it is back and all checks pass.
    pub fn is_loss(self) -> bool {
        matches!(self, Self::BusLost | Self::Unplugged | Self::Suspended | Self::Stalled | Self::LeaderLost)
    }

    /// Whether the servos may still have torque, because they cannot be told to turn it off, or cannot confirm it.
    pub fn leaves_torque_unknown(self) -> bool {
        matches!(self, Self::BusLost | Self::Unplugged)
    }
}

impl fmt::Display for TripCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::BusLost => "the bus is lost",
            Self::Overload => "a servo is overloaded",
            Self::Heat => "a servo is too hot",
            Self::Voltage => "a servo's voltage is too low or too high",
            Self::TorqueLost => "a servo has lost its torque",
            Self::Unplugged => "the port is gone; its cable is out",
            Self::Suspended => "the machine was asleep",
            Self::Stalled => "the bridge stood still for several ticks",
            Self::Unguarded => "the guard process has died",
            Self::CommandsAway => "commands stay away",
            Self::Refused => "the checks before torque failed",
            Self::LeaderLost => "the leader is lost",
            Self::LeaderFault => "a servo of the leader reports an error",
        })
    }
}

/// States of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SafetyState {
    /// Not armed.
    ReadOnly,
    /// Armed; torque goes on with the first command.
    Ready,
    /// Torque is on.
    Driving,
    /// Torque is off.
    Tripped(TripCause),
}

/// What the bridge does with the motors in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveCommand {
    /// Torque off.
    Off,
    /// Hold the position, with torque.
    Hold,
    /// Turn torque on, then follow the command.
    Start,
    /// Follow the command.
    Follow,
}

/// The state machine that decides when torque may be on.
#[derive(Debug, Clone)]
pub struct SafetyMachine {
    state: SafetyState,
    lost_after: u32,
    /// Whether torque returns by itself after a loss.
    automatic: bool,
    /// Consecutive ticks without answers of all servos.
    missed: u32,
    /// Consecutive ticks with answers of all servos.
    answered: u32,
}

impl SafetyMachine {
    /// A machine that is not armed. The bus counts as lost after `lost_after` ticks without an answer. Torque
    /// returns after a loss by itself if `automatic`.
    pub fn new(lost_after: u32, automatic: bool) -> Self {
        Self { state: SafetyState::ReadOnly, lost_after, automatic, missed: 0, answered: 0 }
    }

    /// Whether torque returns without arming when this cause ends.
    pub fn recovers(&self, cause: TripCause) -> bool {
        cause == TripCause::CommandsAway || self.automatic && cause.is_loss()
    }

    /// The current state.
    pub fn state(&self) -> SafetyState {
        self.state
    }

    /// Arms it, after the checks.
    pub fn arm(&mut self) {
        if self.state != SafetyState::Driving {
            self.state = SafetyState::Ready;
        }
    }

    /// Turns torque off for this cause. A cause that needs arming replaces one that recovers, not the other way
    /// round.
    pub fn trip(&mut self, cause: TripCause) {
        let kept = matches!(self.state, SafetyState::Tripped(before) if !self.recovers(before) && self.recovers(cause));
        if cause.is_loss() {
            self.answered = 0;
        }
        if self.state != SafetyState::ReadOnly && !kept {
            self.state = SafetyState::Tripped(cause);
        }
    }

    /// Takes the result of a tick's read: `None` without valid answers, otherwise whether all servos are healthy.
    pub fn read_result(&mut self, health: Option<Result<(), TripCause>>) {
        match health {
            None => {
                (self.answered, self.missed) = (0, self.missed.saturating_add(1));
                if self.missed >= self.lost_after && matches!(self.state, SafetyState::Ready | SafetyState::Driving) {
                    self.trip(TripCause::BusLost);
                }
            }
            Some(Err(cause)) => {
                (self.answered, self.missed) = (0, 0);
                // A cause that needs arming replaces one that recovers, not the other way round.
                if !matches!(self.state, SafetyState::Tripped(before) if !self.recovers(before)) {
                    self.trip(cause);
                }
            }
            Some(Ok(())) => {
                (self.answered, self.missed) = (self.answered.saturating_add(1), 0);
                let recovers = |cause: TripCause| cause.is_loss() && self.automatic;
                if matches!(self.state, SafetyState::Tripped(cause) if recovers(cause)) && self.answered >= RECOVERY {
                    self.state = SafetyState::Ready;
                }
            }
        }
    }

    /// Decides about the command of a tick with the gate's `flags`. Without vision (`sees` is false) the arm
    /// holds its position, and torque does not come on.
    pub fn command(&mut self, flags: u32, sees: bool) -> DriveCommand {
        let arrived = flags & flag::MISSED == 0;
        if self.state == SafetyState::Driving && flags & flag::STOPPED != 0 {
            self.trip(TripCause::CommandsAway);
        }
        match self.state {
            SafetyState::Driving if self.missed > 0 || !sees => DriveCommand::Hold,
            SafetyState::Driving => DriveCommand::Follow,
            SafetyState::Ready | SafetyState::Tripped(TripCause::CommandsAway)
                if arrived && sees && self.missed == 0 =>
            {
                self.state = SafetyState::Driving;
                DriveCommand::Start
            }
            _ => DriveCommand::Off,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_COMMAND: u32 = flag::MISSED | flag::STOPPED;

    #[test]
    fn torque_is_on_only_after_arming_and_a_command() {
        let mut safety = SafetyMachine::new(3, true);
        for _ in 0..10 {
            safety.read_result(Some(Ok(())));
            assert_eq!(safety.command(0, true), DriveCommand::Off);
        }
        safety.arm();
        assert_eq!(safety.command(flag::MISSED | flag::HELD, true), DriveCommand::Off);
        assert_eq!(safety.command(0, true), DriveCommand::Start);
        assert_eq!(safety.command(0, true), DriveCommand::Follow);
    }

    #[test]
    fn a_servo_error_turns_torque_off_until_it_is_armed_again() {
        for cause in [TripCause::Overload, TripCause::Heat, TripCause::Voltage, TripCause::TorqueLost] {
            let mut safety = SafetyMachine::new(3, true);
            safety.arm();
            assert_eq!(safety.command(0, true), DriveCommand::Start);
            safety.read_result(Some(Err(cause)));
            for _ in 0..100 {
                assert_eq!(safety.command(0, true), DriveCommand::Off);
                safety.read_result(Some(Ok(())));
            }
            assert_eq!(safety.state(), SafetyState::Tripped(cause));
            safety.arm();
            assert_eq!(safety.command(0, true), DriveCommand::Start);
        }
    }

    #[test]
    fn a_lost_bus_holds_then_turns_torque_off_and_recovers() {
        let mut safety = SafetyMachine::new(3, true);
        safety.arm();
        safety.command(0, true);
        for drive in [DriveCommand::Hold, DriveCommand::Hold, DriveCommand::Off, DriveCommand::Off] {
            safety.read_result(None);
            assert_eq!(safety.command(0, true), drive);
        }
        for _ in 1..RECOVERY {
            safety.read_result(Some(Ok(())));
            assert_eq!(safety.command(0, true), DriveCommand::Off);
        }
        safety.read_result(Some(Ok(())));
        assert_eq!(safety.command(0, true), DriveCommand::Start);
    }

    #[test]
    fn by_hand_a_loss_needs_arming() {
        for cause in [TripCause::BusLost, TripCause::Unplugged, TripCause::Suspended, TripCause::Stalled] {
            for automatic in [true, false] {
                let mut safety = SafetyMachine::new(3, automatic);
                safety.arm();
                safety.command(0, true);
                safety.trip(cause);
                for _ in 0..RECOVERY {
                    assert_eq!(safety.command(0, true), DriveCommand::Off);
                    safety.read_result(Some(Ok(())));
                }
                let expected = if automatic { DriveCommand::Start } else { DriveCommand::Off };
                assert_eq!(safety.command(0, true), expected, "{cause}");
            }
        }
    }

    #[test]
    fn missing_commands_turn_torque_off_until_the_next_one() {
        let mut safety = SafetyMachine::new(3, true);
        safety.arm();
        safety.command(0, true);
        assert_eq!(safety.command(flag::MISSED | flag::DECAYED, true), DriveCommand::Follow);
        assert_eq!(safety.command(NO_COMMAND, true), DriveCommand::Off);
        assert_eq!(safety.command(NO_COMMAND, true), DriveCommand::Off);
        assert_eq!(safety.command(0, true), DriveCommand::Start);
    }

    #[test]
    fn without_vision_the_arm_holds_and_gets_no_torque() {
        let mut safety = SafetyMachine::new(3, true);
        safety.arm();
        assert_eq!(safety.command(0, false), DriveCommand::Off);
        assert_eq!(safety.state(), SafetyState::Ready);
        assert_eq!(safety.command(0, true), DriveCommand::Start);
        assert_eq!(safety.command(0, false), DriveCommand::Hold);
        assert_eq!(safety.state(), SafetyState::Driving, "torque stays on");
        assert_eq!(safety.command(0, true), DriveCommand::Follow);
        // Missing commands turn torque off also without vision.
        assert_eq!(safety.command(NO_COMMAND, false), DriveCommand::Off);
    }
}

//! When torque may be on: a state machine without bus and clock.
//!
//! ```text
//! read-only --arm--> ready --command--> driving --cause--> tripped
//! ```
//!
//! Torque is on in *driving* alone. What ends it by itself, and what takes it up again:
//!
//! | Cause | Torque is off | Goes on |
//! |---|---|---|
//! | the bus is lost | after `lost_after` ticks without an answer; from the first on the arm is told to stand still | by itself, after [`RECOVERY`] ticks in which all answered, and the checks of arming |
//! | commands stay away | when the gate's hold and decay are over | by itself, with the next command and the gate's ramp |
//! | overload, heat, voltage, torque lost | in the tick that says so | when it is armed again |

use std::fmt;

use crate::wire::flag;

/// Ticks in a row in which all servos have to answer before a bus that was lost counts as found.
pub const RECOVERY: u32 = 20;

/// Why torque went off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TripCause {
    /// No proper answers any more.
    BusLost,
    /// A servo says that its load is more than it can carry.
    Overload,
    /// A servo is too hot.
    Heat,
    /// A servo's voltage is outside its limits.
    Voltage,
    /// A servo has no torque, and nobody turned it off: it has started anew, or says an error that this program
    /// does not know.
    TorqueLost,
    /// Commands stay away.
    CommandsAway,
    /// The checks before torque failed when it was to go on again.
    Refused,
}

impl TripCause {
    /// Whether the arm goes on by itself when the cause is gone.
    pub fn passes(self) -> bool {
        matches!(self, Self::BusLost | Self::CommandsAway)
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
            Self::CommandsAway => "commands stay away",
            Self::Refused => "the checks before torque failed",
        })
    }
}

/// Where the machine stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SafetyState {
    /// Nobody has armed it.
    ReadOnly,
    /// Armed; torque goes on with the first command.
    Ready,
    /// Torque is on.
    Driving,
    /// Torque is off.
    Tripped(TripCause),
}

/// What the body does in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveCommand {
    /// Nothing: torque is off, or goes off now.
    Off,
    /// Stand still, with torque.
    Still,
    /// Turn torque on, then follow the command.
    Rise,
    /// Follow the command.
    Go,
}

/// The machine.
#[derive(Debug, Clone)]
pub struct SafetyMachine {
    state: SafetyState,
    lost_after: u32,
    /// Ticks in a row without, and with, an answer of all.
    missed: u32,
    heard: u32,
}

impl SafetyMachine {
    /// Read-only; the bus counts as lost after so many ticks without an answer.
    pub fn new(lost_after: u32) -> Self {
        Self { state: SafetyState::ReadOnly, lost_after, missed: 0, heard: 0 }
    }

    /// Where it stands.
    pub fn state(&self) -> SafetyState {
        self.state
    }

    /// Somebody arms it, after the checks.
    pub fn arm(&mut self) {
        if self.state != SafetyState::Driving {
            self.state = SafetyState::Ready;
        }
    }

    /// Torque goes off now.
    pub fn trip(&mut self, cause: TripCause) {
        if self.state != SafetyState::ReadOnly {
            self.state = SafetyState::Tripped(cause);
        }
    }

    /// What the bus said in this tick: nothing proper, or that all is well, or what is not.
    pub fn hear(&mut self, heard: Option<Result<(), TripCause>>) {
        match heard {
            None => {
                (self.heard, self.missed) = (0, self.missed.saturating_add(1));
                if self.missed >= self.lost_after && matches!(self.state, SafetyState::Ready | SafetyState::Driving) {
                    self.trip(TripCause::BusLost);
                }
            }
            Some(Err(cause)) => {
                (self.heard, self.missed) = (0, 0);
                // What passes by itself gives way to what does not.
                if !matches!(self.state, SafetyState::Tripped(before) if !before.passes()) {
                    self.trip(cause);
                }
            }
            Some(Ok(())) => {
                (self.heard, self.missed) = (self.heard.saturating_add(1), 0);
                if self.state == SafetyState::Tripped(TripCause::BusLost) && self.heard >= RECOVERY {
                    self.state = SafetyState::Ready;
                }
            }
        }
    }

    /// What to do with the command of a tick, of which the gate says `flags`. An arm that does not see (`sees`)
    /// stands still, and torque does not come on before it does.
    pub fn command(&mut self, flags: u32, sees: bool) -> DriveCommand {
        let came = flags & flag::MISSED == 0;
        if self.state == SafetyState::Driving && flags & flag::STOPPED != 0 {
            self.trip(TripCause::CommandsAway);
        }
        match self.state {
            SafetyState::Driving if self.missed > 0 || !sees => DriveCommand::Still,
            SafetyState::Driving => DriveCommand::Go,
            SafetyState::Ready | SafetyState::Tripped(TripCause::CommandsAway) if came && sees && self.missed == 0 => {
                self.state = SafetyState::Driving;
                DriveCommand::Rise
            }
            _ => DriveCommand::Off,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AWAY: u32 = flag::MISSED | flag::STOPPED;

    #[test]
    fn torque_is_on_only_after_arming_and_a_command() {
        let mut safety = SafetyMachine::new(3);
        for _ in 0..10 {
            safety.hear(Some(Ok(())));
            assert_eq!(safety.command(0, true), DriveCommand::Off);
        }
        safety.arm();
        assert_eq!(safety.command(flag::MISSED | flag::HELD, true), DriveCommand::Off);
        assert_eq!(safety.command(0, true), DriveCommand::Rise);
        assert_eq!(safety.command(0, true), DriveCommand::Go);
    }

    #[test]
    fn each_cause_turns_it_off_and_passes_or_does_not() {
        for cause in [TripCause::Overload, TripCause::Heat, TripCause::Voltage, TripCause::TorqueLost] {
            let mut safety = SafetyMachine::new(3);
            safety.arm();
            assert_eq!(safety.command(0, true), DriveCommand::Rise);
            safety.hear(Some(Err(cause)));
            for _ in 0..100 {
                assert_eq!(safety.command(0, true), DriveCommand::Off);
                safety.hear(Some(Ok(())));
            }
            assert_eq!(safety.state(), SafetyState::Tripped(cause));
            safety.arm();
            assert_eq!(safety.command(0, true), DriveCommand::Rise);
        }
    }

    #[test]
    fn a_bus_that_is_lost_stands_still_then_off_and_comes_back() {
        let mut safety = SafetyMachine::new(3);
        safety.arm();
        safety.command(0, true);
        for drive in [DriveCommand::Still, DriveCommand::Still, DriveCommand::Off, DriveCommand::Off] {
            safety.hear(None);
            assert_eq!(safety.command(0, true), drive);
        }
        for _ in 1..RECOVERY {
            safety.hear(Some(Ok(())));
            assert_eq!(safety.command(0, true), DriveCommand::Off);
        }
        safety.hear(Some(Ok(())));
        assert_eq!(safety.command(0, true), DriveCommand::Rise);
    }

    #[test]
    fn commands_that_stay_away_and_come_back() {
        let mut safety = SafetyMachine::new(3);
        safety.arm();
        safety.command(0, true);
        assert_eq!(safety.command(flag::MISSED | flag::DECAYED, true), DriveCommand::Go);
        assert_eq!(safety.command(AWAY, true), DriveCommand::Off);
        assert_eq!(safety.command(AWAY, true), DriveCommand::Off);
        assert_eq!(safety.command(0, true), DriveCommand::Rise);
    }

    #[test]
    fn who_does_not_see_stands_still_and_gets_no_torque() {
        let mut safety = SafetyMachine::new(3);
        safety.arm();
        assert_eq!(safety.command(0, false), DriveCommand::Off);
        assert_eq!(safety.state(), SafetyState::Ready);
        assert_eq!(safety.command(0, true), DriveCommand::Rise);
        assert_eq!(safety.command(0, false), DriveCommand::Still);
        assert_eq!(safety.state(), SafetyState::Driving, "torque stays on");
        assert_eq!(safety.command(0, true), DriveCommand::Go);
        // Commands that stay away end it all the same.
        assert_eq!(safety.command(AWAY, false), DriveCommand::Off);
    }
}

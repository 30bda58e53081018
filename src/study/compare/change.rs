//! Changes of the arm during a run: as `--change` writes them, as the reports name them, and as the scenario
//! stores them.

use std::fmt;
use std::str::FromStr;

use crate::scenario::{ArmConfig, BlockConfig, MirrorAxis, MirrorConfig, ShortenConfig};

/// One change of the arm, and its tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmChange {
    /// The change.
    pub what: ArmChangeKind,
    /// First tick with the change.
    pub tick: u64,
}

/// The kinds of changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ArmChangeKind {
    /// A joint, counted from 1, stands still at an angle, rad.
    Block(usize, f64),
    /// A segment, counted from 1, has another length, m.
    Shorten(usize, f64),
    /// A coordinate of the target is reported with the other sign.
    Mirror(MirrorAxis),
}

/// The forms of `--change`, for error messages.
const FORMS: &str =
    "write block:JOINT@TICK, block:JOINT:ANGLE@TICK, shorten:SEGMENT:LENGTH@TICK, mirror:x@TICK or mirror:y@TICK";

impl ArmChange {
    /// Joint 3 blocked at angle 0, as in the paper.
    pub fn block(tick: u64) -> Self {
        Self { what: ArmChangeKind::Block(3, 0.0), tick }
    }

    /// The change as on the command line.
    pub(super) fn form(&self) -> String {
        let what = match self.what {
            ArmChangeKind::Block(joint, angle) => format!("block:{joint}:{angle}"),
            ArmChangeKind::Shorten(segment, length) => format!("shorten:{segment}:{length}"),
            ArmChangeKind::Mirror(MirrorAxis::X) => "mirror:x".to_owned(),
            ArmChangeKind::Mirror(MirrorAxis::Y) => "mirror:y".to_owned(),
        };
        format!("{what}@{}", self.tick)
    }

    /// Adds the change to the settings of an arm.
    pub(super) fn apply(&self, arm: &mut ArmConfig) {
        let tick = self.tick;
        match self.what {
            ArmChangeKind::Block(joint, angle) => arm.block.push(BlockConfig { joint, tick, angle }),
            ArmChangeKind::Shorten(segment, length) => arm.shorten.push(ShortenConfig { segment, tick, length }),
            ArmChangeKind::Mirror(axis) => arm.mirror.push(MirrorConfig { axis, tick }),
        }
    }
}

impl FromStr for ArmChange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (what, tick) = text.split_once('@').ok_or(FORMS)?;
        let tick = number(tick, "tick")?;
        let words: Vec<&str> = what.split(':').collect();
        let what = match words[..] {
            ["block", joint] => ArmChangeKind::Block(number(joint, "joint")?, 0.0),
            ["block", joint, angle] => ArmChangeKind::Block(number(joint, "joint")?, number(angle, "angle")?),
            ["shorten", segment, length] => {
                ArmChangeKind::Shorten(number(segment, "segment")?, number(length, "length")?)
            }
            ["mirror", "x"] => ArmChangeKind::Mirror(MirrorAxis::X),
            ["mirror", "y"] => ArmChangeKind::Mirror(MirrorAxis::Y),
            _ => return Err(FORMS.to_owned()),
        };
        Ok(Self { what, tick })
    }
}

fn number<T: FromStr>(text: &str, what: &str) -> Result<T, String> {
    text.replace('_', "").parse().map_err(|_| format!("the {what} is no such number; {FORMS}"))
}

impl fmt::Display for ArmChangeKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Block(joint, 0.0) => write!(f, "joint {joint} blocked"),
            Self::Block(joint, angle) => write!(f, "joint {joint} blocked at {angle} rad"),
            Self::Shorten(segment, length) => write!(f, "segment {segment} {length} m long"),
            Self::Mirror(MirrorAxis::X) => f.write_str("camera mirrored in x"),
            Self::Mirror(MirrorAxis::Y) => f.write_str("camera mirrored in y"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_parsed_in_all_forms() {
        for (text, what, tick) in [
            ("block:3@3000", ArmChangeKind::Block(3, 0.0), 3000),
            ("block:1:-0.5@6_000", ArmChangeKind::Block(1, -0.5), 6000),
            ("shorten:2:0.3@9000", ArmChangeKind::Shorten(2, 0.3), 9000),
            ("mirror:y@1", ArmChangeKind::Mirror(MirrorAxis::Y), 1),
        ] {
            assert_eq!(text.parse(), Ok(ArmChange { what, tick }), "{text}");
        }
        for text in
            ["", "block", "block@3", "block:3", "block:x@3", "block:3@", "mirror:z@3", "shorten:2@5", "melt:1@5"]
        {
            let message = text.parse::<ArmChange>().unwrap_err();
            assert!(message.contains("write block:JOINT@TICK"), "{text}: {message}");
        }
    }
}

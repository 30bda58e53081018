//! `tectum-follower`: the controller of `tectum-bridge teleop`, which takes each joint to the leader's angle.

use std::process::ExitCode;

use tectum::process::controller_main;
use tectum::servo::follower::FollowerAgent;

fn main() -> ExitCode {
    controller_main(&[("follower", |plan| Ok(Box::new(FollowerAgent::new(plan)?)))])
}

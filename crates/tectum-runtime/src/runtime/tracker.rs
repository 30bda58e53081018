//! The tracker's side of a run. A tracker is a program that measures the positions of target and end-effector,
//! for example with a camera, and publishes them on the channel `vision`.
//!
//! The launcher neither starts nor supervises a tracker. It may join late, leave, or be killed, and another
//! tracker may replace it. It can also receive the plant's observations, like a viewer.

use std::path::Path;

use super::{RunManifest, RuntimeError, identity};
use crate::channel::TrackerPorts;
use crate::clock::{ProcessHandle, monotonic_ns};
use crate::scenario::{Plan, Scenario};
use crate::wire::{Header, Observation, Phase, Vision};

/// A tracker that has joined a run.
pub struct Tracker {
    /// The run's validated scenario.
    pub plan: Plan,
    ports: TrackerPorts,
    launcher: ProcessHandle,
    header: Header,
}

impl Tracker {
    /// Joins the run called `run` (a folder, or a name under `runs/`).
    ///
    /// # Errors
    /// [`RuntimeError::NoRun`] when there is no such run, it has ended, or its scenario has no `sight =
    /// "vision"`. [`RuntimeError::Channel`] when a service is missing, belongs to another run, or has no place
    /// for another tracker. [`RuntimeError::Scenario`] when the run's copy of its scenario cannot be read.
    pub fn join(run: &Path) -> Result<Self, RuntimeError> {
        let (folder, manifest, launcher) = RunManifest::find(run)?;
        let plan = Scenario::load(&RunManifest::scenario_path(&folder))?.plan()?;
        if plan.scenario.vision().is_none() {
            let cause = "its scenario has no plant.servos.sight = \"vision\"".to_owned();
            return Err(RuntimeError::NoRun { path: folder.display().to_string(), cause });
        }
        let ports = TrackerPorts::open(&manifest.domain, &identity(&plan), &plan.scenario.channels)?;
        let header = Header { run: manifest.run_id(), ..Header::default() };
        Ok(Self { plan, ports, launcher, header })
    }

    /// Publishes the positions of target and end-effector, m, as they were at `sensed_ns` on CLOCK_MONOTONIC,
    /// the instant of the picture. Never waits.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn publish(&mut self, sensed_ns: u64, target: [f32; 2], end: [f32; 2]) -> Result<(), RuntimeError> {
        (self.header.sensed_ns, self.header.published_ns) = (sensed_ns, monotonic_ns());
        self.ports.vision.send(&Vision { header: self.header, target, end })?;
        self.header.sequence += 1;
        Ok(())
    }

    /// The plant's newest observation since the last call, if there is one.
    ///
    /// # Errors
    /// When shared memory fails.
    pub fn observation(&self) -> Result<Option<Observation>, RuntimeError> {
        let mut newest = None;
        while let Some(observation) = self.ports.observation.receive()? {
            newest = Some(observation);
        }
        Ok(newest)
    }

    /// Whether the run or its launcher has ended. A launcher that was killed cannot announce the end of the
    /// run.
    pub fn run_ended(&self) -> bool {
        self.ports.control.get().phase() >= Phase::Stop || self.launcher.ended()
    }
}

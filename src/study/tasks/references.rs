//! The reference controllers on a task.

use super::outcome::RunResult;
use super::plan::TaskPlan;
use super::test::{TestScore, TestView, drive};
use crate::clock::thread_cpu_ns;
use crate::plant::BodyConfig;
use crate::plant::task::Task;
use crate::policy::{Exploration, Outputs};
use crate::reference::{EnergySwingUp, IterativeLqr, LaggedModel, ResolvedRates, TrueModel, body_model};
use crate::wire::MAX_OUTPUTS;

/// The kinds of reference controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReferenceKind {
    /// All commands are 0.
    Zero,
    /// Exploration noise alone.
    Random,
    /// Moves an arm by its Jacobian.
    DampedLeastSquares,
    /// Swings a pendulum up by its energy, and balances it.
    EnergySwingUp,
    /// Plans through the true model.
    IterativeLqr,
}

impl ReferenceKind {
    /// All of them, from the one that knows least to the one that knows most.
    pub const ALL: [Self; 5] =
        [Self::Zero, Self::Random, Self::DampedLeastSquares, Self::EnergySwingUp, Self::IterativeLqr];

    /// The name by which it is chosen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Zero => "zero",
            Self::Random => "random",
            Self::DampedLeastSquares => "damped-least-squares",
            Self::EnergySwingUp => "energy-swing-up",
            Self::IterativeLqr => "ilqr",
        }
    }

    /// Whether it can control the plant of `task`.
    pub(super) fn serves(self, task: &Task) -> bool {
        match self {
            Self::Zero | Self::Random | Self::IterativeLqr => true,
            Self::DampedLeastSquares => matches!(task.body, BodyConfig::Arm(_) | BodyConfig::So101(_)),
            Self::EnergySwingUp => {
                matches!(task.body, BodyConfig::Pendulum(_) | BodyConfig::CartPole(_) | BodyConfig::Furuta(_))
            }
        }
    }
}

/// Ticks of a plan, by body: long enough for the movement that the task needs.
fn horizon(body: &BodyConfig) -> usize {
    match body {
        BodyConfig::Arm(_) | BodyConfig::So101(_) | BodyConfig::Eye(_) => 20,
        BodyConfig::Reacher(_) | BodyConfig::PointMass(_) => 30,
        BodyConfig::Pendulum(_) | BodyConfig::Furuta(_) => 40,
        BodyConfig::CartPole(_) => 50,
    }
}

/// A controller of one of the kinds.
enum Reference {
    Zero,
    Random(Box<Exploration>),
    DampedLeastSquares(Box<ResolvedRates>),
    EnergySwingUp(EnergySwingUp),
    IterativeLqr(Box<Planned>),
}

/// iLQR, and the lagged commands that it has to know.
struct Planned {
    controller: IterativeLqr,
    /// Number of the model's numbers that come before the lagged commands; `None` without a lag.
    lagged_from: Option<usize>,
    commands: usize,
    /// Share of a command's change that is left after a tick.
    left: f64,
    reached: [f64; MAX_OUTPUTS],
}

impl Reference {
    fn new(kind: ReferenceKind, task: &Task, tick: u64, outputs: usize) -> Option<Self> {
        Some(match kind {
            ReferenceKind::Zero => Self::Zero,
            ReferenceKind::Random => Self::Random(Box::new(Exploration::new(1, task.sigma as f32, outputs))),
            ReferenceKind::DampedLeastSquares => Self::DampedLeastSquares(Box::new(ResolvedRates::new(task, tick)?)),
            ReferenceKind::EnergySwingUp => {
                Self::EnergySwingUp(EnergySwingUp::new(&task.body, &body_model(task, tick)?, task.max_command)?)
            }
            ReferenceKind::IterativeLqr => Self::IterativeLqr(Box::new(Planned::new(task, tick)?)),
        })
    }

    fn command(&mut self, view: &TestView) -> Outputs {
        match self {
            Self::Zero => Outputs::default(),
            Self::Random(noise) => noise.draw(),
            Self::DampedLeastSquares(controller) => controller.command(view.state),
            Self::EnergySwingUp(controller) => controller.command(view.state),
            Self::IterativeLqr(planned) => planned.command(view),
        }
    }
}

impl Planned {
    fn new(task: &Task, tick: u64) -> Option<Self> {
        let body = body_model(task, tick)?;
        let (dynamic, commands) = (body.dynamic_states(), body.commands());
        let lag_ms = task.timing.lag_ms;
        let is_lagged = lag_ms > 0.0;
        let model: TrueModel = if is_lagged { Box::new(LaggedModel::new(body, lag_ms, task.period_ms)) } else { body };
        Some(Self {
            controller: IterativeLqr::new(model, task.max_command, horizon(&task.body), 1),
            lagged_from: is_lagged.then_some(dynamic),
            commands,
            left: if is_lagged { libm::exp(-task.period_ms / lag_ms) } else { 0.0 },
            reached: [0.0; MAX_OUTPUTS],
        })
    }

    fn command(&mut self, view: &TestView) -> Outputs {
        let mut state = view.state.to_vec();
        if let Some(from) = self.lagged_from {
            state.splice(from..from, self.reached[..self.commands].iter().copied());
        }
        let command = self.controller.command(&state, view.fresh);
        for (reached, command) in self.reached.iter_mut().zip(command) {
            *reached = f64::from(command) + self.left * (*reached - f64::from(command));
        }
        command
    }
}

/// Measures a reference controller on a task, before and after the change.
pub(super) fn run(kind: ReferenceKind, task: &TaskPlan, go_on: &dyn Fn(u64) -> bool) -> Option<RunResult> {
    let outputs = task.plan().outputs.len();
    let mut scores: Vec<TestScore> = Vec::new();
    let began = thread_cpu_ns();
    for changed in [false, true].into_iter().take(task.conditions()) {
        let mut reference = Reference::new(kind, &task.task, task.test_begins(changed), outputs)?;
        scores.push(drive(task, changed, true, |view| reference.command(view), &|| go_on(1))?);
    }
    let ticks = task.test_ticks() * scores.len() as u64;
    let ms_per_tick = (thread_cpu_ns() - began) as f64 / 1e6 / ticks as f64;
    Some(RunResult::of_reference(&scores, ms_per_tick))
}

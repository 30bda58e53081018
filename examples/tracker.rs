//! A tracker without a camera, to try `sight = "vision"`: a stand-in for a program that observes the arm.
//!
//! ```text
//! cargo build --release --bins --examples
//! target/release/tectum run servo-vision --name seen & target/release/examples/tracker --run seen
//! ```
//!
//! A real tracker computes positions from a camera's pictures. This one computes them from the measured angles,
//! which it reads like any viewer, and the scenario's lengths, with a few mm of noise, as a camera has. It also
//! draws the targets. Everything else is as for a real one: join the run, and publish where target and end-effector
//! are in each picture, with the instant at which the picture was taken.

use std::path::PathBuf;
use std::process::ExitCode;
use std::thread::sleep;
use std::time::{Duration, Instant};

use clap::Parser;
use rand::RngExt as _;
use rand_distr::{Distribution as _, Normal};
use tectum::plant::posture;
use tectum::runtime::{ChannelError, RuntimeError, Tracker};
use tectum::seed::stream;

/// A stand-in for a camera: publishes target and end-effector
#[derive(Debug, Parser)]
struct Arguments {
    /// The run to observe: its folder, or its name under runs/
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Pictures a second
    #[arg(long, default_value_t = 30.0)]
    rate: f64,
    /// Standard deviation of the measured positions, m
    #[arg(long, default_value_t = 0.003)]
    noise: f64,
    /// How long to wait for the run, s
    #[arg(long, default_value_t = 10.0)]
    wait: f64,
}

fn main() -> ExitCode {
    match track(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tracker: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Joins the run as soon as it exists.
fn join(arguments: &Arguments) -> Result<Tracker, RuntimeError> {
    let until = Instant::now() + Duration::from_secs_f64(arguments.wait.clamp(0.0, 3600.0));
    loop {
        match Tracker::join(&arguments.run) {
            Err(RuntimeError::NoRun { .. } | RuntimeError::Channel(ChannelError::SetUp { .. }))
                if Instant::now() < until =>
            {
                sleep(Duration::from_millis(50));
            }
            joined => return joined,
        }
    }
}

fn track(arguments: &Arguments) -> Result<(), RuntimeError> {
    let mut tracker = join(arguments)?;
    let Some(arm) = tracker.plan.scenario.plant.arm.clone() else { return Ok(()) };
    let [low, high] = arm.arena;
    let reach: f64 = arm.lengths.iter().sum();
    let mut rng = stream(tracker.plan.scenario.seed, "tracker");
    let noise = Normal::new(0.0, arguments.noise.clamp(0.0, 1.0)).expect("a number that is not negative");
    let (mut target, mut shown) = ([0.0; 2], None);
    while !tracker.run_ended() {
        // The picture is as old as the angles in it.
        if let Some(observation) = tracker.observation()? {
            // Targets last as long as the simulator's. The observation has the current tick.
            let due = observation.header.tick / arm.target_every;
            while shown.is_none_or(|shown| shown < due) {
                target = std::array::from_fn(|_| rng.random_range(low..high));
                let [x, y] = [target[0] - arm.base[0], target[1] - arm.base[1]];
                shown = if x.hypot(y) < reach { Some(due) } else { shown };
            }
            let angles = &observation.inputs[2..2 + arm.lengths.len()];
            let end = posture(&arm, angles).last().copied().unwrap_or(arm.base);
            let mut noisy = |at: [f64; 2]| at.map(|x| (x + noise.sample(&mut rng)) as f32);
            let (target, end) = (noisy(target), noisy(end));
            tracker.publish(observation.header.sensed_ns, target, end)?;
        }
        sleep(Duration::from_secs_f64(1.0 / arguments.rate.clamp(1.0, 1000.0)));
    }
    Ok(())
}

//! `[plant.pendulum]` and its like: what the simulator simulates, and the checks of these tables. The arm's are in
//! `plant.rs`.

use super::check::{number, ticks};
use super::{PlantConfig, error::Violation, limits};
use tectum_core::plant::{BodyConfig, MAX_DELAY};

impl PlantConfig {
    /// The body that is simulated, or that serves another program as a model. `None` if the plant is another program
    /// without a model.
    pub fn body(&self) -> Option<BodyConfig> {
        self.bodies().into_iter().flatten().next().map(|(_, body)| body)
    }

    /// Each table of a body: its key, and its content where the scenario has it.
    fn bodies(&self) -> [Option<(&'static str, BodyConfig)>; 8] {
        [
            self.arm.clone().map(|table| ("plant.arm", BodyConfig::Arm(table))),
            self.eye.clone().map(|table| ("plant.eye", BodyConfig::Eye(table))),
            self.pendulum.clone().map(|table| ("plant.pendulum", BodyConfig::Pendulum(table))),
            self.cart_pole.clone().map(|table| ("plant.cart-pole", BodyConfig::CartPole(table))),
            self.reacher.clone().map(|table| ("plant.reacher", BodyConfig::Reacher(table))),
            self.furuta.clone().map(|table| ("plant.furuta", BodyConfig::Furuta(table))),
            self.point_mass.clone().map(|table| ("plant.point-mass", BodyConfig::PointMass(table))),
            self.so101.clone().map(|table| ("plant.so101", BodyConfig::So101(table))),
        ]
    }

    /// The same plant with another body.
    pub fn with_body(&self, body: BodyConfig) -> Self {
        let mut plant = Self {
            arm: None,
            eye: None,
            pendulum: None,
            cart_pole: None,
            reacher: None,
            furuta: None,
            point_mass: None,
            so101: None,
            ..self.clone()
        };
        match body {
            BodyConfig::Arm(table) => plant.arm = Some(table),
            BodyConfig::Eye(table) => plant.eye = Some(table),
            BodyConfig::Pendulum(table) => plant.pendulum = Some(table),
            BodyConfig::CartPole(table) => plant.cart_pole = Some(table),
            BodyConfig::Reacher(table) => plant.reacher = Some(table),
            BodyConfig::Furuta(table) => plant.furuta = Some(table),
            BodyConfig::PointMass(table) => plant.point_mass = Some(table),
            BodyConfig::So101(table) => plant.so101 = Some(table),
        }
        plant
    }
}

/// Checks that there is exactly one body.
pub(super) fn check_one(plant: &PlantConfig) -> Result<(), Violation> {
    let bodies = plant.bodies();
    let mut given = bodies.iter().flatten().map(|(key, _)| *key);
    match (given.next(), given.next()) {
        (None, _) => Err(Violation::new(
            "plant",
            "has nothing to simulate; add [plant.arm], [plant.eye], [plant.pendulum], [plant.cart-pole], \
             [plant.reacher], [plant.furuta], [plant.point-mass] or [plant.so101]",
        )),
        (Some(first), Some(second)) => {
            Err(Violation::new(second, format_args!("stands beside {first}; keep one of the two")))
        }
        _ => Ok(()),
    }
}

/// Checks that a program other than the simulator has no table that only the simulator reads.
pub(super) fn check_other_program(plant: &PlantConfig) -> Result<(), Violation> {
    let program = super::error::quoted(&plant.program);
    let refused = |key: &str| {
        let text = format!("belongs to tectum-simulator and plant.program is {program}; take one of the two out");
        Err(Violation::new(key, text))
    };
    // The models of arms on servos.
    let is_model = |key: &str| key == "plant.arm" || key == "plant.so101" && plant.servos.is_some();
    match plant.bodies().into_iter().flatten().find(|(key, _)| !is_model(key)) {
        Some((key, _)) => refused(key),
        None if !plant.timing.is_nothing() => refused("plant.timing"),
        None => Ok(()),
    }
}

/// Checks the tables of all bodies but the arm, and `[plant.timing]`.
pub(super) fn check(plant: &PlantConfig) -> Result<(), Violation> {
    for (key, body) in plant.bodies().into_iter().flatten() {
        let in_table = |name: &str| format!("{key}.{name}");
        match body {
            BodyConfig::Arm(_) => {}
            BodyConfig::Eye(eye) => {
                number(in_table("distortion"), eye.distortion, limits::DISTORTION, "give 0.001 to 1e6")?;
                number(in_table("spread"), eye.spread, limits::SPREAD, "give 1e-6 to 10, in retina coordinates")?;
                number(in_table("bonus"), eye.bonus, -limits::BONUS..=limits::BONUS, "give -1000 to 1000")?;
            }
            BodyConfig::Pendulum(table) => ticks(in_table("episode_ticks"), table.episode_ticks, 0)?,
            BodyConfig::CartPole(table) => ticks(in_table("episode_ticks"), table.episode_ticks, 0)?,
            BodyConfig::Reacher(table) => ticks(in_table("episode_ticks"), table.episode_ticks, 0)?,
            BodyConfig::Furuta(table) => ticks(in_table("episode_ticks"), table.episode_ticks, 0)?,
            BodyConfig::PointMass(table) => {
                ticks(in_table("target_every"), table.target_every, 1)?;
                number(in_table("speed"), table.speed, limits::WEIGHT, "give 0 to 1e6")?;
                number(in_table("command"), table.command, limits::WEIGHT, "give 0 to 1e6")?;
            }
            BodyConfig::So101(table) => {
                ticks(in_table("target_every"), table.target_every, 1)?;
                let gain = 1e-3..=limits::GAIN;
                number(in_table("gain"), table.gain, gain, "give 0.001 to 1e6 rad/s for a command of 1")?;
                for (name, weight) in [("scale", table.scale), ("speed", table.speed), ("angle", table.angle)] {
                    number(in_table(name), weight, limits::WEIGHT, "give 0 to 1e6")?;
                }
            }
        }
    }
    check_timing(plant)
}

fn check_timing(plant: &PlantConfig) -> Result<(), Violation> {
    let timing = &plant.timing;
    let delays =
        [("delay", timing.delay), ("reward_delay", timing.reward_delay), ("picture_delay", timing.picture_delay)];
    // The delays of a reward and of a picture add to the delay of all.
    for (name, delay) in delays {
        if delay > MAX_DELAY / 2 {
            let remedy = format!("give 0 to {} ticks", MAX_DELAY / 2);
            return Err(Violation::value(format_args!("plant.timing.{name}"), delay, remedy));
        }
    }
    number("plant.timing.lag_ms", timing.lag_ms, 0.0..=60_000.0, "give 0 to 60000 ms")
}

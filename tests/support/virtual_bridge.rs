//! The bridge on an emulated chain in virtual time: what the tests of it share.

#![allow(dead_code)] // Each test binary uses only a part of this module.

use std::sync::{Arc, Mutex};

use tectum::agent::Agent;
use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{EmulatorConfig, Plan, Scenario};
use tectum::servo::bridge::{Bridge, BridgeError, joints_of};
use tectum::servo::bus::{Bus, BusError};
use tectum::servo::emulator::{EmulatedChain, EmulatedPort, SteppedClock};
use tectum::servo::model::Protocol;
use tectum::wire::{Command, Learning, Observation};

/// The plan of `scenarios/servo-emulated.toml` with this emulator, this number of ticks, and `change` applied to its
/// text.
pub fn plan(emulator: &str, ticks: u64, change: impl FnOnce(String) -> String) -> Plan {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
    let (_, tail) = tail.split_once("[encoder]").unwrap();
    let text = change(format!("{head}\n[plant.emulator]\n{emulator}\n[encoder]{tail}"));
    let mut scenario = Scenario::parse(&text, "bridge").unwrap();
    scenario.ticks = ticks;
    scenario.plan().unwrap()
}

/// A bridge on an emulated chain.
pub struct Setup {
    pub chain: Arc<Mutex<EmulatedChain>>,
    pub clock: SteppedClock,
    pub bridge: Bridge,
}

/// A bridge on the chain that the plan describes.
pub fn set_up(plan: &Plan) -> Setup {
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let ids: Vec<u8> = joints_of(plan).unwrap().iter().map(|joint| joint.id).collect();
    let ideal = EmulatorConfig::default();
    let settings = plan.scenario.plant.emulator.as_ref().unwrap_or(&ideal);
    let chain = EmulatedChain::new(servos.protocol, &ids, servos.baud, settings, plan.scenario.seed);
    set_up_on(plan, chain).unwrap()
}

/// A bridge on any chain, which may differ from the plan's.
pub fn set_up_on(plan: &Plan, chain: EmulatedChain) -> Result<Setup, BridgeError> {
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bridge = Bridge::new(plan, bus_to(&chain, &clock, plan), joints_of(plan)?, Box::new(|_| {}))?;
    Ok(Setup { chain, clock, bridge })
}

/// The plan's host side of the bus.
pub fn bus_to(chain: &Arc<Mutex<EmulatedChain>>, clock: &SteppedClock, plan: &Plan) -> Bus {
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let (port, now) = (EmulatedPort::new(Arc::clone(chain), clock.clone(), servos.baud), clock.clone());
    Bus::over(Box::new(port), servos.protocol, Bridge::budget(plan), Box::new(move || now.now()))
}

/// The same for a port that can be opened again when its cable is back.
pub fn bus_that_reopens(chain: &Arc<Mutex<EmulatedChain>>, clock: &SteppedClock, plan: &Plan) -> Bus {
    let mut bus = bus_to(chain, clock, plan);
    let baud = plan.scenario.plant.servos.as_ref().unwrap().baud;
    let (line, now) = (Arc::clone(chain), clock.clone());
    bus.set_opener(Box::new(move || {
        let out = line.lock().unwrap().is_cable_out();
        if out {
            return Err(BusError::NoPort("arm".to_owned()));
        }
        Ok(Box::new(EmulatedPort::new(Arc::clone(&line), now.clone(), baud)))
    }));
    bus
}

/// A scenario's text with another protocol.
pub fn with_protocol(text: &str, protocol: Protocol) -> String {
    text.replace("\"dynamixel\" ", &format!("\"{}\" ", protocol.name()))
}

/// One run in virtual time. `command_arrives` decides for every tick whether the bridge receives the command. Returns
/// the observations, whether any servo had torque at the end of each tick, and the bridge.
pub fn run(
    plan: &Plan,
    setup: Setup,
    command_arrives: impl FnMut(u64) -> bool,
) -> (Vec<Observation>, Vec<bool>, Bridge) {
    let (all, torque, bridge, _) = run_learning(plan, setup, command_arrives);
    (all, torque, bridge)
}

/// The same, and returns the learning sample of each tick as well.
pub fn run_learning(
    plan: &Plan,
    setup: Setup,
    command_arrives: impl FnMut(u64) -> bool,
) -> (Vec<Observation>, Vec<bool>, Bridge, Vec<Learning>) {
    run_with(plan, setup, plan.agent(), command_arrives)
}

/// The same with an agent of its own.
pub fn run_with(
    plan: &Plan,
    setup: Setup,
    agent: impl Agent,
    mut command_arrives: impl FnMut(u64) -> bool,
) -> (Vec<Observation>, Vec<bool>, Bridge, Vec<Learning>) {
    let Setup { chain, clock, bridge } = setup;
    let mut t0 = clock.now();
    let mut side = PlantSide::new(bridge, plan);
    let mut controller = Controller::with_agent(plan, agent);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let (mut all, mut torque, mut learned) = (Vec::new(), Vec::new(), Vec::new());
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        all.push(observation);
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        let mut learning = Learning::default();
        controller.record(&observation, &mut learning);
        learned.push(learning);
        let before = clock.now();
        let arrives = command_arrives(tick);
        // A test may let time pass here, as if the process had been stopped.
        t0 += clock.now() - before;
        side.apply(tick, arrives.then_some(&command), true);
        let end = t0 + (tick + 1) * plan.period_ns;
        assert!(clock.now() <= end, "tick {tick}: the bus took longer than the tick");
        clock.step_to(end);
        torque.push(chain.lock().unwrap().state(end).iter().any(|servo| servo.torque));
        side.finish_step(tick);
    }
    (all, torque, side.into_body(), learned)
}

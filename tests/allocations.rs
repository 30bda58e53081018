//! I6: in a tick our code allocates nothing. What iceoryx2 allocates is counted apart, and stated.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use tectum::channel::{ControllerPorts, DomainName, LoggerPorts, PlantPorts, RunServices};
use tectum::plant::SimulatedPlant;
use tectum::runtime::{Controller, PlantSide, identity};
use tectum::scenario::Scenario;
use tectum::wire::{Command, Learning, Observation, Status};

thread_local! {
    /// Allocations of this thread; the test harness's other threads do not count.
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call goes to the system's allocator unchanged; the counter is a plain thread-local without destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.with(|c| c.set(c.get() + 1));
        // SAFETY: the caller keeps the promises of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        COUNT.with(|c| c.set(c.get() + 1));
        // SAFETY: the caller keeps the promises of `realloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the promises of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn count() -> u64 {
    COUNT.with(Cell::get)
}

/// The two halves of a tick, and what passes between them.
struct Loop {
    plant: PlantSide<SimulatedPlant>,
    controller: Controller,
    observation: Observation,
    command: Command,
    learning: Learning,
}

impl Loop {
    fn new(name: &str) -> Self {
        let mut scenario = Scenario::find(name).unwrap();
        // Short windows, so that the account closes many of them.
        scenario.ticks = 10_000;
        let plan = scenario.plan().unwrap();
        Self {
            plant: PlantSide::new(plan.simulated_plant().unwrap(), &plan),
            controller: Controller::new(&plan),
            observation: Observation::default(),
            command: Command::default(),
            learning: Learning::default(),
        }
    }

    fn tick(&mut self, tick: u64) {
        self.plant.observe(tick, 0, 0, &mut self.observation);
        self.controller.respond(&self.observation, &mut self.command);
        self.controller.after_command(&self.observation);
        self.controller.record(&self.observation, &mut self.learning);
        // Every kind of tick: answered, missed, out of range, not a number.
        match tick % 97 {
            13 => self.plant.step(tick, None),
            29 => {
                self.command.drawn[0] = 1e9;
                self.plant.step(tick, Some(&self.command));
            }
            31 => {
                self.command.drawn[0] = f32::NAN;
                self.plant.step(tick, Some(&self.command));
            }
            _ => self.plant.step(tick, Some(&self.command)),
        }
    }
}

#[test]
fn a_tick_allocates_nothing() {
    // A tick of `arm` takes a thousand times longer: its learner improves the policy from the 20th on.
    for (name, ticks) in [("paper", 10_000), ("eye", 10_000), ("arm", 60), ("office", 300)] {
        let mut all = Loop::new(name);
        let before = count();
        for tick in 0..ticks {
            all.tick(tick);
        }
        assert_eq!(count() - before, 0, "{name}");
    }
}

/// The same with the channels in between. A sample costs iceoryx2 0.10 one allocation in its writer, none in its
/// readers; boards and bell cost none. If that ever changes, this says so.
#[test]
fn what_the_transport_allocates_is_known() {
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    let (channels, identity) = (&plan.scenario.channels, identity(&plan));
    let name = DomainName::of(u64::from(std::process::id()) << 32 | 0xa110c);
    let _hub = RunServices::create(&name, &identity, channels, None).unwrap();
    let (plant, _desk) = PlantPorts::open(&name, &identity, channels).unwrap();
    let (controller, desk) = ControllerPorts::open(&name, &identity, channels).unwrap();
    let (logger, _desk) = LoggerPorts::open(&name, &identity, channels).unwrap();
    let mut all = Loop::new("paper");
    let mut status = Status::default();
    let (mut before, ticks) = (0, 2000);
    for tick in 0..2 * ticks {
        if tick == ticks {
            before = count();
        }
        plant.observation.send(&all.observation).unwrap();
        plant.wake.notify();
        let received = controller.observation.receive().unwrap().unwrap();
        assert_eq!(received, all.observation);
        controller.command.send(&all.command).unwrap();
        controller.learning.send(&all.learning).unwrap();
        status.ticks = tick;
        desk.status.put(status);
        assert!(plant.command.receive().unwrap().is_some());
        assert!(logger.observation.receive().unwrap().is_some());
        assert!(logger.command.receive().unwrap().is_some());
        assert!(logger.learning.receive().unwrap().is_some());
        all.tick(tick);
    }
    let a_tick = (count() - before) as f64 / ticks as f64;
    println!("iceoryx2 allocates {a_tick} times a tick: three samples sent, six received, one bell rung");
    assert_eq!(a_tick, TRANSPORT);
}

const TRANSPORT: f64 = 3.0;

//! What the kit itself must find: hanging programs, early ends, children, and plants that break a run's assumptions.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use tectum::plant::{Outcome, Plant};
use tectum::state::{Persist, StateVisitor};
use tectum_testkit::{Process, ScenarioFile, TestFolder, check_plant, has_ended, signal_process};

/// The message of the panic that `work` must end with.
#[track_caller]
fn panic_message(work: impl FnOnce()) -> String {
    let panic = catch_unwind(AssertUnwindSafe(work)).expect_err("this must panic");
    panic.downcast_ref::<String>().cloned().unwrap_or_default()
}

fn shell(folder: &TestFolder, script: &str) -> Process {
    folder.start("sh", &["-c", script])
}

#[test]
fn a_program_that_hangs_is_killed_and_its_output_is_shown() {
    let folder = TestFolder::new().with_watchdog(Duration::from_millis(20));
    let mut process = shell(&folder, "echo began; exec sleep 1000");
    let pid = process.id();
    let message = panic_message(|| process.wait_until("what never happens", || false));
    assert!(message.contains("what never happens") && message.contains("hung for 20ms"), "{message}");
    assert!(has_ended(pid), "the process is killed");

    let process = shell(&folder, "echo began; exec sleep 1000");
    let message = panic_message(|| drop(process.wait()));
    assert!(message.contains("the process hangs for 20ms"), "{message}");
}

#[test]
fn a_wait_ends_when_the_program_ends() {
    let folder = TestFolder::new();
    let mut process = shell(&folder, "echo said; echo why >&2; exit 3");
    let message = panic_message(|| process.wait_until("what never happens", || false));
    for part in ["the process ended", "said", "why", "3"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    // What the program did just before its end still counts.
    let mark = folder.path().join("mark");
    shell(&folder, "touch mark").wait_until("the mark", || mark.exists());
    let mut process = shell(&folder, "exit 0");
    process.wait_until_or_end("what never happens", || false);
    process.wait().expect(0);
}

#[test]
fn another_exit_code_shows_the_output() {
    let message = panic_message(|| drop(shell(&TestFolder::new(), "echo why >&2; exit 3").wait().expect(0)));
    assert!(message.contains("why"), "{message}");
    let refusal = shell(&TestFolder::new(), "echo no >&2; exit 2").wait().refusal();
    assert_eq!(refusal, "no");
}

#[test]
fn a_child_is_found_by_its_program_or_its_script_and_again_after_its_death() {
    let folder = TestFolder::new();
    folder.write_file("plant.sh", "kill -STOP $$");
    let mut parent = shell(&folder, "while :; do sh plant.sh; done");
    let first = parent.child_pid("plant.sh");
    assert_eq!(parent.child_pid("sh"), first);
    assert_eq!(parent.kill_child("plant.sh"), first);
    let second = parent.next_child_pid("plant.sh", first);
    assert_ne!(first, second);
    drop(parent);
    // It was not this process's child: it has been sent the signal, and may not have ended yet.
    while !has_ended(second) {
        std::thread::yield_now();
    }
}

#[test]
fn a_folder_is_fresh_and_is_removed() {
    let (first, second) = (TestFolder::new(), TestFolder::new());
    assert_ne!(first.path(), second.path());
    let path = first.path().to_owned();
    assert!(path.exists());
    drop(first);
    assert!(!path.exists());
}

#[test]
#[should_panic(expected = "no signal \"SIGKILL\"; give CONT")]
fn an_unknown_signal_is_named() {
    signal_process(std::process::id(), "SIGKILL");
}

/// A counter that returns to 0, in which a test can break things.
#[derive(Default)]
struct Counter {
    count: f32,
    /// It leaves its count out of the list of its state.
    forgets: bool,
    /// Added to every input.
    offset: f32,
}

impl Persist for Counter {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if !self.forgets {
            visitor.number("count", &mut self.count);
        }
    }
}

impl Plant for Counter {
    fn sense(&mut self, _tick: u64, inputs: &mut [f32]) -> bool {
        inputs[0] = self.count / 100.0 + self.offset;
        false
    }

    fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
        self.count = (self.count + 1.0) % 100.0;
        Outcome { reward: -applied[0], ..Outcome::default() }
    }
}

fn check(make: impl FnMut() -> Counter) {
    let scenario = r#"
        name = "counter"
        ticks = 100
        plant.program = "counter"
        plant.inputs = [{ name = "count", min = 0.0, max = 1.0 }]
        plant.outputs = [{ name = "push", min = -1.0, max = 1.0 }]
        encoder.maps = [{ inputs = ["count"], radius = 0.2 }]
        policy.sigma = 0.2
        gate.max_command = 1.0
    "#;
    check_plant(&ScenarioFile::from_text(scenario).plan(), 250, make);
}

#[test]
fn a_sound_plant_passes() {
    check(Counter::default);
}

#[test]
fn state_that_is_not_listed_is_found() {
    let message = panic_message(|| check(|| Counter { forgets: true, ..Counter::default() }));
    assert!(message.contains("restored state") && message.contains("tick 125: input count is 0"), "{message}");
}

#[test]
fn a_plant_that_is_built_differently_is_found() {
    let mut made = 0.0;
    let message = panic_message(|| {
        check(|| {
            made += 1e-4;
            Counter { offset: made, ..Counter::default() }
        });
    });
    assert!(message.starts_with("a plant that is built again differs at tick 0: input count is 0.0002"), "{message}");
}

#[test]
fn values_out_of_range_and_not_a_number_are_found() {
    let message = panic_message(|| check(|| Counter { offset: 0.5, ..Counter::default() }));
    assert_eq!(message, "input count at tick 51 is 1.01; the scenario states 0 to 1");
    let message = panic_message(|| check(|| Counter { offset: f32::NAN, ..Counter::default() }));
    assert_eq!(message, "input count at tick 0 is NaN");
}

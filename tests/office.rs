//! Every learning rule under every fault, in one process, recorded in a table.
//!
//! The results must equal `tests/snapshots/office.txt`. A change of that table is a change of the effect of faults and
//! must be reviewed there. To write it anew: `TECTUM_BLESS=1 cargo test --test office`.

#[path = "support/snapshot.rs"]
mod snapshot;

use std::fmt::Write as _;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use snapshot::assert_snapshot;
use tectum::runtime::{Controller, ControllerReport, PlantReport, PlantSide};
use tectum::scenario::{Plan, Scenario};
use tectum::stats::Window;
use tectum::wire::{Command, Learning, Observation, flag};

const TICKS: u64 = 2000;

/// The learning rules. The last one has few imagined movements, so that debug builds are quick.
const RULES: [(&str, &str); 5] = [
    ("paper", "rule = \"paper\""),
    ("baseline", "rule = \"baseline\""),
    ("actor-critic", "rule = \"actor-critic\""),
    ("natural-actor-critic", "rule = \"natural-actor-critic\""),
    ("learned-reward", "rule = \"learned-reward\"\n[learner.model]\nmovements = 4\nsteps = 1\nmemory = 64"),
];

/// The kinds of fault: name, kind, and the other keys that the kind needs.
const KINDS: [(&str, &str, &str); 7] = [
    ("delay", "delay", "ticks = 3"),
    ("drop", "drop", ""),
    ("duplicate", "duplicate", "ticks = 3"),
    ("reorder", "reorder", ""),
    ("freeze", "freeze", "ticks = 3"),
    ("not a number", "corrupt", "value = \"nan\""),
    ("huge", "corrupt", "value = \"huge\""),
];

/// A cell of the matrix of rules and faults.
struct Cell {
    rule: &'static str,
    fault: String,
    plan: Plan,
}

/// The arm of `scenarios/paper.toml` with this learner and with more tables appended.
fn plan(learner: &str, more: &str) -> Plan {
    let paper = std::fs::read_to_string("scenarios/paper.toml").unwrap();
    let (head, tail) = paper.split_once("\n[learner]").unwrap();
    let (_, tail) = tail.split_once("\n# The paper has no limit").unwrap();
    let text = format!("{head}\n[learner]\n{learner}\n# {tail}\n{more}");
    let mut scenario = Scenario::parse(&text, "office").unwrap();
    (scenario.seed, scenario.ticks) = (3, TICKS);
    scenario.plan().unwrap()
}

fn cells() -> Vec<Cell> {
    let mut cells = Vec::new();
    for (rule, learner) in RULES {
        cells.push(Cell { rule, fault: "none".to_owned(), plan: plan(learner, "") });
        for channel in ["observation", "command"] {
            for (name, kind, more) in KINDS {
                let more = format!(
                    "[[faults.channel]]\nchannel = \"{channel}\"\nkind = \"{kind}\"\nprobability = 0.05\n{more}"
                );
                cells.push(Cell { rule, fault: format!("{channel} {name}"), plan: plan(learner, &more) });
            }
        }
    }
    let mut office = Scenario::find("office").unwrap();
    office.ticks = TICKS;
    office.learner = toml::from_str(RULES[4].1.replace("[learner.model]", "[model]").as_str()).unwrap();
    cells.push(Cell { rule: "learned-reward", fault: "office.toml".to_owned(), plan: office.plan().unwrap() });
    cells
}

/// Runs a plan and checks in every tick what must hold under every fault.
fn run(plan: &Plan) -> (PlantReport, ControllerReport) {
    let mut side = PlantSide::new(plan.simulated_plant().unwrap(), plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command, mut learning) =
        (Observation::default(), Command::default(), Learning::default());
    for tick in 0..plan.scenario.ticks {
        let requested = command.drawn;
        side.observe(tick, 0, 0, &mut observation);
        let flags = observation.header.flags;
        assert!(observation.applied.iter().all(|u| u.abs() <= 0.05), "{observation:?}");
        assert!(observation.inputs.iter().all(|x| x.is_finite()) && observation.reward.is_finite());
        // A command that was applied differently from the request is flagged, so that the learner uses the applied one
        // or does not learn.
        if flags & (flag::FIRST | flag::MISSED | flag::CLAMPED) == 0 {
            assert_eq!(observation.applied, requested, "tick {tick}, flags {flags:#x}");
        }
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        controller.record(&observation, &mut learning);
        assert!(command.drawn.iter().all(|u| u.is_finite()) && learning.weights_norm.is_finite());
        if flags & flag::MISSED != 0 {
            assert_eq!(learning.header.flags & flag::LEARNED, 0, "tick {tick}");
        }
        side.step(tick, Some(&command));
    }
    (side.into_report(), controller.finish())
}

/// Mean loss over the last quarter of the run.
fn loss(windows: &[Window]) -> f64 {
    let late: Vec<_> = windows.iter().filter(|w| w.from >= TICKS * 3 / 4).collect();
    let ticks: u64 = late.iter().map(|w| w.ticks).sum();
    late.iter().map(|w| w.loss * w.ticks as f64).sum::<f64>() / ticks as f64
}

const HEAD: &str = "\
Every learning rule under every fault: the arm of scenarios/paper.toml, seed 3, 2000 ticks. Each fault has a probability
of 0.05 a tick; a delay, a duplicate and a freeze last 3 ticks. learned-reward imagines few movements. office.toml has
faults of its own.

missed: ticks without a command, in which the hold policy acted. late: commands that arrived after their tick. limited:
ticks in which the gate limited the command. bad: commands with a value that is not a number. unheard: ticks whose
observation did not reach the controller. stale: observations that arrived after their tick. blind: observations without
valid inputs. learned: ticks that were learned from. cuts: cuts of the trace. loss: mean loss of a tick over the last
quarter of the run. cost: percentage of ticks that the fault kept from the learner, and its increase of the loss.

";

/// Runs all cells on the machine's cores; the results are in the order of the cells.
fn run_all(cells: &[Cell]) -> Vec<(PlantReport, ControllerReport)> {
    let results: Vec<_> = cells.iter().map(|_| Mutex::new(None)).collect();
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(cell) = cells.get(i) else { break };
                    *results[i].lock().unwrap() = Some(run(&cell.plan));
                }
            });
        }
    });
    results.into_iter().map(|result| result.into_inner().unwrap().unwrap()).collect()
}

/// The result of a rule without faults.
struct CleanRun {
    learned: u64,
    loss: f64,
    weights_hash: String,
}

/// Checks what must hold for every fault, compared with the same rule without faults.
fn check(cell: &Cell, p: &PlantReport, c: &ControllerReport, clean: &CleanRun) {
    if cell.fault == "none" {
        assert_eq!((p.missed, p.late, c.unheard, c.stale, c.invalid, c.cuts), (0, 0, 0, 0, 0, 0), "{}", cell.rule);
    } else {
        assert!(
            p.missed + p.late + p.clamped + c.stale + c.invalid > 50,
            "{} {}: the fault had no effect",
            cell.rule,
            cell.fault
        );
    }
    // A duplicate is recognised by its tick and has no cost.
    if cell.fault.ends_with("duplicate") {
        assert_eq!((c.learned, &c.weights_hash), (clean.learned, &clean.weights_hash), "{} {}", cell.rule, cell.fault);
    }
    assert_eq!(c.diverged_at, None, "{} {}", cell.rule, cell.fault);
}

/// The headings of the table's columns.
fn headings() -> String {
    format!(
        "{:<21}{:<25}{:>7}{:>6}{:>8}{:>5}{:>8}{:>6}{:>6}{:>8}{:>6}{:>9}{:>6}{:>9}  weights",
        "rule",
        "fault",
        "missed",
        "late",
        "limited",
        "bad",
        "unheard",
        "stale",
        "blind",
        "learned",
        "cuts",
        "loss",
        "cost",
        ""
    )
}

/// A cell's row of the table.
fn row(cell: &Cell, p: &PlantReport, c: &ControllerReport, clean: &CleanRun) -> String {
    let loss = loss(&c.windows);
    let cost = 100.0 * (clean.learned - c.learned.min(clean.learned)) as f64 / clean.learned as f64;
    format!(
        "{:<21}{:<25}{:>7}{:>6}{:>8}{:>5}{:>8}{:>6}{:>6}{:>8}{:>6}{loss:>9.4}{cost:>6.1}{:>+9.4}  {}",
        cell.rule,
        cell.fault,
        p.missed,
        p.late,
        p.clamped,
        p.non_finite,
        c.unheard,
        c.stale,
        c.invalid,
        c.learned,
        c.cuts,
        loss - clean.loss,
        c.weights_hash
    )
}

#[test]
fn every_learner_under_every_fault_gives_the_recorded_table() {
    let cells = cells();
    let results = run_all(&cells);
    let mut text = format!("{HEAD}{}\n", headings());
    let mut clean = CleanRun { learned: 0, loss: 0.0, weights_hash: String::new() };
    for (cell, (plant, controller)) in cells.iter().zip(&results) {
        if cell.fault == "none" {
            let (loss, weights_hash) = (loss(&controller.windows), controller.weights_hash.clone());
            clean = CleanRun { learned: controller.learned, loss, weights_hash };
        }
        check(cell, plant, controller, &clean);
        let _ = writeln!(text, "{}", row(cell, plant, controller, &clean));
    }
    assert_snapshot("tests/snapshots/office.txt", &text);
}

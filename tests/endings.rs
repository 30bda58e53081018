//! However a run ends: a signal, a process killed, at any moment. Nothing hangs, nothing is left, the log can be read.

mod support;

use support::{Outcome, Place, Process, assert_no_debris, children, signal_process};
use tectum::log::LogReader;

/// The moment at which a signal is sent.
#[derive(Debug, Clone, Copy)]
enum Moment {
    /// As soon as the run has a manifest: its processes are being started.
    SetUp,
    /// As soon as there are ticks.
    First,
    /// A while into the run.
    Middle,
}

const MOMENTS: [Moment; 3] = [Moment::SetUp, Moment::First, Moment::Middle];

fn start(place: &Place, mode: &str, moment: Moment) -> Process {
    let scenario = place.endless(mode);
    // Here a death is the end: `tests/restarts.rs` has the others.
    let never = "\n[restart]\nplant = \"never\"\ncontroller = \"never\"\nlogger = \"never\"\n";
    std::fs::write(&scenario, std::fs::read_to_string(&scenario).unwrap() + never).unwrap();
    let mut run = place.run(&[&scenario, "--mode", mode, "--json"]);
    let (manifest, log) = (place.run_folder().join("run.json"), place.run_folder().join("log.mcap"));
    match moment {
        Moment::SetUp => run.until("the run's manifest", || manifest.exists()),
        Moment::First => run.until("the log", || log.exists()),
        Moment::Middle => run.until("a grown log", || {
            let enough = if mode == "lockstep" { 200_000 } else { 60_000 };
            std::fs::metadata(&log).is_ok_and(|m| m.len() > enough)
        }),
    }
    run
}

fn check(place: &Place, outcome: &Outcome) {
    let folder = place.run_folder();
    if folder.join("run.json").exists() {
        assert_no_debris(&folder);
    }
    let log = folder.join("log.mcap");
    if log.exists() {
        let mut reader = LogReader::open(&log).unwrap_or_else(|e| panic!("{e}\n{outcome:#?}"));
        assert!(reader.by_ref().all(|record| record.is_ok()), "{outcome:#?}");
    }
}

#[test]
fn a_signal_ends_a_run_in_good_order() {
    for mode in ["lockstep", "realtime"] {
        for moment in MOMENTS {
            for (signal, code) in [("INT", 130), ("TERM", 143)] {
                let place = Place::new();
                let run = start(&place, mode, moment);
                let launcher = run.id();
                run.signal(signal);
                let outcome = run.wait().expect(code);
                assert!(children(launcher).is_empty());
                check(&place, &outcome);
                if matches!(moment, Moment::Middle) {
                    let summary = outcome.json();
                    assert!(summary["ticks"].as_u64() > Some(0), "{summary}");
                    assert!(summary["weights_hash"].is_string(), "the controller finished its report: {summary}");
                    assert!(LogReader::open(&place.run_folder().join("log.mcap")).unwrap().last().is_some());
                    let mut reader = LogReader::open(&place.run_folder().join("log.mcap")).unwrap();
                    assert!(reader.by_ref().count() > 0 && reader.finished(), "the log is closed");
                    assert!(!reader.totals().unwrap().complete);
                }
            }
        }
    }
}

#[test]
fn a_killed_process_ends_the_run_with_a_sentence() {
    for mode in ["lockstep", "realtime"] {
        for (program, role) in
            [("tectum-simulator", "plant"), ("tectum-controller", "controller"), ("tectum-logger", "logger")]
        {
            let place = Place::new();
            let mut run = start(&place, mode, Moment::First);
            let member = run.member(program);
            signal_process(member, "KILL");
            let outcome = run.wait().expect(4);
            assert!(outcome.stderr.contains(&format!("the {role} was killed by signal 9")), "{outcome:#?}");
            check(&place, &outcome);
        }
    }
}

/// A process that was asked to end by somebody else than the launcher.
#[test]
fn a_terminated_process_ends_the_run() {
    let place = Place::new();
    let mut run = start(&place, "realtime", Moment::First);
    let controller = run.member("tectum-controller");
    signal_process(controller, "TERM");
    let outcome = run.wait().expect(4);
    assert!(outcome.stderr.contains("the controller ended"), "{outcome:#?}");
    check(&place, &outcome);
}

/// The others are in the middle of setting up when one gives up at once.
#[test]
fn a_plant_that_never_starts_leaves_nothing() {
    let text = std::fs::read_to_string("examples/point.toml").unwrap();
    let text = text.replace("target/release/examples/point", "/bin/false");
    for _ in 0..20 {
        let place = Place::new();
        let scenario = place.file("scenario.toml", &text);
        // The folder of a run that never began goes with it: its domain is told by what is new, and not another test's.
        let before = shared();
        place.run(&[scenario.to_str().unwrap()]).wait().expect(4);
        let held = |name: &String| std::fs::exists(format!("/dev/shm/{}/launcher.lock", stem(name))).unwrap();
        let left: Vec<_> = shared().into_iter().filter(|name| !before.contains(name) && !held(name)).collect();
        let left: Vec<_> = left.iter().filter(|name| shared().contains(name)).collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

/// What is in shared memory of all runs.
fn shared() -> Vec<String> {
    let names = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.starts_with("tectum_")).collect()
}

/// `tectum_` and eight digits: the domain that a file belongs to.
fn stem(name: &str) -> &str {
    &name[..name.len().min("tectum_00000000".len())]
}

/// Without a launcher nobody could end them: processes notice that it is gone.
#[test]
fn processes_end_when_their_launcher_is_killed() {
    for mode in ["lockstep", "realtime"] {
        let place = Place::new();
        let mut run = start(&place, mode, Moment::First);
        let members: Vec<u32> =
            ["tectum-simulator", "tectum-controller", "tectum-logger"].map(|p| run.member(p)).to_vec();
        run.signal("KILL");
        assert_eq!(run.wait().code, None);
        let gone =
            |pid: &u32| std::fs::read_to_string(format!("/proc/{pid}/stat")).map_or(true, |s| s.contains(") Z "));
        let began = std::time::Instant::now();
        while !members.iter().all(gone) {
            assert!(began.elapsed().as_secs() < 60, "orphans in {mode}");
            std::thread::yield_now();
        }
        check_orphaned_log(&place);
        // What a killed launcher leaves in shared memory is taken away here, so that tests leave nothing.
        clean(&place);
    }
}

fn check_orphaned_log(place: &Place) {
    let log = place.run_folder().join("log.mcap");
    assert!(LogReader::open(&log).unwrap().all(|record| record.is_ok()));
}

fn clean(place: &Place) {
    let text = std::fs::read_to_string(place.run_folder().join("run.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
    let name: tectum::channel::DomainName = serde_json::from_value(manifest["domain"].clone()).unwrap();
    tectum::channel::remove_domain(&name);
    assert_no_debris(&place.run_folder());
}

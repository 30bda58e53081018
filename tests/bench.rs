//! Short runs of each command of `tectum bench` with real processes. Other tests share the machine, so no test
//! asserts a time. The tests check that the results are complete and consistent and that nothing is left afterwards.

mod support;

use std::fs;
use std::path::Path;

use serde_json::Value;
use support::{ProcessOutcome, TECTUM, TestFolder, children, has_ended, read_json, signal_process};
use tectum::log::{RunLog, segments};

const TRANSPORTS: [&str; 5] = ["iceoryx2-event", "iceoryx2-poll", "unix-socket", "pipe", "futex"];
const SERIES: [&str; 5] =
    ["scheduled_to_sensed", "sensed_to_command", "command_to_applied", "sensed_to_applied", "scheduled_to_applied"];

/// Runs a bench and checks that it leaves nothing in shared memory and no process.
fn bench(test_folder: &TestFolder, arguments: &[&str]) -> ProcessOutcome {
    let mut all = vec!["bench"];
    all.extend(arguments);
    let process = test_folder.start(TECTUM, &all);
    let pid = process.id();
    let outcome = process.wait();
    assert_eq!(domains_of(pid), Vec::<String>::new(), "left in /dev/shm: {outcome:#?}");
    assert!(children(pid).is_empty());
    outcome
}

/// The domains in shared memory that process `pid` has created.
fn domains_of(pid: u32) -> Vec<String> {
    let names = fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.path());
    let ours = |path: &std::path::PathBuf| {
        fs::read_to_string(path.join("launcher.lock")).is_ok_and(|text| text.trim() == pid.to_string())
    };
    names.filter(ours).map(|path| path.display().to_string()).collect()
}

fn list<'a>(of: &'a Value, key: &str) -> &'a Vec<Value> {
    of[key].as_array().unwrap_or_else(|| panic!("no list {key} in {of}"))
}

fn number(of: &Value, key: &str) -> f64 {
    of[key].as_f64().unwrap_or_else(|| panic!("no number {key} in {of}"))
}

fn assert_machine(found: &Value) {
    let machine = &found["machine"];
    assert!(machine["facts"]["processor"].is_string() && machine["facts"]["kernel"].is_string(), "{machine}");
    assert!(!list(machine, "checks").is_empty() && !list(machine, "cores").is_empty());
    assert!(machine["date"].as_str().unwrap().ends_with(" UTC") && machine["mitigations"].is_object());
}

/// Checks every series of every transport: one sample a tick, percentiles in order, and the distribution in a file.
fn assert_latency(found: &Value, folder: &Path) {
    assert_machine(found);
    for transport in list(found, "ways") {
        let (ticks, swallowed) = (number(transport, "ticks"), number(transport, "swallowed"));
        assert!(ticks > 0.0, "{transport}");
        for series in SERIES {
            let p = &transport[format!("{series}_us")];
            let values = ["p50", "p90", "p99", "p999", "max"].map(|q| number(p, q));
            // A histogram has three digits of precision; its maximum is exact.
            assert!(values.windows(2).all(|w| w[0] <= w[1] * 1.002) && values[0] >= 0.0, "{series} {transport}");
            let count = number(p, "count");
            let expected = if series.starts_with("scheduled") { ticks + swallowed } else { ticks };
            assert!(count == expected || count < expected && series.contains("command"), "{series} {transport}");
        }
        let files = list(transport, "files");
        assert_eq!(files.len(), SERIES.len());
        for (file, series) in files.iter().zip(SERIES) {
            let text = fs::read_to_string(folder.join(file.as_str().unwrap())).unwrap();
            let total =
                text.lines().last().unwrap().rsplit_once('=').unwrap().1.trim_end_matches(']').trim().to_owned();
            assert_eq!(total.parse::<f64>().unwrap(), number(&transport[format!("{series}_us")], "count"), "{text}");
        }
    }
    for ratio in list(found, "ratios") {
        assert!(TRANSPORTS.contains(&ratio["to"].as_str().unwrap()), "{ratio}");
        assert!(number(ratio, "p50") > 0.0 && number(ratio, "p99") > 0.0, "{ratio}");
    }
    assert!(!folder.join("block").exists(), "the runs are gone");
}

/// The names of the transports that were measured with these caches.
fn transports(found: &Value, caches: &str) -> Vec<String> {
    let measured = list(found, "ways").iter().filter(|transport| transport["caches"] == caches);
    measured.map(|transport| transport["way"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn latency_at_a_cadence_measures_every_transport_cold_and_warm() {
    let test_folder = TestFolder::new();
    let found = bench(&test_folder, &["latency", "--seconds", "0.2", "--json", "--out", "lat"]).expect(0).json();
    let folder = test_folder.path().join("lat");
    assert_latency(&found, &folder);
    let mut all = vec!["tectum"];
    all.extend(TRANSPORTS);
    assert_eq!(transports(&found, "usual"), all);
    for caches in ["cold", "warm"] {
        assert_eq!(transports(&found, caches), ["tectum", "iceoryx2-event"]);
    }
    assert_eq!((found["mode"].as_str(), number(&found, "period_ms")), (Some("cadence"), 50.0));
    // Each bare transport has a ratio in the same series and one over its whole round trip; iceoryx2-event also has
    // them cold and warm.
    assert_eq!(list(&found, "ratios").len(), 2 * (TRANSPORTS.len() + 2));
    assert!(found["slowest_eviction_ms"].is_number());
    // A command of Tectum is applied at the next tick.
    let tectum = &list(&found, "ways")[0];
    assert!(number(&tectum["scheduled_to_applied_us"], "p50") >= 50_000.0, "{tectum}");
    let written = read_json(folder.join("latency.json"));
    assert_eq!(written["ways"], found["ways"]);
}

#[test]
fn latency_back_to_back_measures_every_transport() {
    let test_folder = TestFolder::new();
    let found = bench(&test_folder, &["latency", "--mode", "saturated", "--seconds", "0.1", "--json", "--out", "sat"])
        .expect(0)
        .json();
    assert_latency(&found, &test_folder.path().join("sat"));
    assert_eq!(transports(&found, "usual").len(), TRANSPORTS.len() + 1);
    assert_eq!(list(&found, "ratios").len(), TRANSPORTS.len());
    assert!(found["period_ms"].is_null() && found["slowest_eviction_ms"].is_null());
    let tectum = &list(&found, "ways")[0];
    assert!(number(tectum, "ticks") > 1000.0 && number(tectum, "missed") == 0.0, "{tectum}");
}

#[test]
fn lockstep_is_measured_beside_bare_iceoryx2() {
    let test_folder = TestFolder::new();
    let arguments = ["lockstep", "--ticks", "20000", "--rounds", "2", "--json", "--out", "lock"];
    let found = bench(&test_folder, &arguments).expect(0).json();
    assert_machine(&found);
    let cases = list(&found, "cases");
    assert_eq!(cases.len(), 4);
    for (i, case) in cases.iter().enumerate() {
        assert_eq!(list(case, "blocks").len(), 2);
        assert!(number(&case["per_second"], "median") > 0.0 && !list(case, "cores").is_empty(), "{case}");
        assert_eq!(case["share_of_bare"].is_null(), i == 3, "{case}");
        assert_eq!(case["usage"].is_object(), i < 2, "{case}");
    }
    // The share is computed for each round separately.
    let rates = |i: usize| list(&cases[i], "blocks").iter().map(|x| x.as_f64().unwrap()).collect::<Vec<_>>();
    let shares: Vec<f64> = rates(0).iter().zip(rates(3)).map(|(ours, bare)| ours / bare).collect();
    let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((number(&cases[0]["share_of_bare"], "min") - least).abs() < 1e-9);
    assert!(test_folder.path().join("lock/lockstep.json").exists() && !test_folder.path().join("lock/block").exists());
}

fn paths() -> Vec<String> {
    tectum::simd::SimdPath::all().map(|path| path.to_string()).collect()
}

fn assert_costs(found: &Value, growths: usize) {
    assert_machine(found);
    for cost in list(found, "costs") {
        let ns = &cost["ns"];
        assert!(number(ns, "min") > 0.0 && number(ns, "min") <= number(ns, "median"), "{cost}");
    }
    let growth = list(found, "growth");
    let features: Vec<f64> = growth.iter().map(|g| number(g, "features")).collect();
    assert_eq!(growth.len(), growths * 11 * paths().len());
    assert!(features.contains(&32.0) && features.contains(&32_768.0));
}

#[test]
fn encoder_and_learner_are_measured_in_every_version_on_every_path() {
    let test_folder = TestFolder::new();
    let found = bench(&test_folder, &["encoder", "--batches", "2", "--json", "--out", "enc"]).expect(0).json();
    assert_costs(&found, 2);
    let versions: Vec<_> = list(&found, "costs").iter().map(|c| c["version"].as_str().unwrap()).collect();
    let mut expected = vec!["naive".to_owned(), "separable".to_owned(), "scalar twin".to_owned()];
    expected.extend(paths().iter().map(|path| format!("final, {path}")));
    let targets = |path: &String| [format!("target held, {path}"), format!("target jitters, {path}")];
    expected.extend(paths().iter().flat_map(targets));
    assert_eq!(versions, expected);
    let csv = fs::read_to_string(test_folder.path().join("enc/encoder.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + list(&found, "costs").len() + list(&found, "growth").len());

    let found = bench(&test_folder, &["learner", "--batches", "2", "--json", "--out", "learn"]).expect(0).json();
    assert_costs(&found, 2);
    let what: Vec<_> = list(&found, "costs").iter().map(|c| c["what"].as_str().unwrap()).collect();
    for rule in ["paper", "baseline", "actor-critic", "natural-actor-critic", "learned-reward"] {
        for part in ["learn, encode, act", "whole tick, with plant"] {
            assert!(what.contains(&format!("{rule}: {part}").as_str()), "{rule} {part}: {what:?}");
        }
    }
}

#[test]
fn bench_all_writes_a_page_with_figures_and_numbers() {
    let test_folder = TestFolder::new();
    let short = ["--seconds", "0.1", "--ticks", "20000", "--rounds", "1", "--batches", "2"];
    let found = bench(&test_folder, &[&["all", "--report", "page", "--json"][..], &short].concat()).expect(0).json();
    let folder = test_folder.path().join("page");
    let page = fs::read_to_string(folder.join("performance.md")).unwrap();
    for words in ["| what | target | measured |", "(latency.svg)", "(growth.svg)", "## Lockstep", " UTC"] {
        assert!(page.contains(words), "{words} in {page}");
    }
    for figure in ["latency.svg", "growth.svg"] {
        let svg = fs::read_to_string(folder.join(figure)).unwrap();
        assert!(svg.starts_with("<svg") && (svg.contains("iceoryx2-event") || svg.contains("encode a plane")));
    }
    for file in ["performance.json", "cadence/latency.json", "saturated/latency.json", "encoder/encoder.csv"] {
        assert!(folder.join(file).exists(), "{file}");
    }
    for target in list(&found, "targets") {
        let ratio = number(target, "measured") / number(target, "target");
        assert!(
            (number(target, "ratio") - ratio).abs() <= 1e-9 * ratio.abs() && target["met"].is_boolean(),
            "{target}"
        );
    }
    assert!(list(&found, "targets").len() >= 10, "{}", found["targets"]);
}

#[test]
fn growth_is_measured_over_joints_watchers_and_logs() {
    let test_folder = TestFolder::new();
    let short = ["--ticks", "8", "--seconds", "0.2", "--log-ticks", "4096", "--out", "growth", "--json"];
    let found = bench(&test_folder, &[&["growth"][..], &short].concat()).expect(0).json();
    assert_machine(&found);
    // Six learners on seven arms and on one with a target in space.
    let joints = list(&found, "joints");
    assert_eq!(joints.len(), 6 * 8);
    for row in joints {
        assert!(number(&row["tick_us"], "p50") > 0.0 && number(row, "share_of_50_ms") > 0.0, "{row}");
    }
    let watchers: Vec<_> = list(&found, "watchers").iter().map(|row| number(row, "watchers")).collect();
    assert_eq!(watchers, [0.0, 1.0, 2.0, 3.0, 4.0]);
    let log: Vec<_> = list(&found, "log").iter().map(|row| number(row, "ticks")).collect();
    assert_eq!(log, [2048.0, 2048.0, 2048.0, 4096.0]);
    assert!(number(&found["start"]["first_observation_ms"], "median") > 30.0, "{}", found["start"]);
    let svg = fs::read_to_string(test_folder.path().join("growth/joints.svg")).unwrap();
    assert!(svg.contains("model-predictive") && svg.contains("a tick of 50 ms"));
    let files: Vec<_> = fs::read_dir(test_folder.path().join("growth")).unwrap().collect();
    assert_eq!(files.len(), 2, "{files:?}");
}

/// A bench that empties caches between ticks relies on this.
#[test]
fn ticks_of_a_real_time_run_begin_at_whole_multiples_of_the_period() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "7")]);
    test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "3"]).wait().expect(0);
    let log = RunLog::open(&segments(&test_folder.run_folder())).unwrap();
    let scheduled: Vec<u64> =
        log.filter_map(|record| Some(record.unwrap().header()?.scheduled_ns % 7_000_000)).collect();
    assert!(!scheduled.is_empty() && scheduled.iter().all(|&rest| rest == 0), "{scheduled:?}");
}

#[test]
fn a_signal_ends_a_bench_and_leaves_nothing() {
    let test_folder = TestFolder::new();
    let mut process = test_folder.start(TECTUM, &["bench", "latency", "--seconds", "60", "--out", "lat"]);
    // The peer process of a bare transport is started from the same program.
    let peer = process.child_pid("tectum");
    let pid = process.id();
    process.signal("INT");
    let outcome = process.wait().expect(130);
    assert!(outcome.stdout.is_empty() && outcome.stderr.contains("ended by signal 2"), "{outcome:?}");
    assert!(has_ended(peer) && domains_of(pid).is_empty());
    assert!(!test_folder.path().join("lat").exists(), "a folder without results");
}

/// When a bench is killed while Tectum or a bare transport is measured, the other processes end.
#[test]
fn the_peer_process_ends_when_its_bench_is_killed() {
    let test_folder = TestFolder::new();
    let mut process = test_folder.start(TECTUM, &["bench", "lockstep", "--ticks", "60000", "--rounds", "1"]);
    // Any process of the first run will do: all of them watch their launcher's pidfd.
    let controller = process.child_pid("tectum-controller");
    process.signal("KILL");
    let mut waiting = test_folder.start("sleep", &["100"]);
    waiting.wait_until("the end of the run", || has_ended(controller));

    let mut process = test_folder.start(TECTUM, &["bench", "latency", "--seconds", "60"]);
    // The peer process of a bare transport is started from the same program.
    let peer = process.child_pid("tectum");
    let pid = process.id();
    signal_process(pid, "KILL");
    waiting.wait_until("the end of the other process", || has_ended(peer));
    // Its files in shared memory are unused now. The next run or `doctor --clean` removes them.
    waiting.wait_until("a clean /dev/shm", || {
        let _ = test_folder.start(TECTUM, &["doctor", "--clean", "--seconds", "0", "--json"]).wait();
        domains_of(pid).is_empty()
    });
}

#[test]
fn bad_input_is_refused_in_one_sentence() {
    let test_folder = TestFolder::new();
    test_folder.write_file("file", "");
    for (arguments, words) in [
        (&["latency", "--seconds", "0"][..], "--seconds"),
        (&["latency", "--seconds", "nan"], "--seconds"),
        (&["lockstep", "--ticks", "1"], "--ticks"),
        (&["encoder", "--batches", "0"], "--batches"),
        (&["growth", "--ticks", "7"], "--ticks"),
        (&["growth", "--seconds", "nan"], "--seconds"),
        (&["growth", "--log-ticks", "100"], "--log-ticks"),
        (&["encoder", "--batches", "1", "--out", "file"], "file"),
        (&["peer", "--over", "pigeon"], "iceoryx2-event"),
    ] {
        let outcome = bench(&test_folder, arguments).expect(2);
        assert!(outcome.stderr.contains(words) && outcome.stdout.is_empty(), "{arguments:?} {outcome:?}");
    }
    // The hidden command `peer` of a bench that was killed meanwhile, and so is not its parent any more.
    bench(&test_folder, &["peer", "--over", "iceoryx2-event", "--domain", "1", "--parent", "1"]).expect(0);
    // Started by hand it has no bench to answer.
    let outcome = bench(&test_folder, &["peer", "--over", "futex"]);
    assert!(outcome.code == Some(4) && outcome.stderr.contains("the other process of futex"), "{outcome:?}");
    for command in ["latency", "lockstep", "encoder", "learner", "growth", "all"] {
        let help = bench(&test_folder, &[command, "--help"]).expect(0).stdout;
        assert!(
            help.contains("Example") && help.contains(&format!("tectum bench {command}")) || command == "learner",
            "{help}"
        );
    }
}

//! `tectum bench`: each of its commands, shortly, with real processes. What is measured on a machine that other tests share is
//! worth nothing, so no test asserts a time; they assert that everything is there, adds up, and is gone afterwards.

mod support;

use std::fs;
use std::path::Path;

use serde_json::Value;
use support::{Outcome, Place, TECTUM, children, signal_process};
use tectum::log::{RunLog, segments};

const WAYS: [&str; 5] = ["iceoryx2-event", "iceoryx2-poll", "unix-socket", "pipe", "futex"];
const SERIES: [&str; 5] =
    ["scheduled_to_sensed", "sensed_to_command", "command_to_applied", "sensed_to_applied", "scheduled_to_applied"];

fn bench(place: &Place, arguments: &[&str]) -> Outcome {
    let mut all = vec!["bench"];
    all.extend(arguments);
    let process = place.start(TECTUM, &all);
    let pid = process.id();
    let outcome = process.wait();
    assert_eq!(domains_of(pid), Vec::<String>::new(), "left in /dev/shm: {outcome:#?}");
    assert!(children(pid).is_empty());
    outcome
}

/// The domains in shared memory that process `pid` has made.
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

/// Every series of every way: as many samples as ticks, percentiles in order, and the whole distribution in a file.
fn assert_latency(found: &Value, folder: &Path) {
    assert_machine(found);
    for way in list(found, "ways") {
        let (ticks, swallowed) = (number(way, "ticks"), number(way, "swallowed"));
        assert!(ticks > 0.0, "{way}");
        for series in SERIES {
            let p = &way[format!("{series}_us")];
            let values = ["p50", "p90", "p99", "p999", "max"].map(|q| number(p, q));
            // A histogram has three digits, and its largest value is told as it is.
            assert!(values.windows(2).all(|w| w[0] <= w[1] * 1.002) && values[0] >= 0.0, "{series} {way}");
            let count = number(p, "count");
            let expected = if series.starts_with("scheduled") { ticks + swallowed } else { ticks };
            assert!(count == expected || count < expected && series.contains("command"), "{series} {way}");
        }
        let files = list(way, "files");
        assert_eq!(files.len(), SERIES.len());
        for (file, series) in files.iter().zip(SERIES) {
            let text = fs::read_to_string(folder.join(file.as_str().unwrap())).unwrap();
            let total =
                text.lines().last().unwrap().rsplit_once('=').unwrap().1.trim_end_matches(']').trim().to_owned();
            assert_eq!(total.parse::<f64>().unwrap(), number(&way[format!("{series}_us")], "count"), "{text}");
        }
    }
    for ratio in list(found, "ratios") {
        assert!(WAYS.contains(&ratio["to"].as_str().unwrap()), "{ratio}");
        assert!(number(ratio, "p50") > 0.0 && number(ratio, "p99") > 0.0, "{ratio}");
    }
    assert!(!folder.join("block").exists(), "the runs are gone");
}

fn ways(found: &Value, caches: &str) -> Vec<String> {
    let these = list(found, "ways").iter().filter(|way| way["caches"] == caches);
    these.map(|way| way["way"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn latency_at_the_cadence_has_every_way_cold_and_warm() {
    let place = Place::new();
    let found = bench(&place, &["latency", "--seconds", "0.2", "--json", "--out", "lat"]).expect(0).json();
    let folder = place.path().join("lat");
    assert_latency(&found, &folder);
    let mut all = vec!["tectum"];
    all.extend(WAYS);
    assert_eq!(ways(&found, "usual"), all);
    for caches in ["cold", "warm"] {
        assert_eq!(ways(&found, caches), ["tectum", "iceoryx2-event"]);
    }
    assert_eq!((found["mode"].as_str(), number(&found, "period_ms")), (Some("cadence"), 50.0));
    // Each bare way in the same series and over its whole round trip, and event once more cold and warm.
    assert_eq!(list(&found, "ratios").len(), 2 * (WAYS.len() + 2));
    assert!(found["slowest_eviction_ms"].is_number());
    // A command of Tectum is applied at the next tick.
    let tectum = &list(&found, "ways")[0];
    assert!(number(&tectum["scheduled_to_applied_us"], "p50") >= 50_000.0, "{tectum}");
    let same: Value = serde_json::from_str(&fs::read_to_string(folder.join("latency.json")).unwrap()).unwrap();
    assert_eq!(same["ways"], found["ways"]);
}

#[test]
fn latency_back_to_back_has_every_way() {
    let place = Place::new();
    let found = bench(&place, &["latency", "--mode", "saturated", "--seconds", "0.1", "--json", "--out", "sat"])
        .expect(0)
        .json();
    assert_latency(&found, &place.path().join("sat"));
    assert_eq!(ways(&found, "usual").len(), WAYS.len() + 1);
    assert_eq!(list(&found, "ratios").len(), WAYS.len());
    assert!(found["period_ms"].is_null() && found["slowest_eviction_ms"].is_null());
    let tectum = &list(&found, "ways")[0];
    assert!(number(tectum, "ticks") > 1000.0 && number(tectum, "missed") == 0.0, "{tectum}");
}

#[test]
fn lockstep_stands_beside_bare_iceoryx2() {
    let place = Place::new();
    let asked = ["lockstep", "--ticks", "20000", "--rounds", "2", "--json", "--out", "lock"];
    let found = bench(&place, &asked).expect(0).json();
    assert_machine(&found);
    let cases = list(&found, "cases");
    assert_eq!(cases.len(), 4);
    for (i, case) in cases.iter().enumerate() {
        assert_eq!(list(case, "blocks").len(), 2);
        assert!(number(&case["per_second"], "median") > 0.0 && !list(case, "cores").is_empty(), "{case}");
        assert_eq!(case["share_of_bare"].is_null(), i == 3, "{case}");
        assert_eq!(case["usage"].is_object(), i < 2, "{case}");
    }
    // Of each round by itself.
    let rates = |i: usize| list(&cases[i], "blocks").iter().map(|x| x.as_f64().unwrap()).collect::<Vec<_>>();
    let shares: Vec<f64> = rates(0).iter().zip(rates(3)).map(|(ours, bare)| ours / bare).collect();
    let least = shares.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((number(&cases[0]["share_of_bare"], "min") - least).abs() < 1e-9);
    assert!(place.path().join("lock/lockstep.json").exists() && !place.path().join("lock/block").exists());
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
fn encoder_and_learner_have_every_version_on_every_path() {
    let place = Place::new();
    let found = bench(&place, &["encoder", "--batches", "2", "--json", "--out", "enc"]).expect(0).json();
    assert_costs(&found, 2);
    let versions: Vec<_> = list(&found, "costs").iter().map(|c| c["version"].as_str().unwrap()).collect();
    let mut expected = vec!["naive".to_owned(), "separable".to_owned(), "scalar twin".to_owned()];
    expected.extend(paths().iter().map(|path| format!("final, {path}")));
    assert_eq!(versions, expected);
    let csv = fs::read_to_string(place.path().join("enc/encoder.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + list(&found, "costs").len() + list(&found, "growth").len());

    let found = bench(&place, &["learner", "--batches", "2", "--json", "--out", "learn"]).expect(0).json();
    assert_costs(&found, 2);
    let what: Vec<_> = list(&found, "costs").iter().map(|c| c["what"].as_str().unwrap()).collect();
    for rule in ["paper", "baseline", "actor-critic", "natural-actor-critic", "learned-reward"] {
        for part in ["learn, encode, act", "whole tick, with plant"] {
            assert!(what.contains(&format!("{rule}: {part}").as_str()), "{rule} {part}: {what:?}");
        }
    }
}

#[test]
fn all_of_it_is_a_page_with_figures_and_numbers() {
    let place = Place::new();
    let small = ["--seconds", "0.1", "--ticks", "20000", "--rounds", "1", "--batches", "2"];
    let found = bench(&place, &[&["all", "--report", "page", "--json"][..], &small].concat()).expect(0).json();
    let folder = place.path().join("page");
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

/// A bench that empties caches between ticks must know when they begin.
#[test]
fn ticks_of_a_real_time_run_begin_at_whole_multiples_of_the_period() {
    let place = Place::new();
    let scenario = place.arm(&[("every", "1"), ("period_ms", "7")]);
    place.run(&[&scenario, "--mode", "realtime", "--ticks", "3"]).wait().expect(0);
    let log = RunLog::open(&segments(&place.run_folder())).unwrap();
    let scheduled: Vec<u64> =
        log.filter_map(|record| Some(record.unwrap().header()?.scheduled_ns % 7_000_000)).collect();
    assert!(!scheduled.is_empty() && scheduled.iter().all(|&rest| rest == 0), "{scheduled:?}");
}

/// Waits until the bench has started the other process of a bare way; gives its id.
fn peer_of(bench: &mut support::Process) -> u32 {
    let mut peer = None;
    let parent = bench.id();
    bench.until("the other process", || {
        peer = children(parent).into_iter().find(|(_, name)| name == "tectum").map(|(pid, _)| pid);
        peer.is_some()
    });
    peer.unwrap()
}

fn gone(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).map_or(true, |stat| stat.contains(") Z "))
}

#[test]
fn a_signal_ends_it_and_nothing_is_left() {
    let place = Place::new();
    let mut process = place.start(TECTUM, &["bench", "latency", "--seconds", "60", "--out", "lat"]);
    let peer = peer_of(&mut process);
    let pid = process.id();
    process.signal("INT");
    let outcome = process.wait().expect(130);
    assert!(outcome.stdout.is_empty() && outcome.stderr.contains("ended by signal 2"), "{outcome:?}");
    assert!(gone(peer) && domains_of(pid).is_empty());
    assert!(!place.path().join("lat").exists(), "a folder without results");
}

/// Killed while each of the ways has its turn, the other process ends by itself.
#[test]
fn the_other_process_does_not_outlive_a_bench_that_is_killed() {
    let place = Place::new();
    let mut process = place.start(TECTUM, &["bench", "lockstep", "--ticks", "400000", "--rounds", "1"]);
    // Any member of its first run will do: all of them follow their launcher's pidfd.
    let member = process.member("tectum-controller");
    process.signal("KILL");
    let mut waiting = place.start("sleep", &["100"]);
    waiting.until("the end of the run", || gone(member));

    let mut process = place.start(TECTUM, &["bench", "latency", "--seconds", "60"]);
    let peer = peer_of(&mut process);
    let pid = process.id();
    signal_process(pid, "KILL");
    waiting.until("the end of the other process", || gone(peer));
    // What it held in shared memory has nobody any more, and goes with the next run or `doctor --clean`.
    waiting.until("a clean /dev/shm", || {
        let _ = place.start(TECTUM, &["doctor", "--clean", "--seconds", "0", "--json"]).wait();
        domains_of(pid).is_empty()
    });
}

#[test]
fn bad_input_is_told_in_a_sentence() {
    let place = Place::new();
    place.file("file", "");
    for (arguments, words) in [
        (&["latency", "--seconds", "0"][..], "--seconds"),
        (&["latency", "--seconds", "nan"], "--seconds"),
        (&["lockstep", "--ticks", "1"], "--ticks"),
        (&["encoder", "--batches", "0"], "--batches"),
        (&["encoder", "--batches", "1", "--out", "file"], "file"),
        (&["peer", "--over", "pigeon"], "iceoryx2-event"),
    ] {
        let outcome = bench(&place, arguments).expect(2);
        assert!(outcome.stderr.contains(words) && outcome.stdout.is_empty(), "{arguments:?} {outcome:?}");
    }
    // The hidden one, started by hand, has nobody to answer.
    let outcome = bench(&place, &["peer", "--over", "futex"]);
    assert!(outcome.code == Some(4) && outcome.stderr.contains("the other process of futex"), "{outcome:?}");
    for command in ["latency", "lockstep", "encoder", "learner", "all"] {
        let help = bench(&place, &[command, "--help"]).expect(0).stdout;
        assert!(
            help.contains("Example") && help.contains(&format!("tectum bench {command}")) || command == "learner",
            "{help}"
        );
    }
}

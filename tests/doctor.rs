//! `tectum doctor`, what is left of a killed launcher, and the real-time set-up: with real processes, on a machine that
//! other tests' runs share. So every test looks at its own domain alone, and no test asserts how late anything was.

mod support;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use support::{Outcome, Place, Process, TECTUM, assert_no_debris};

fn doctor(place: &Place, arguments: &[&str]) -> Outcome {
    let mut all = vec!["doctor", "--seconds", "0", "--json"];
    all.extend(arguments);
    place.start(TECTUM, &all).wait()
}

/// The name of the domain of the run in `place`.
fn domain(place: &Place) -> String {
    let manifest: Value =
        serde_json::from_str(&fs::read_to_string(place.run_folder().join("run.json")).unwrap()).unwrap();
    format!("tectum_{}", manifest["domain"].as_str().unwrap())
}

/// What the doctor's `list` says of a domain.
fn of<'a>(found: &'a Value, list: &str, domain: &str) -> Option<&'a Value> {
    found[list].as_array().unwrap().iter().find(|entry| entry["domain"] == domain)
}

fn left(domain: &str) -> bool {
    let names = fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.file_name().to_string_lossy().into_owned());
    names.into_iter().any(|name| name.starts_with(domain))
}

/// A run that ticks and does not end by itself.
fn endless(place: &Place, mode: &str) -> Process {
    let scenario = place.endless(mode);
    let mut run = place.run(&[&scenario, "--mode", mode, "--json"]);
    run.until_ticking();
    run
}

fn gone(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).map_or(true, |stat| stat.contains(") Z "))
}

#[test]
fn the_report_has_every_check_with_verdict_and_remedy() {
    let place = Place::new();
    let outcome = place.start(TECTUM, &["doctor", "--seconds", "1", "--json"]).wait();
    let found = outcome.json();
    let checks = found["checks"].as_array().unwrap();
    let names: Vec<_> = checks.iter().map(|check| check["name"].as_str().unwrap()).collect();
    let expected = [
        "kernel",
        "real-time priority",
        "real-time share",
        "locked memory",
        "frequency governor",
        "clock source",
        "cores",
        "load",
        "huge pages",
        "swap",
        "shared memory",
        "disk",
        "debris of runs",
        "wake-up lateness",
    ];
    assert_eq!(names, expected);
    for check in checks {
        let fine = check["verdict"] == "fine";
        assert!(fine || check["verdict"] == "could-be-better" || check["verdict"] == "problem", "{check}");
        assert!(check["found"].as_str().is_some_and(|found| !found.is_empty()), "{check}");
        assert_eq!(check["remedy"].is_null(), fine, "{check}");
    }
    // The exit code is the verdict.
    let problem = checks.iter().any(|check| check["verdict"] == "problem");
    assert_eq!((outcome.code, found["verdict"] == "problem"), (Some(i32::from(problem)), problem), "{found}");

    let lateness = &found["wake_up_lateness"];
    assert_eq!((lateness["seconds"].as_u64(), lateness["period_ms"].as_f64()), (Some(1), Some(5.0)));
    assert_eq!(lateness["ordinary_us"]["count"], 200);
    let fifo = &lateness["fifo_us"];
    assert_eq!(fifo.is_null(), lateness["refused"].is_string(), "measured, or the reason why not: {lateness}");
    assert!(fifo.is_null() || fifo["count"] == 200, "{lateness}");
    assert!(found["domains"].is_array() && found["removed"].as_array().unwrap().is_empty());

    // For people, the same; nothing is measured where nothing is wanted.
    let text = place.start(TECTUM, &["doctor", "--seconds", "0"]).wait().stdout;
    assert!(expected[..13].iter().all(|name| text.contains(name)) && !text.contains("wake-up lateness"), "{text}");
    place.start(TECTUM, &["doctor", "--seconds", "3601"]).wait().expect(2);
}

/// A launcher that is killed leaves its domain. While its processes use it, it is left alone, whoever cleans up; then the
/// next run or the doctor removes it. A run that lives meanwhile comes to its end.
#[test]
fn what_a_killed_launcher_left_is_named_and_removed_and_the_living_are_left_alone() {
    let alive = Place::new();
    let mut living = endless(&alive, "lockstep");
    for by_run in [false, true] {
        let place = Place::new();
        let scenario = place.endless("realtime");
        let mut run = place.run(&[&scenario, "--mode", "realtime", "--by-hand", "controller"]);
        let manifest = place.run_folder().join("run.json");
        run.until("the run's manifest", || fs::read_to_string(&manifest).is_ok_and(|text| text.trim().ends_with('}')));
        // By hand, because a stopped child of a launcher that dies is hung up by the kernel, and ends.
        let controller = place.start(env!("CARGO_BIN_EXE_tectum-controller"), &["--run", "run"]);
        run.until_ticking();
        let members = ["tectum-simulator", "tectum-logger"].map(|program| run.member(program));
        let domain = domain(&place);
        let found = doctor(&place, &[]).json();
        assert_eq!(of(&found, "domains", &domain).unwrap()["pid"], run.id(), "{found}");

        // A process that cannot notice that its launcher is gone: the domain is used.
        controller.signal("STOP");
        run.signal("KILL");
        assert_eq!(run.wait().code, None);
        let found = doctor(&place, &["--clean"]).json();
        let entry = of(&found, "domains", &domain).unwrap_or_else(|| panic!("removed while in use: {found}"));
        assert_eq!(entry["owner"], "processes", "{found}");
        assert!(entry["pids"].as_array().unwrap().contains(&controller.id().into()), "{found}");
        let check = found["checks"].as_array().unwrap().iter().find(|c| c["name"] == "debris of runs").unwrap();
        assert_eq!(check["verdict"], "could-be-better");
        assert!(check["remedy"].as_str().unwrap().contains("kill "), "{check}");

        controller.signal("CONT");
        controller.wait().expect(4);
        let began = Instant::now();
        while !members.iter().all(|&pid| gone(pid)) {
            assert!(began.elapsed() < Duration::from_secs(60), "orphans");
            std::thread::yield_now();
        }
        // Any run or doctor on this machine may remove it from here on: what counts is that it is gone after ours.
        let named = doctor(&place, &[]).json();
        assert!(of(&named, "domains", &domain).is_none_or(|entry| entry["owner"] == "nobody"), "{named}");
        if by_run {
            let next = Place::new();
            let scenario = next.arm(&[]);
            let outcome = next.run(&[&scenario, "--ticks", "50"]).wait().expect(0);
            assert!(outcome.stderr.is_empty() || outcome.stderr.contains("which a run that was killed had left"));
        } else {
            let cleaned = doctor(&place, &["--clean"]);
            assert!(matches!(cleaned.code, Some(0 | 1)), "{cleaned:?}");
            let cleaned = cleaned.json();
            assert!(of(&cleaned, "domains", &domain).is_none(), "{cleaned}");
            // Said, unless somebody else was quicker.
            assert!(of(&cleaned, "removed", &domain).is_none_or(|entry| entry["files"].as_u64() > Some(10)));
        }
        assert!(!left(&domain), "by a run: {by_run}");
        let found = doctor(&alive, &["--clean"]).json();
        let entry = of(&found, "domains", &self::domain(&alive)).expect("a living run is never touched");
        assert_eq!((&entry["owner"], &entry["pid"]), (&"launcher".into(), &living.id().into()), "{found}");
    }
    living.until_ticking();
    living.signal("INT");
    let summary = living.wait().expect(130).json();
    assert!(summary["weights_hash"].is_string() && summary["lost"] == 0, "{summary}");
    assert_no_debris(&alive.run_folder());
}

/// Policy and priority of a process as the kernel has it.
fn scheduling(pid: u32) -> (u32, u32) {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<_> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
    (fields[38].parse().unwrap(), fields[37].parse().unwrap())
}

fn realtime_report(place: &Place, role: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(place.run_folder().join(format!("{role}.realtime.json"))).unwrap())
        .unwrap()
}

const ASKED: &str = "
[realtime.plant]
priority = 7
cores = [0, 1023]
lock_memory = true
prefault_stack_kib = 256
";

/// What is said to hold holds, and what is refused is said: at the start, at the end and in the log.
#[test]
fn the_real_time_set_up_is_what_the_summary_says() {
    let place = Place::new();
    let scenario = place.endless("realtime");
    let text = fs::read_to_string(&scenario).unwrap() + ASKED;
    fs::write(&scenario, text).unwrap();
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--json"]);
    let (plant, logger) = (run.member("tectum-simulator"), run.member("tectum-logger"));
    run.until_ticking();

    let report = realtime_report(&place, "plant");
    let held = &report["held"];
    let refused: Vec<_> = report["refused"].as_array().unwrap().iter().map(|r| r["what"].as_str().unwrap()).collect();
    // The processes themselves, by the kernel's own account.
    match refused.contains(&"priority = 7") {
        false => assert_eq!((scheduling(plant), &held["scheduler"]), ((1, 7), &"fifo".into())),
        true => assert_eq!((scheduling(plant), &held["priority"]), ((0, 0), &0.into())),
    }
    assert_eq!(scheduling(logger), (0, 0), "asked for nothing");
    let status = fs::read_to_string(format!("/proc/{plant}/status")).unwrap();
    let row = |key: &str| status.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(":\t")).unwrap().trim();
    assert_eq!((row("Cpus_allowed_list"), &held["cores"]), ("0", &serde_json::json!([0])));
    let kib = |key: &str| row(key).trim_end_matches(" kB").parse::<u64>().unwrap();
    assert!(refused.contains(&"lock_memory") || kib("VmLck") > 1000, "{status}");
    assert!(kib("VmStk") >= 256, "{status}");
    // A core that no machine of ours has.
    assert!(refused.contains(&"cores = [1023]"), "{report}");

    run.signal("INT");
    let outcome = run.wait().expect(130);
    for refusal in report["refused"].as_array().unwrap() {
        let (what, remedy) = (refusal["what"].as_str().unwrap(), refusal["remedy"].as_str().unwrap());
        let warning = format!("tectum: warning: the plant asked for {what} and does not have it (");
        assert!(outcome.stderr.contains(&warning) && outcome.stderr.contains(remedy), "{outcome:#?}");
    }
    let summary = outcome.json();
    let realtime = summary["realtime"].as_array().unwrap();
    let processes: Vec<_> = realtime.iter().map(|r| r["process"].as_str().unwrap()).collect();
    assert_eq!(processes, ["plant", "controller", "logger"]);
    for process in realtime {
        let report = realtime_report(&place, process["process"].as_str().unwrap());
        for key in ["asked", "held", "refused"] {
            assert_eq!(process[key], report[key]);
        }
        assert!(process["held"]["timer_slack_ns"].as_u64() <= Some(1), "{process}");
    }
    let log = tectum::log::LogReader::open(&place.run_folder().join("log.mcap")).unwrap();
    let header = &log.metadata()["tectum.run"];
    assert_eq!(serde_json::from_str::<Value>(&header["realtime.plant"]).unwrap(), report);
    assert!(header.contains_key("realtime.controller") && header.contains_key("realtime.logger"));
    assert_no_debris(&place.run_folder());
}

/// Without the right to it, the run goes on under the ordinary scheduler, and says so.
#[test]
fn a_priority_that_is_not_allowed_degrades_loudly() {
    let setpriv = Path::new("/usr/bin/setpriv");
    if !setpriv.exists() {
        // Nothing to take the right away with; the unit tests look at either case.
        return;
    }
    let place = Place::new();
    let scenario = place.arm(&[("period_ms", "5")]);
    let text = fs::read_to_string(&scenario).unwrap() + "\n[realtime.controller]\npriority = 7\nlock_memory = true\n";
    fs::write(&scenario, text).unwrap();
    let without =
        ["--bounding-set=-sys_nice,-ipc_lock", "--inh-caps=-sys_nice,-ipc_lock", "--", "prlimit", "--rtprio=0"];
    let mut arguments = without.to_vec();
    arguments.extend([TECTUM, "run", "--out", "run", &scenario, "--mode", "realtime", "--ticks", "40"]);
    let outcome = place.start(setpriv, &arguments).wait();
    if outcome.stderr.starts_with("setpriv: ") {
        // Not root: a right that nobody has cannot be taken away.
        return;
    }
    let outcome = outcome.expect(0);
    assert!(outcome.stderr.contains("the controller asked for priority = 7 and does not have it"), "{outcome:#?}");
    assert!(outcome.stderr.contains("rtprio 7") && outcome.stderr.contains("setcap"), "{outcome:#?}");
    let report = realtime_report(&place, "controller");
    assert_eq!((&report["held"]["scheduler"], &report["held"]["priority"]), (&"other".into(), &0.into()));
    let line = outcome.stdout.lines().find(|line| line.starts_with("real time, controller")).unwrap();
    assert!(line.contains("scheduler other") && line.contains("refused: ") && line.contains("priority = 7"), "{line}");
}

/// In lockstep nothing is asked for: the numbers are the same on every machine, and so is what is left.
#[test]
fn lockstep_asks_for_nothing() {
    let place = Place::new();
    let scenario = place.arm(&[]);
    let text = fs::read_to_string(&scenario).unwrap() + ASKED;
    fs::write(&scenario, text).unwrap();
    let outcome = place.run(&[&scenario, "--ticks", "50", "--json"]).wait().expect(0);
    assert_eq!(outcome.json()["realtime"], serde_json::json!([]));
    assert!(!place.run_folder().join("plant.realtime.json").exists());
}

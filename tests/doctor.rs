//! `tectum doctor`, the domain of a killed launcher, and the real-time set-up, with real processes. Other tests share
//! the machine. So every test checks only its own domain, and no test asserts a lateness.

mod support;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use support::{
    Process, ProcessOutcome, TECTUM, TestFolder, append, assert_no_debris, domain, has_ended, read_json, shared_memory,
};

fn doctor(test_folder: &TestFolder, arguments: &[&str]) -> ProcessOutcome {
    let mut all = vec!["doctor", "--seconds", "0", "--json"];
    all.extend(arguments);
    test_folder.start(TECTUM, &all).wait()
}

/// The entry of a domain in one of the doctor's lists.
fn entry_of<'a>(found: &'a Value, list: &str, domain: &str) -> Option<&'a Value> {
    found[list].as_array().unwrap().iter().find(|entry| entry["domain"] == domain)
}

/// Starts a run that does not end by itself, and waits until it ticks.
fn endless(test_folder: &TestFolder, mode: &str) -> Process {
    let scenario = test_folder.endless_scenario(mode);
    let mut run = test_folder.run(&[&scenario, "--mode", mode, "--json"]);
    run.wait_until_ticking();
    run
}

#[test]
fn the_report_has_every_check_with_verdict_and_remedy() {
    let test_folder = TestFolder::new();
    let outcome = test_folder.start(TECTUM, &["doctor", "--seconds", "1", "--json"]).wait();
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
        "memory at logout",
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
    // The exit code follows from the verdict.
    let problem = checks.iter().any(|check| check["verdict"] == "problem");
    assert_eq!((outcome.code, found["verdict"] == "problem"), (Some(i32::from(problem)), problem), "{found}");

    let lateness = &found["wake_up_lateness"];
    assert_eq!((lateness["seconds"].as_u64(), lateness["period_ms"].as_f64()), (Some(1), Some(5.0)));
    assert_eq!(lateness["ordinary_us"]["count"], 200);
    let fifo = &lateness["fifo_us"];
    assert_eq!(fifo.is_null(), lateness["refused"].is_string(), "measured, or the reason why not: {lateness}");
    assert!(fifo.is_null() || fifo["count"] == 200, "{lateness}");
    assert!(found["domains"].is_array() && found["removed"].as_array().unwrap().is_empty());

    // The text output has the same checks. With 0 seconds nothing is measured.
    let text = test_folder.start(TECTUM, &["doctor", "--seconds", "0"]).wait().stdout;
    assert!(expected[..14].iter().all(|name| text.contains(name)) && !text.contains("wake-up lateness"), "{text}");
    test_folder.start(TECTUM, &["doctor", "--seconds", "3601"]).wait().expect(2);
}

/// Requires that the doctor does not remove a domain without launcher that process `pid` uses.
fn check_domain_in_use(test_folder: &TestFolder, domain: &str, pid: u32) {
    let found = doctor(test_folder, &["--clean"]).json();
    let entry = entry_of(&found, "domains", domain).unwrap_or_else(|| panic!("removed while in use: {found}"));
    assert_eq!(entry["owner"], "processes", "{found}");
    assert!(entry["pids"].as_array().unwrap().contains(&pid.into()), "{found}");
    let check = found["checks"].as_array().unwrap().iter().find(|c| c["name"] == "debris of runs").unwrap();
    assert_eq!(check["verdict"], "could-be-better");
    assert!(check["remedy"].as_str().unwrap().contains("kill "), "{check}");
}

/// Requires that the next run, or the doctor, removes an unused domain. Any run or doctor on this machine may remove it
/// first; it must be gone after ours.
fn check_removal(test_folder: &TestFolder, domain: &str, by_run: bool) {
    let named = doctor(test_folder, &[]).json();
    assert!(entry_of(&named, "domains", domain).is_none_or(|entry| entry["owner"] == "nobody"), "{named}");
    if by_run {
        let next = TestFolder::new();
        let scenario = next.arm_scenario(&[]);
        let outcome = next.run(&[&scenario, "--ticks", "50"]).wait().expect(0);
        assert!(outcome.stderr.is_empty() || outcome.stderr.contains("which a run that was killed had left"));
    } else {
        let cleaned = doctor(test_folder, &["--clean"]);
        assert!(matches!(cleaned.code, Some(0 | 1)), "{cleaned:?}");
        let cleaned = cleaned.json();
        assert!(entry_of(&cleaned, "domains", domain).is_none(), "{cleaned}");
        // The removal is reported, unless another process was quicker.
        assert!(entry_of(&cleaned, "removed", domain).is_none_or(|entry| entry["files"].as_u64() > Some(10)));
    }
}

/// A killed launcher leaves its domain. It is not removed while processes use it. After that, the next run or the
/// doctor removes it. The domain of another run that is active meanwhile is never touched.
#[test]
fn only_the_unused_domain_of_a_killed_launcher_is_removed() {
    let other_folder = TestFolder::new();
    let mut other_run = endless(&other_folder, "lockstep");
    for by_run in [false, true] {
        let test_folder = TestFolder::new();
        let scenario = test_folder.endless_scenario("realtime");
        let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--by-hand", "controller"]);
        let manifest = test_folder.run_folder().join("run.json");
        run.wait_until("the run's manifest", || {
            fs::read_to_string(&manifest).is_ok_and(|text| text.trim().ends_with('}'))
        });
        // The controller is started by hand: the kernel would end a stopped child of a launcher that dies.
        let controller = test_folder.start(env!("CARGO_BIN_EXE_tectum-controller"), &["--run", "run"]);
        run.wait_until_ticking();
        let children = ["tectum-simulator", "tectum-logger"].map(|program| run.child_pid(program));
        let domain = domain(test_folder.run_folder());
        let found = doctor(&test_folder, &[]).json();
        assert_eq!(entry_of(&found, "domains", &domain).unwrap()["pid"], run.id(), "{found}");

        // A stopped process cannot notice that its launcher is gone. It still uses the domain.
        controller.signal("STOP");
        run.signal("KILL");
        assert_eq!(run.wait().code, None);
        check_domain_in_use(&test_folder, &domain, controller.id());

        controller.signal("CONT");
        controller.wait().expect(4);
        let began = Instant::now();
        while !children.iter().all(|&pid| has_ended(pid)) {
            assert!(began.elapsed() < Duration::from_secs(60), "processes outlived their launcher");
            std::thread::yield_now();
        }
        check_removal(&test_folder, &domain, by_run);
        assert!(shared_memory(&domain).is_empty(), "by a run: {by_run}");
        let found = doctor(&other_folder, &["--clean"]).json();
        let entry = entry_of(&found, "domains", &support::domain(other_folder.run_folder()))
            .expect("an active run is never touched");
        assert_eq!((&entry["owner"], &entry["pid"]), (&"launcher".into(), &other_run.id().into()), "{found}");
    }
    other_run.wait_until_ticking();
    other_run.signal("INT");
    let summary = other_run.wait().expect(130).json();
    assert!(summary["weights_hash"].is_string() && summary["lost"] == 0, "{summary}");
    assert_no_debris(other_folder.run_folder());
}

/// Scheduling policy and priority of a process, from the kernel.
fn scheduling(pid: u32) -> (u32, u32) {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<_> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
    (fields[38].parse().unwrap(), fields[37].parse().unwrap())
}

/// A process's report of its real-time set-up.
fn realtime_report(test_folder: &TestFolder, role: &str) -> Value {
    read_json(test_folder.run_folder().join(format!("{role}.realtime.json")))
}

/// A real-time set-up of the plant. No test machine has core 1023.
const REQUESTED: &str = "
[realtime.plant]
priority = 7
cores = [0, 1023]
lock_memory = true
prefault_stack_kib = 256
";

/// The reported set-up is the one that the kernel has. Refusals are reported at the start, at the end and in the log.
#[test]
fn the_summary_reports_the_real_time_set_up_that_holds() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.endless_scenario("realtime");
    append(&scenario, REQUESTED);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--json"]);
    let (plant, logger) = (run.child_pid("tectum-simulator"), run.child_pid("tectum-logger"));
    run.wait_until_ticking();

    let report = realtime_report(&test_folder, "plant");
    let held = &report["held"];
    let refused: Vec<_> = report["refused"].as_array().unwrap().iter().map(|r| r["what"].as_str().unwrap()).collect();
    // The kernel reports the processes' policies.
    match refused.contains(&"priority = 7") {
        false => assert_eq!((scheduling(plant), &held["scheduler"]), ((1, 7), &"fifo".into())),
        true => assert_eq!((scheduling(plant), &held["priority"]), ((0, 0), &0.into())),
    }
    assert_eq!(scheduling(logger), (0, 0), "the logger requested nothing");
    let status = fs::read_to_string(format!("/proc/{plant}/status")).unwrap();
    let row = |key: &str| status.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(":\t")).unwrap().trim();
    assert_eq!((row("Cpus_allowed_list"), &held["cores"]), ("0", &serde_json::json!([0])));
    let kib = |key: &str| row(key).trim_end_matches(" kB").parse::<u64>().unwrap();
    assert!(refused.contains(&"lock_memory") || kib("VmLck") > 1000, "{status}");
    assert!(kib("VmStk") >= 256, "{status}");
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
        let report = realtime_report(&test_folder, process["process"].as_str().unwrap());
        for key in ["asked", "held", "refused"] {
            assert_eq!(process[key], report[key]);
        }
        assert!(process["held"]["timer_slack_ns"].as_u64() <= Some(1), "{process}");
    }
    let log = tectum::log::LogReader::open(&test_folder.log_path()).unwrap();
    let header = &log.metadata()["tectum.run"];
    assert_eq!(serde_json::from_str::<Value>(&header["realtime.plant"]).unwrap(), report);
    assert!(header.contains_key("realtime.controller") && header.contains_key("realtime.logger"));
    assert_no_debris(test_folder.run_folder());
}

/// Without permission for a priority, the run continues under the ordinary scheduler and warns.
#[test]
fn a_refused_priority_causes_a_warning_and_the_run_continues() {
    let setpriv = Path::new("/usr/bin/setpriv");
    if !setpriv.exists() {
        // The permission cannot be removed without setpriv; the unit tests cover both cases.
        return;
    }
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("period_ms", "5")]);
    append(&scenario, "\n[realtime.controller]\npriority = 7\nlock_memory = true\n");
    let setpriv_arguments =
        ["--bounding-set=-sys_nice,-ipc_lock", "--inh-caps=-sys_nice,-ipc_lock", "--", "prlimit", "--rtprio=0"];
    let mut arguments = setpriv_arguments.to_vec();
    arguments.extend([TECTUM, "run", "--out", "run", &scenario, "--mode", "realtime", "--ticks", "40"]);
    let outcome = test_folder.start(setpriv, &arguments).wait();
    if outcome.stderr.starts_with("setpriv: ") {
        // Without root, permissions cannot be removed.
        return;
    }
    let outcome = outcome.expect(0);
    assert!(outcome.stderr.contains("the controller asked for priority = 7 and does not have it"), "{outcome:#?}");
    assert!(outcome.stderr.contains("rtprio 7") && outcome.stderr.contains("setcap"), "{outcome:#?}");
    let report = realtime_report(&test_folder, "controller");
    assert_eq!((&report["held"]["scheduler"], &report["held"]["priority"]), (&"other".into(), &0.into()));
    let line = outcome.stdout.lines().find(|line| line.starts_with("real time, controller")).unwrap();
    assert!(line.contains("scheduler other") && line.contains("refused: ") && line.contains("priority = 7"), "{line}");
}

/// In lockstep no real-time set-up is requested, so that a run is the same on every machine.
#[test]
fn lockstep_requests_no_real_time_set_up() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    append(&scenario, REQUESTED);
    let outcome = test_folder.run(&[&scenario, "--ticks", "50", "--json"]).wait().expect(0);
    assert_eq!(outcome.json()["realtime"], serde_json::json!([]));
    assert!(!test_folder.run_folder().join("plant.realtime.json").exists());
}

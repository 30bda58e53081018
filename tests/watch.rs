//! `tectum watch` beside real runs: in a pseudo-terminal, as one object, four at once, and what it says to bad input.

mod support;

use support::terminal::TestTerminal;
use support::web_watcher::WebWatcher;
use support::{Process, TECTUM, TestFolder, WATCHDOG, domain, has_ended, program, read_json, shared_memory};
use tectum::clock::TerminationSignals;
use tectum::watch::{Follower, WatchTarget, watch_in_terminal};

/// A run in real time that lasts until the test ends it.
fn long_run(folder: &TestFolder) -> Process {
    let mut run = folder.run(&["arm", "--mode", "realtime", "--ticks", "100000", "--json"]);
    run.wait_until_ticking();
    run
}

#[track_caller]
fn wait_for(watcher: &mut Process, terminal: &TestTerminal, words: &[&str]) {
    let mut shown = String::new();
    let what = format!("{words:?} on the screen");
    watcher.wait_until(&what, || {
        shown = terminal.screen();
        words.iter().all(|word| shown.contains(word))
    });
}

fn end(run: Process) {
    run.signal("INT");
    run.wait().expect(130);
}

#[test]
fn the_terminal_shows_a_run_at_any_size_and_is_left_as_it_was() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    let terminal = TestTerminal::new([80, 24]);
    let before = format!("{:?}", terminal.settings());
    let mut watcher = terminal.start(&folder, &["watch", "run"], true);
    let words = ["run  real time, seed 1", "sensing", "slack", "running", "ticks/s", "missed", "q quit"];
    wait_for(&mut watcher, &terminal, &words);
    assert!(terminal.text().contains("\x1b[0;36m"), "no colour");
    terminal.resize([40, 30]);
    watcher.wait_until("a screen of 40 columns", || {
        let screen = terminal.screen();
        screen.contains("q quit")
            && screen.contains("processes")
            && screen.lines().all(|line| line.chars().count() <= 40)
    });
    terminal.press("?");
    wait_for(&mut watcher, &terminal, &["the run goes on"]);
    terminal.press("\x1b[A? ");
    wait_for(&mut watcher, &terminal, &["paused"]);
    terminal.press("q");
    watcher.wait().expect(0);
    terminal.assert_restored();
    assert_eq!(format!("{:?}", terminal.settings()), before);
    end(run);
    folder.assert_no_debris();
}

#[test]
fn whatever_ends_a_watcher_the_terminal_is_left_as_it_was() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    for (signal, keys, code) in [("TERM", "", 143), ("HUP", "", 129), ("QUIT", "", 131), ("", "\x03", 130)] {
        let terminal = TestTerminal::new([80, 24]);
        let mut watcher = terminal.start(&folder, &["watch", "run"], false);
        wait_for(&mut watcher, &terminal, &["q quit", "running"]);
        if keys.is_empty() {
            watcher.signal(signal);
        } else {
            terminal.press(keys);
        }
        watcher.wait().expect(code);
        terminal.assert_restored();
        let text = terminal.text();
        assert!(!text.contains("\x1b[0;3") && !text.contains("\x1b[0;1;3"), "colours in spite of NO_COLOR");
    }
    end(run);
}

/// The watcher of the next test. It panics once it has drawn a few screens of the run in the current folder.
#[test]
#[ignore = "the next test starts it in a terminal of its own"]
fn watcher_that_panics() {
    let signals = TerminationSignals::install().unwrap();
    let mut follower = Follower::open(WatchTarget::Named("run".into()), false).unwrap();
    let mut screens = 0;
    let end = watch_in_terminal(&mut follower, &signals, || {
        screens += 1;
        assert!(screens < 5, "a panic on purpose");
        false
    });
    unreachable!("{end:?}");
}

/// A panic leaves the terminal as it was, and before its message, which the alternate screen would take with it.
#[test]
fn a_panic_leaves_the_terminal_as_it_was_and_its_message_on_it() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    let terminal = TestTerminal::new([80, 24]);
    let before = format!("{:?}", terminal.settings());
    let program = std::env::current_exe().unwrap();
    let arguments = ["--exact", "watcher_that_panics", "--ignored", "--nocapture", "--test-threads", "1"];
    let watcher = terminal.start_program(program.to_str().unwrap(), &folder, &arguments, true);
    watcher.wait().expect(101);
    terminal.assert_restored();
    assert_eq!(format!("{:?}", terminal.settings()), before);
    let text = terminal.text();
    let (on_screen, after) = text.rsplit_once("\x1b[?1049l").unwrap();
    assert!(on_screen.contains("real time, seed 1"), "it drew no screen: {on_screen:?}");
    assert!(after.contains("a panic on purpose") && !on_screen.contains("on purpose"), "{after:?}");
    end(run);
}

#[test]
fn a_restart_the_end_and_the_next_run_appear() {
    let folder = TestFolder::new();
    let terminal = TestTerminal::new([100, 40]);
    let mut watcher = terminal.start(&folder, &["watch", "run", "--wait"], true);
    wait_for(&mut watcher, &terminal, &["Waiting for the run run."]);
    let mut run = long_run(&folder);
    wait_for(&mut watcher, &terminal, &["controller running"]);
    let killed = run.kill_child("tectum-controller");
    run.next_child_pid("tectum-controller", killed);
    let words = ["the controller is started again, start 2", "was killed by signal 9", "running  start 2"];
    wait_for(&mut watcher, &terminal, &words);
    end(run);
    wait_for(&mut watcher, &terminal, &["the run ended early"]);
    std::fs::remove_dir_all(folder.run_folder()).unwrap();
    let run = long_run(&folder);
    wait_for(&mut watcher, &terminal, &["controller running  pid"]);
    assert!(!terminal.screen().contains("ended early"), "{}", terminal.screen());
    terminal.press("q");
    watcher.wait().expect(0);
    end(run);
}

#[test]
fn one_object_has_the_numbers_of_now() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    let now = folder.tectum("watch", &["run", "--json"]).expect(0).json();
    assert!(now["tick"].as_u64().unwrap() > 0 && now["ended"].is_null(), "{now}");
    assert_eq!(
        (&now["processes"][1]["name"], &now["processes"][1]["state"]),
        (&"controller".into(), &"running".into())
    );
    let stages: Vec<_> = now["stages"].as_array().unwrap().iter().map(|stage| stage["us"]["p50"].as_f64()).collect();
    assert!(stages.iter().all(|p50| p50.is_some_and(|us| us >= 0.0)), "{now}");
    end(run);
}

#[test]
fn bad_input_is_one_sentence() {
    let folder = TestFolder::new();
    folder.run(&["arm", "--ticks", "50", "--json"]).wait().expect(0);
    let refusal = |arguments: &[&str]| folder.tectum("watch", arguments).refusal();
    let none = refusal(&["nowhere"]);
    assert!(none.contains("there is no run in nowhere: there is no such folder; ") && none.contains("alive"), "{none}");
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    let empty = refusal(&["empty"]);
    assert!(empty.contains("there is no run in empty: it has no run.json; "), "{empty}");
    std::fs::write(folder.path().join("empty/run.json"), "{}").unwrap();
    let other = refusal(&["empty"]);
    assert!(other.contains("its run.json is not one of a run: missing field"), "{other}");
    let over = refusal(&["run", "--wait", "--json"]);
    assert!(over.contains("the run in run is over") && over.contains("tectum film run"), "{over}");
    let run = long_run_in(&folder, "second");
    let blind = refusal(&["second"]);
    assert!(blind.contains("no terminal to draw on") && blind.contains("--web"), "{blind}");
    let address = refusal(&["second", "--web", "nonsense"]);
    assert!(address.contains("nonsense") && address.contains("port"), "{address}");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let taken = refusal(&["second", "--web", &port]);
    assert!(taken.contains("another program uses the port"), "{taken}");
    end(run);
}

fn long_run_in(folder: &TestFolder, name: &str) -> Process {
    let arguments = ["run", "arm", "--out", name, "--mode", "realtime", "--ticks", "100000", "--json"];
    let mut run = folder.start(TECTUM, &arguments);
    let path = folder.path().join(name).join("log.mcap");
    run.wait_until("the log of the second run", || path.exists());
    run
}

/// Four watchers, one of which is stopped while it watches: the run's result is the same to the last bit, nothing is
/// missed, and the run's part of shared memory has nothing that it does not have without them.
#[test]
fn four_watchers_of_which_one_is_stopped_change_nothing() {
    let folder = TestFolder::new();
    let alone = folder.start(TECTUM, &["run", "arm", "--ticks", "200", "--out", "alone", "--json"]);
    let alone = alone.wait().expect(0).json();
    // A run that waits for its logger, so that all watchers see it from its begin, however fast it is.
    let mut run = folder.run(&["arm", "--ticks", "200", "--by-hand", "logger", "--json"]);
    run.wait_until("the run's manifest", || folder.run_folder().join("run.json").exists());
    let files = || {
        let mut files = shared_memory(&domain(folder.run_folder()));
        files.sort();
        files
    };
    let terminals = [TestTerminal::new([80, 24]), TestTerminal::new([40, 30])];
    let mut watchers = terminals.each_ref().map(|terminal| terminal.start(&folder, &["watch", "run"], true));
    for (watcher, terminal) in watchers.iter_mut().zip(&terminals) {
        wait_for(watcher, terminal, &["plant      setting up", "controller setting up", "logger     waiting"]);
    }
    let before = files();
    let pages = [(); 2].map(|()| WebWatcher::start(&folder, &["run", "--web", "127.0.0.1:0"]));
    let mut events = pages.each_ref().map(|page| page.events("/events"));
    assert!(events.iter_mut().all(|events| events.next().unwrap()["kind"] == "hello"));
    assert_eq!(files(), before, "watchers leave files in shared memory");
    watchers[1].signal("STOP");
    let logger = folder.start(program("tectum-logger"), &["--run", "run"]);
    let summary = run.wait().expect(0).json();
    logger.wait().expect(0);
    for what in ["weights_hash", "missed", "late", "lost", "ticks"] {
        assert!(!summary[what].is_null() && summary[what] == alone[what], "{what}: {summary}\nand alone {alone}");
    }
    folder.assert_no_debris();
    wait_for(&mut watchers[0], &terminals[0], &["the run is over", "tick 200 of 200"]);
    let last = events[0].find(|event| !event["ended"].is_null()).unwrap();
    assert_eq!((&last["ended"], &last["tick"]), (&"the run is over".into(), &200.into()));
    watchers[1].signal("CONT");
    wait_for(&mut watchers[1], &terminals[1], &["the run is over"]);
    for watcher in watchers {
        watcher.signal("TERM");
        watcher.wait().expect(143);
    }
    pages.into_iter().for_each(WebWatcher::end);
}

#[test]
fn a_run_is_launched_and_watched_in_one() {
    let folder = TestFolder::new();
    let terminal = TestTerminal::new([80, 24]);
    let mut run = terminal.start(&folder, &["run", "--watch", "--out", "run", "--ticks", "4000"], true);
    wait_for(&mut run, &terminal, &["lockstep, seed 1", "running"]);
    run.wait().expect(0);
    terminal.assert_restored();
    assert!(terminal.text().rsplit("\x1b[?1049l").next().unwrap().contains("weights "), "no summary");

    std::fs::remove_dir_all(folder.run_folder()).unwrap();
    let terminal = TestTerminal::new([80, 24]);
    let arguments = ["run", "--watch", "--out", "run", "--mode", "realtime", "--ticks", "100000"];
    let mut run = terminal.start(&folder, &arguments, true);
    wait_for(&mut run, &terminal, &["real time, seed 1", "controller running"]);
    terminal.press("q");
    run.wait_until("the shell's screen", || terminal.text().contains("the run goes on; Ctrl-C ends it"));
    terminal.press("\x03");
    run.wait().expect(130);
    terminal.assert_restored();
    folder.assert_no_debris();

    let refusal = folder.tectum("run", &["--watch"]).refusal();
    assert!(refusal.contains("no terminal to draw on"), "{refusal}");
}

/// A watcher that is killed cannot leave a run behind that nobody sees.
#[test]
fn a_run_that_is_launched_and_watched_ends_with_its_watcher() {
    let folder = TestFolder::new();
    let terminal = TestTerminal::new([80, 24]);
    let arguments = ["run", "--watch", "--out", "run", "--mode", "realtime", "--ticks", "100000"];
    let mut watcher = terminal.start(&folder, &arguments, true);
    wait_for(&mut watcher, &terminal, &["controller running"]);
    let launcher = read_json(folder.run_folder().join("run.json"))["launcher"].as_u64().unwrap() as u32;
    watcher.signal("KILL");
    let began = std::time::Instant::now();
    while !has_ended(launcher) {
        assert!(began.elapsed() < WATCHDOG, "the launcher goes on");
        std::thread::park_timeout(std::time::Duration::from_millis(5));
    }
    folder.assert_no_debris();
}

#[test]
fn without_a_terminal_a_line_comes_every_ten_seconds() {
    let folder = TestFolder::new();
    let outcome = folder.run(&["arm", "--mode", "realtime", "--ticks", "230", "--json"]).wait().expect(0);
    let line = outcome.stderr.lines().find(|line| line.contains(" of 230 ticks")).unwrap_or_default();
    assert!(line.starts_with("tectum: arm  ") && line.contains(" left  ") && !line.contains('\x1b'), "{outcome:#?}");
}

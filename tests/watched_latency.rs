//! What watchers cost the run that they watch: blocks of the same run, in turns with four watchers and with none. Two
//! watchers draw in terminals, one of which is stopped while it watches; two serve a page to a reader each.
//!
//! ```text
//! cargo test --release --test watched_latency -- --ignored --nocapture
//! ```
//!
//! The result is the same to the last bit, and nothing is missed. Latencies are printed: other programs on the machine
//! decide about them, too.

mod support;

use serde_json::Value;
use support::terminal::TestTerminal;
use support::web_watcher::WebWatcher;
use support::{Process, TestFolder, program};
use tectum_testkit::ScenarioFile;

/// Blocks of either kind, and ticks of a block: half a minute.
const BLOCKS: usize = 5;
const TICKS: &str = "3000";
const PERIOD_MS: i64 = 10;

/// The watchers of a run, one of them stopped.
struct Watchers {
    terminals: [TestTerminal; 2],
    screens: [Process; 2],
    pages: [WebWatcher; 2],
    /// Each reads a page's events until the run has ended, and gives the last tick that they tell.
    readers: [std::thread::JoinHandle<Value>; 2],
}

impl Watchers {
    /// Begins to watch the run in the folder `run`, which has not had a tick yet.
    fn start(folder: &TestFolder) -> Self {
        let terminals = [TestTerminal::new([80, 24]), TestTerminal::new([120, 40])];
        let mut screens = terminals.each_ref().map(|terminal| terminal.start(folder, &["watch", "run"], true));
        for (screen, terminal) in screens.iter_mut().zip(&terminals) {
            screen.wait_until("the run's processes", || terminal.screen().contains("controller setting up"));
        }
        let pages = [(); 2].map(|()| WebWatcher::start(folder, &["run", "--web", "127.0.0.1:0"]));
        let readers = pages.each_ref().map(|page| {
            let mut events = page.events("/events");
            assert_eq!(events.next().unwrap()["kind"], "hello");
            std::thread::spawn(move || events.find(|event| !event["ended"].is_null()).unwrap()["tick"].clone())
        });
        screens[1].signal("STOP");
        Self { terminals, screens, pages, readers }
    }

    /// Requires that they have seen all of the run, and ends them.
    fn end(self) {
        self.readers.into_iter().for_each(|reader| assert_eq!(reader.join().unwrap(), 3000));
        self.screens[1].signal("CONT");
        for (mut screen, terminal) in self.screens.into_iter().zip(self.terminals) {
            screen.wait_until("the end on the screen", || terminal.screen().contains("the run is over"));
            screen.signal("TERM");
            screen.wait().expect(143);
        }
        self.pages.into_iter().for_each(WebWatcher::end);
    }
}

/// The arm with the paper's rule, whose learning takes little of a tick in a debug build, too.
fn scenario(folder: &TestFolder) -> String {
    folder.write_scenario(&ScenarioFile::built_in("paper").set("period_ms", PERIOD_MS))
}

/// A run, watched or not, and its summary. It waits for its logger, so that all watchers see it from its begin, and
/// their own start is not measured.
fn block(watched: bool) -> Value {
    let folder = TestFolder::new();
    let scenario = scenario(&folder);
    let arguments = [&scenario, "--mode", "realtime", "--ticks", TICKS, "--by-hand", "logger", "--json"];
    let mut run = folder.run(&arguments);
    run.wait_until("the run's manifest", || folder.run_folder().join("run.json").exists());
    let watchers = watched.then(|| Watchers::start(&folder));
    let logger = folder.start(program("tectum-logger"), &["--run", "run"]);
    let summary = run.wait().expect(0).json();
    logger.wait().expect(0);
    watchers.into_iter().for_each(Watchers::end);
    summary
}

#[test]
#[ignore = "measures for five minutes; the command is above"]
fn a_watched_run_is_as_punctual_as_one_that_nobody_watches() {
    let folder = TestFolder::new();
    let arguments = [&scenario(&folder), "--ticks", TICKS, "--out", "run", "--json"];
    let lockstep = folder.tectum("run", &arguments).expect(0).json();
    let summaries: Vec<[Value; 2]> = (0..BLOCKS).map(|_| [true, false].map(block)).collect();
    println!("wake-up lateness, us:  watched p50, p99, max | alone p50, p99, max | missed");
    let of = |summary: &Value, name: &str| summary["wake_up_lateness_us"][name].as_f64().unwrap();
    for pair in &summaries {
        let [watched, alone] = pair.each_ref().map(|s| ["p50", "p99", "max"].map(|name| of(s, name)));
        println!("{watched:8.1?} | {alone:8.1?} | {} {}", pair[0]["missed"], pair[1]["missed"]);
    }
    let median = |which: usize| {
        let mut p99: Vec<f64> = summaries.iter().map(|pair| of(&pair[which], "p99")).collect();
        p99.sort_by(f64::total_cmp);
        p99[BLOCKS / 2]
    };
    let ratio = median(0) / median(1);
    println!("median of the p99: watched {:.1}, alone {:.1}, ratio {ratio:.2}", median(0), median(1));
    for summary in summaries.iter().flatten() {
        assert_eq!((&summary["missed"], &summary["late"]), (&0.into(), &0.into()), "the machine is too busy");
        assert_eq!(summary["weights_hash"], lockstep["weights_hash"]);
    }
}

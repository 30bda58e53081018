//! The browser's face of `tectum watch`: over HTTP, and in Chromium where there is one.
//!
//! ```text
//! cargo test --test watch_web -- --ignored       # Chromium, prometheus_client (of TECTUM_PYTHON), and what it costs
//! TECTUM_SNAPSHOTS=write ...                     # writes docs/figures/watch.png anew
//! ```

mod support;

use std::io::Read as _;
use std::time::{Duration, Instant};

use support::browser::Browser;
use support::web_watcher::{WebWatcher, processor_time};
use support::{Process, TestFolder, WATCHDOG};

fn long_run(folder: &TestFolder) -> Process {
    let mut run = folder.run(&["arm", "--mode", "realtime", "--ticks", "100000", "--json"]);
    run.wait_until_ticking();
    run
}

fn end(run: Process) {
    run.signal("INT");
    run.wait().expect(130);
}

#[test]
fn a_reader_gets_the_run_from_its_begin_and_then_every_tick() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    let watcher = WebWatcher::start(&folder, &["run", "--web", "127.0.0.1:0"]);
    let page = watcher.get("/", watcher.host());
    assert!(page.starts_with("HTTP/1.1 200 OK") && page.contains("new uPlot("), "{}", &page[..300]);
    assert!(page.contains("default-src 'none'"));
    let mut ticks = Vec::new();
    let mut first = None;
    for event in watcher.events("/events") {
        first.get_or_insert_with(|| event.clone());
        let records = event["records"].as_array().cloned().unwrap_or_default();
        ticks.extend(records.iter().map(|record| record["t"].as_u64().unwrap()));
        if ticks.len() > 60 {
            let record = &records[records.len() - 1];
            assert_eq!(record["p"].as_array().map(Vec::len), Some(5), "base, joints and end: {record}");
            break;
        }
    }
    assert_eq!(first.unwrap()["kind"], "hello");
    assert!(ticks.windows(2).all(|pair| pair[0] < pair[1]), "{ticks:?}");
    end(run);
    let ended = watcher.events("/events").find(|event| !event["ended"].is_null()).unwrap();
    assert_eq!(ended["ended"], "the run ended early");
    watcher.end();
}

#[test]
fn only_who_may_is_answered_and_who_does_not_read_holds_up_nobody() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    let watcher = WebWatcher::start(&folder, &["run", "--web", "127.0.0.1:0"]);
    for (request, status) in [
        ("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", "405"),
        ("GET / HTTP/1.1\r\nHost: somewhere.example\r\n\r\n", "403"),
        ("nonsense\r\n\r\n", "400"),
    ] {
        let mut answer = String::new();
        watcher.ask(request).read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{request:?}: {answer}");
    }
    let host = watcher.host().to_owned();
    assert!(watcher.get("/state", &host).starts_with("HTTP/1.1 404"));
    // These never read what they are sent.
    let _deaf: Vec<_> = (0..8).map(|_| watcher.ask(&format!("GET /events HTTP/1.1\r\nHost: {host}\r\n\r\n"))).collect();
    let tick = |event: &serde_json::Value| event["tick"].as_u64();
    let mut events = watcher.events("/events").filter(|event| event["kind"] == "update");
    let begin = tick(&events.next().unwrap()).unwrap();
    assert!(events.any(|event| tick(&event).unwrap() > begin + 40));
    watcher.end();

    let open = WebWatcher::start(&folder, &["run", "--web", "0.0.0.0:0"]);
    let (_, token) = open.url.split_once("/?token=").expect("a link with a token");
    assert!(open.get("/", "anything").starts_with("HTTP/1.1 403"));
    assert!(open.get("/?token=0", "anything").starts_with("HTTP/1.1 403"));
    assert!(open.get(&format!("/?token={token}"), "anything").starts_with("HTTP/1.1 200"));
    assert_eq!(open.events(&format!("/events?token={token}")).next().unwrap()["kind"], "hello");
    open.end();
    end(run);
}

#[test]
#[ignore = "needs Chromium"]
fn the_page_shows_a_run_its_restart_its_end_and_the_next_run_in_a_browser() {
    let folder = TestFolder::new();
    let watcher = WebWatcher::start(&folder, &["run", "--wait", "--web", "127.0.0.1:0"]);
    let mut browser = Browser::start(folder.path());
    browser.resize(1280, 900);
    browser.call("Page.navigate", serde_json::json!({"url": watcher.url}));
    browser.wait_until("document.getElementById('status').textContent.startsWith('Waiting for')");
    let paint = browser.evaluate("performance.getEntriesByName('first-contentful-paint')[0]?.startTime");
    println!("first contentful paint after {paint} ms");
    let mut run = long_run(&folder);
    browser.wait_until("watched.records.length > 30 && !document.getElementById('arm').hidden");
    browser.wait_until("document.querySelectorAll('.uplot canvas').length >= 3");
    // The picture of the arm changes with the ticks.
    let drawn = "document.getElementById('arm').toDataURL()";
    let before = browser.evaluate(drawn);
    browser.wait_until(&format!("{drawn} !== {before}"));
    let killed = run.kill_child("tectum-controller");
    run.next_child_pid("tectum-controller", killed);
    browser.wait_until("document.getElementById('events').innerText.includes('the controller is started again')");
    browser.wait_until("document.getElementById('processes').innerText.includes('start 2')");
    browser.wait_until("watched.marks.some(mark => mark.kind === 'restart')");

    browser.press(" ");
    browser.wait_until("watched.at !== null");
    let at = browser.evaluate("document.getElementById('at').textContent");
    browser.press("ArrowLeft");
    (0..25).for_each(|_| browser.press("ArrowLeft"));
    browser.wait_until(&format!("document.getElementById('at').textContent !== {at}"));
    browser.press("End");
    browser.wait_until("watched.at === null");
    write_picture(&mut browser);
    let light = browser.evaluate("getComputedStyle(document.body).backgroundColor");
    browser.press("d");
    browser.wait_until(&format!("getComputedStyle(document.body).backgroundColor !== {light}"));
    browser.resize(390, 844);
    browser.wait_until("document.documentElement.scrollWidth <= 390");

    end(run);
    browser.wait_until("document.getElementById('status').textContent === 'the run ended early'");
    std::fs::remove_dir_all(folder.run_folder()).unwrap();
    let run = long_run(&folder);
    browser.wait_until("document.getElementById('status').textContent === 'running' && watched.now.tick < 20000");
    browser.wait_until("!document.getElementById('processes').innerText.includes('start 2')");
    assert!(browser.complaints.is_empty(), "{:#?}", browser.complaints);
    end(run);
    drop(browser);
    watcher.end();
}

/// Writes the picture for docs/watch.md, when asked to.
fn write_picture(browser: &mut Browser) {
    if std::env::var_os("TECTUM_SNAPSHOTS").is_some() {
        browser.wait_until("watched.records.length > 240");
        let picture = browser.picture();
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/figures/watch.png");
        std::fs::write(file, decode_base64(&picture)).unwrap();
    }
}

fn decode_base64(text: &str) -> Vec<u8> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bits, mut count, mut bytes) = (0_u32, 0, Vec::new());
    for digit in text.bytes().filter_map(|c| DIGITS.iter().position(|d| *d == c)) {
        (bits, count) = ((bits << 6 | digit as u32) & 0xff_ffff, count + 6);
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}

/// A measurement: what a watcher with one reader costs at twenty updates a second. It asserts no time.
#[test]
#[ignore = "a measurement of ten seconds"]
fn what_twenty_updates_a_second_cost() {
    let folder = TestFolder::new();
    let run = long_run(&folder);
    let watcher = WebWatcher::start(&folder, &["run", "--web", "127.0.0.1:0"]);
    let mut events = watcher.events("/events");
    events.next();
    let (began, before) = (Instant::now(), processor_time(watcher.id()));
    let mut updates = 0;
    while began.elapsed() < Duration::from_secs(10) {
        assert!(events.next().is_some() && began.elapsed() < WATCHDOG);
        updates += 1;
    }
    let used = processor_time(watcher.id()) - before;
    let share = 100.0 * used.as_secs_f64() / began.elapsed().as_secs_f64();
    println!("{updates} updates in {:.1?}: {share:.1} % of a core", began.elapsed());
    end(run);
}

/// The value of a sample in Prometheus' text.
fn metric(text: &str, name: &str) -> f64 {
    let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    value.unwrap_or_else(|| panic!("{name}: {text}")).parse().unwrap()
}

#[test]
fn metrics_tell_of_a_run_its_restart_and_its_end() {
    let folder = TestFolder::new();
    let mut run = long_run(&folder);
    let watcher = WebWatcher::start(&folder, &["run", "--metrics", "127.0.0.1:0"]);
    assert!(watcher.url.ends_with("/metrics"), "{}", watcher.url);
    let get = || watcher.get("/metrics", watcher.host());
    let until = |run: &mut Process, what: &str, found: &dyn Fn(&str) -> bool| {
        run.wait_until(what, || found(&get()));
        get()
    };
    let text = until(&mut run, "a loss", &|text| text.contains("\ntectum_loss "));
    assert!(text.starts_with("HTTP/1.1 200 OK") && text.contains("Content-Type: text/plain; version=0.0.4"), "{text}");
    assert!(metric(&text, "tectum_ticks_total{process=\"plant\"}") > 0.0);
    assert_eq!(metric(&text, "tectum_tick_period_seconds"), 0.05);
    let late = ["0.5", "0.9", "0.99", "1"]
        .map(|share| metric(&text, &format!("tectum_wake_up_lateness_seconds{{quantile=\"{share}\"}}")));
    assert!(late.is_sorted() && late[0] > 0.0, "{late:?}");
    let killed = run.kill_child("tectum-controller");
    run.next_child_pid("tectum-controller", killed);
    let restarts = "tectum_process_restarts_total{process=\"controller\"}";
    let text = until(&mut run, "the restart", &|text| metric(text, restarts) == 1.0);
    assert_eq!(metric(&text, "tectum_process_restarts_total{process=\"plant\"}"), 0.0);
    until(&mut run, "missed ticks", &|text| metric(text, "tectum_missed_ticks_total") > 0.0);
    // There is no page, and it can be asked for a head alone.
    assert!(watcher.get("/", watcher.host()).starts_with("HTTP/1.1 404"));
    let mut head = String::new();
    let request = format!("HEAD /metrics HTTP/1.1\r\nHost: {}\r\n\r\n", watcher.host());
    watcher.ask(&request).read_to_string(&mut head).unwrap();
    assert!(head.contains("Content-Length: ") && head.ends_with("\r\n\r\n"), "{head}");
    end(run);
    while metric(&get(), "tectum_run_alive") != 0.0 {}
    watcher.end();

    // The page's server has them, too.
    // A run that is never begun: the newest living one may be another test's.
    let watcher = WebWatcher::start(&folder, &["never", "--wait", "--web", "127.0.0.1:0"]);
    assert_eq!(metric(&watcher.get("/metrics", watcher.host()), "tectum_run_alive"), 0.0);
    watcher.end();
    let refused = folder.tectum("watch", &["--wait", "--metrics", "nowhere"]).expect(2).stderr;
    assert!(refused.contains("nothing can be served at nowhere"), "{refused}");
}

/// A run that serves metrics serves its own, and computes the same.
#[test]
fn a_run_serves_metrics_of_itself() {
    let folder = TestFolder::new();
    let other = long_run(&folder);
    let arguments = ["arm", "--mode", "realtime", "--ticks", "100000", "--out", "own", "--metrics", "127.0.0.1:0"];
    let run = WebWatcher::of_run(&folder, &arguments);
    let began = Instant::now();
    let text = loop {
        let text = run.get("/metrics", run.host());
        // The logger takes several ticks at once, so that it may have none yet when the others have.
        if text.contains("\ntectum_loss ") && metric(&text, "tectum_ticks_total{process=\"logger\"}") > 0.0 {
            break text;
        }
        assert!(began.elapsed() < WATCHDOG, "{text}");
        std::thread::park_timeout(Duration::from_millis(20));
    };
    assert!(text.contains("tectum_run_info{run=\"own\","), "{text}");
    run.end();
    assert!(folder.path().join("own/summary.json").exists());
    end(other);

    let hash = |more: &[&str], out: &str| {
        let run = [&["paper", "--ticks", "2000", "--json", "--out", out], more].concat();
        folder.tectum("run", &run).expect(0).json()["weights_hash"].clone()
    };
    assert_eq!(hash(&["--metrics", "127.0.0.1:0"], "with"), hash(&[], "without"));
    for (arguments, message) in [
        (["--metrics", "nowhere"], "nothing can be served at nowhere"),
        (["--metrics=0", "--mode=in-process"], "a run in one process cannot be watched; leave out --metrics"),
    ] {
        let refused = folder.tectum("run", &arguments).refusal();
        assert!(refused.contains(message), "{refused}");
    }
}

/// A parser that others wrote takes the metrics, and finds names, kinds and labels as meant.
#[test]
#[ignore = "needs the Python package prometheus_client"]
fn prometheus_own_parser_reads_the_metrics() {
    let folder = TestFolder::new();
    let mut run = long_run(&folder);
    let watcher = WebWatcher::start(&folder, &["run", "--metrics", "127.0.0.1:0"]);
    run.wait_until("a loss", || watcher.get("/metrics", watcher.host()).contains("\ntectum_loss "));
    let code = "
import sys, urllib.request
from prometheus_client.parser import text_string_to_metric_families as parse
families = list(parse(urllib.request.urlopen(sys.argv[1]).read().decode()))
print(' '.join(sorted(f'{family.name}:{family.type}:{len(family.samples)}' for family in families)))
assert all(family.documentation.endswith('.') for family in families)
";
    let output =
        std::process::Command::new(support::python::python()).args(["-c", code, &watcher.url]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        text.split_whitespace().collect::<Vec<_>>(),
        [
            "tectum_late_commands:counter:1",
            "tectum_loss:gauge:1",
            "tectum_lost_samples:counter:1",
            "tectum_missed_ticks:counter:1",
            "tectum_process_restarts:counter:3",
            "tectum_process_up:gauge:3",
            "tectum_run_alive:gauge:1",
            "tectum_run_info:gauge:1",
            "tectum_skipped_ticks:counter:1",
            "tectum_tick_period_seconds:gauge:1",
            "tectum_ticks:counter:3",
            "tectum_unseen_observations:counter:1",
            "tectum_wake_up_lateness_seconds:summary:6",
        ]
    );
    watcher.end();
    end(run);
}

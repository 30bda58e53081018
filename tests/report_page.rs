//! `tectum report`: the page of a run, its content, and in Chromium that it draws it.
//!
//! ```text
//! cargo test --test report_page -- --ignored       # in Chromium
//! ```

mod support;

use serde_json::{Value, json};
use support::TestFolder;
use support::browser::Browser;
use tectum_testkit::ScenarioFile;

/// A short run of the arm with the paper's rule, whose joint blocks after 600 ticks.
fn short_run(folder: &TestFolder, out: &str, ticks: &str, more: &[&str]) -> Value {
    let scenario = ScenarioFile::built_in("arm").set("learner.rule", "paper").set("plant.arm.block.0.tick", 600);
    let scenario = folder.write_scenario(&scenario);
    let arguments = [&[scenario.as_str(), "--ticks", ticks, "--out", out, "--json"], more].concat();
    folder.tectum("run", &arguments).expect(0).json()
}

/// The data in a page.
fn data(folder: &TestFolder, page: &str) -> Value {
    let text = std::fs::read_to_string(folder.path().join(page)).unwrap();
    let (_, rest) = text.split_once("<script id=\"data\" type=\"application/json\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_page_holds_what_the_run_has_left() {
    let folder = TestFolder::new();
    let summary = short_run(&folder, "run", "1200", &[]);
    let written = folder.tectum("report", &["run", "--html", "--json"]).expect(0).json();
    assert_eq!(written["file"], "run/report.html");
    let page = data(&folder, "run/report.html");
    let run = &page["runs"][0];
    assert_eq!(run["summary"], summary);
    assert_eq!((&run["notes"], &run["marks"]), (&json!([]), &json!([[30.0, "joint 3 blocked"]])));
    assert!(run["figure"].as_str().unwrap().contains("<svg"));
    assert!(run["settings"].as_str().unwrap().contains("[plant.arm]"));
    assert!(run["facts"].as_array().unwrap().iter().any(|fact| fact[0] == "build" && fact[1] == tectum::BUILD));
    let labels: Vec<_> = run["log"]["movements"].as_array().unwrap().iter().map(|m| m["label"].clone()).collect();
    assert_eq!(labels, ["at the beginning", "after: joint 3 blocked", "at the end"]);
    let curves = &run["log"]["curves"];
    assert_eq!([&curves["t"], &curves["loss"], &curves["error"]].map(|list| list.as_array().unwrap().len()), [240; 3]);
    // 1200 ticks in 240 points; the rewards of five ticks make the first. No latency where there is no time.
    assert!((curves["t"][0].as_f64().unwrap() - 0.125).abs() < 1e-9 && run["log"]["latencies"].is_null());

    short_run(&folder, "second", "1200", &["--seed", "2"]);
    let text = folder.tectum("report", &["--compare", "run", "second"]).expect(0).stdout;
    assert!(text.starts_with("report  compare.html ("), "{text}");
    let both = data(&folder, "compare.html");
    assert_eq!([&both["runs"][0]["name"], &both["runs"][1]["name"]], ["run", "second"]);

    for (arguments, message) in [
        (&["nowhere"][..], "there is no run in nowhere"),
        (&["run", "second"], "2 runs are given; add --compare"),
        (&["--compare", "run"], "--compare needs two runs or more"),
        (&["run", "--out", "no/such/folder.html"], "no/such/folder.html cannot be written"),
    ] {
        let refused = folder.refused("report", arguments);
        assert!(refused.contains(message), "{refused}");
    }
}

/// What is left of a run whose launcher was killed is shown, and what is missing is said.
#[test]
fn a_page_says_what_is_missing() {
    let folder = TestFolder::new();
    short_run(&folder, "run", "1200", &[]);
    std::fs::remove_file(folder.run_folder().join("summary.json")).unwrap();
    let log = std::fs::read(folder.log_path()).unwrap();
    std::fs::write(folder.log_path(), &log[..log.len() / 2]).unwrap();
    folder.tectum("report", &["run"]).expect(0);
    let page = data(&folder, "run/report.html");
    let notes: Vec<_> = page["runs"][0]["notes"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    assert!(notes[0].starts_with("There is no summary") && notes[1].starts_with("The log has no end"), "{notes:?}");
}

#[test]
#[ignore = "needs Chromium"]
fn a_browser_draws_the_page_without_a_complaint() {
    let folder = TestFolder::new();
    short_run(&folder, "run", "1200", &[]);
    short_run(&folder, "timed", "60", &["--mode", "realtime"]);
    folder.tectum("report", &["--compare", "run", "timed", "--out", "both.html"]).expect(0);
    folder.tectum("report", &["run"]).expect(0);
    let mut browser = Browser::start(folder.path());
    let open = |browser: &mut Browser, page: &str, wide| {
        browser.resize(wide, 900);
        browser.call("Page.navigate", json!({"url": format!("file://{}/{page}", folder.path().display())}));
        browser.wait_until("document.documentElement.dataset.ready === 'true'");
    };
    open(&mut browser, "run/report.html", 1280);
    let shown = browser.evaluate("document.body.innerText").as_str().unwrap().to_owned();
    for words in ["Nothing that is known", "What was learned", "How it moved", "Versions and settings", "test error"] {
        assert!(shown.contains(words), "{words}: {shown}");
    }
    browser.wait_until("document.querySelectorAll('section > div > svg path').length === 2");
    browser.wait_until("document.querySelector('img').naturalWidth > 0");
    let drawn = "document.querySelector('canvas').toDataURL()";
    let before = browser.evaluate(drawn);
    browser.wait_until(&format!("{drawn} !== {before}"));
    let light = browser.evaluate("getComputedStyle(document.body).backgroundColor");
    browser.press("d");
    browser.wait_until(&format!("getComputedStyle(document.body).backgroundColor !== {light}"));
    open(&mut browser, "both.html", 390);
    browser.wait_until("document.documentElement.scrollWidth <= 390");
    browser.wait_until("document.querySelectorAll('article').length === 2");
    browser.wait_until("document.querySelectorAll('svg rect').length > 3");
    assert!(browser.complaints.is_empty(), "{:#?}", browser.complaints);
}

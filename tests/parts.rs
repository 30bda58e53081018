//! Studies in parts: what is interrupted goes on, and parts of many processes give what one process gives, bit for bit.

mod support;

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use support::{Process, TECTUM, TestFolder};

/// A comparison of two learners that takes seconds.
const COMPARE: [&str; 8] =
    ["compare", "--learners", "actor-critic,baseline", "--ticks", "400", "--starts", "1", "--json"];

fn start(test_folder: &TestFolder, arguments: &[&[&str]]) -> Process {
    test_folder.start(TECTUM, &arguments.concat())
}

fn run(test_folder: &TestFolder, arguments: &[&[&str]]) -> Value {
    start(test_folder, arguments).wait().expect(0).json()
}

/// The files of two folders must be the same, byte by byte, but for the times in JSON.
#[track_caller]
fn assert_same(a: &Path, b: &Path, files: &[&str]) {
    for file in files {
        let [a, b] = [a, b].map(|folder| fs::read(folder.join(file)).unwrap_or_else(|e| panic!("{file}: {e}")));
        assert!(a == b && !a.is_empty(), "{file}");
    }
}

/// Number of whole rows in a file.
fn rows(path: &Path) -> usize {
    let text = fs::read(path).unwrap_or_default();
    text.iter().filter(|&&byte| byte == b'\n').count().saturating_sub(1)
}

/// Four processes, one of them killed and started again: together they give the tables and the figure of one.
#[test]
fn four_parts_give_what_one_process_gives() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[&COMPARE, &["--seeds", "3000..3008", "--out", "whole"]]);
    let parts: Vec<String> = (0..4).map(|i| format!("part-{i}.jsonl")).collect();
    let range = |i: usize| format!("{}..{}", 3000 + 2 * i, 3002 + 2 * i);
    for (i, part) in parts.iter().enumerate() {
        let arguments: [&[&str]; 2] = [&COMPARE, &["--seeds", &range(i), "--part", part]];
        if i == 2 {
            let mut killed = start(&test_folder, &arguments);
            let file = test_folder.path().join(part);
            killed.wait_until_or_end("a row", || rows(&file) >= 1);
            killed.signal("KILL");
            killed.wait();
            // As if it had died within a row.
            let mut text = fs::read(&file).unwrap();
            text.extend_from_slice(b"{\"job\":\"actor-cri");
            fs::write(&file, text).unwrap();
        }
        let part = run(&test_folder, &arguments);
        assert_eq!((&part["runs"], &part["study"]), (&Value::from(4), &Value::from("compare")));
    }
    let files: Vec<&str> = parts.iter().rev().map(String::as_str).collect();
    let merged = run(&test_folder, &[&["merge"], &files, &["--out", "merged", "--json"]]);
    assert_eq!(merged["seeds"], Value::from((3000..3008).collect::<Vec<_>>()));
    let [whole, both] = ["whole", "merged"].map(|name| test_folder.path().join(name));
    assert_same(&whole, &both, &["compare.csv", "curves.csv", "figure.svg"]);
    // A whole study's folder can be merged, too; runs that are twice there are equal.
    run(&test_folder, &[&["merge", "whole", "part-1.jsonl", "--out", "again", "--json"]]);
    assert_same(&whole, &test_folder.path().join("again"), &["compare.csv", "curves.csv", "figure.svg"]);

    // What is missing is listed, and nothing is written.
    let missing = test_folder.refused("merge", &["part-0.jsonl", "part-3.jsonl", "--out", "no"]);
    assert!(missing.contains("8 of 16 runs are missing: actor-critic seed 3002, "), "{missing}");
    assert!(!test_folder.path().join("no").exists());
}

/// Rows of other studies, other builds and other results are refused, each with one sentence.
#[test]
fn parts_that_do_not_fit_are_refused() {
    let test_folder = TestFolder::new();
    let short = ["compare", "--learners", "baseline", "--ticks", "100", "--starts", "1", "--json"];
    let path = |name: &str| test_folder.path().join(name);
    for (seeds, part) in [("1..3", "a"), ("3..5", "b")] {
        run(&test_folder, &[&short, &["--seeds", seeds, "--part", part]]);
    }
    let other = ["compare", "--learners", "baseline", "--ticks", "120", "--starts", "1", "--json"];
    let text = test_folder.refused("compare", &[&other[1..7], &["--seeds", "1..3", "--part", "a"]].concat());
    assert!(text.contains("a is of another study: its ticks is 100, and not 120; give another file"), "{text}");
    run(&test_folder, &[&other, &["--seeds", "5..6", "--part", "c"]]);
    let text = test_folder.refused("merge", &["a", "c"]);
    assert!(text.contains("c does not belong to a: its ticks is 120, and not 100"), "{text}");

    let changed = |from: &str, to: &str, change: &dyn Fn(&str) -> String| {
        let text = change(&fs::read_to_string(path(from)).unwrap());
        fs::write(path(to), text).unwrap();
    };
    changed("b", "build", &|text| text.replacen(tectum::BUILD, "0.0.1", 1));
    assert!(test_folder.refused("merge", &["a", "build"]).contains("build does not belong to a: its build is 0.0.1"));
    assert!(test_folder.refused("merge", &["build"]).contains("build is of build 0.0.1, and this is "));
    changed("b", "flipped", &|text| text.replacen("\"tests\":[{\"condition\":0", "\"tests\":[{\"condition\":1", 1));
    let text = test_folder.refused("merge", &["a", "flipped"]);
    assert!(text.contains("flipped:2 is damaged: its checksum does not fit; take the line out"), "{text}");
    let text = test_folder.refused("merge", &["a", "nowhere"]);
    assert!(text.contains("nowhere cannot be read"), "{text}");
    fs::write(path("text"), "not rows\n").unwrap();
    assert!(test_folder.refused("merge", &["text"]).contains("text holds no rows of a study of this version"));
    let text = test_folder.refused("compare", &["--continue", "nowhere"]);
    assert!(text.contains("nowhere is not the folder of a study that was interrupted"), "{text}");
    run(&test_folder, &[&["reproduce", "arm", "--seeds", "1", "--ticks", "500", "--out", "arm", "--json"]]);
    let text = test_folder.refused("compare", &["--continue", "arm"]);
    assert!(text.contains("arm is the folder of tectum reproduce arm, not of tectum compare"), "{text}");
}

/// Starts a study, interrupts it when it has some rows, and goes on with it. Returns the folder of the whole one.
fn interrupted(test_folder: &TestFolder, arguments: &[&str]) -> [PathBuf; 2] {
    run(test_folder, &[arguments, &["--out", "whole", "--json"]]);
    let mut first = start(test_folder, &[arguments, &["--out", "parts"]]);
    let file = test_folder.path().join("parts/rows.jsonl");
    first.wait_until("two rows", || rows(&file) >= 2);
    first.signal("INT");
    let first = first.wait().expect(130);
    let kept = rows(&file);
    let expected = format!("{kept} of ");
    assert!(first.stderr.contains(&expected) && first.stderr.contains("--continue parts` goes on"), "{first:#?}");
    assert_eq!(first.stderr.lines().count(), 1);
    run(test_folder, &[&arguments[..1], &["--continue", "parts", "--json"]]);
    assert!(rows(&file) > kept);
    ["whole", "parts"].map(|name| test_folder.path().join(name))
}

#[test]
fn an_interrupted_comparison_goes_on() {
    let test_folder = TestFolder::new();
    let [a, b] = interrupted(&test_folder, &[&COMPARE[..7], &["--seeds", "12"]].concat());
    assert_same(&a, &b, &["compare.csv", "curves.csv", "figure.svg"]);
}

#[test]
fn an_interrupted_experiment_goes_on() {
    let test_folder = TestFolder::new();
    let [a, b] = interrupted(&test_folder, &["reproduce", "eye", "--seeds", "4", "--ticks", "40000"]);
    assert_same(&a, &b, &["curve.csv", "figure.svg"]);
}

/// Every experiment gives the same from parts as from one process.
#[test]
fn experiments_are_put_together_from_parts() {
    for (experiment, ticks, files) in [
        ("arm", "2000", &["windows.csv", "curve.csv", "figure.svg"][..]),
        ("open-loop", "2000", &["curve.csv", "postures.csv", "figure.svg"]),
        ("outlook", "200", &["outlook.csv"]),
    ] {
        let test_folder = TestFolder::new();
        let one = ["reproduce", experiment, "--ticks", ticks, "--json"];
        run(&test_folder, &[&one, &["--seeds", "7..=10", "--out", "whole"]]);
        run(&test_folder, &[&one, &["--seeds", "7..9", "--part", "a"]]);
        run(&test_folder, &[&one, &["--seeds", "9..11", "--part", "b"]]);
        run(&test_folder, &[&["merge", "b", "a", "--out", "merged", "--json"]]);
        assert_same(&test_folder.path().join("whole"), &test_folder.path().join("merged"), files);
    }
}

/// A sweep over any key; its rows equal the runs of the scenario, and it is done in parts, too.
#[test]
fn a_sweep_equals_its_runs() {
    let test_folder = TestFolder::new();
    let settings = ["--set", "policy.sigma=0.001,0.002", "--set", "learner.rule=paper,actor-critic", "--ticks", "500"];
    let text = fs::read_to_string("scenarios/arm.toml").unwrap();
    let file = test_folder.write_file("mine.toml", text).to_str().unwrap().to_owned();
    let one: [&[&str]; 2] = [&["sweep", &file, "--json"], &settings];
    let sweep = run(&test_folder, &[one[0], one[1], &["--seeds", "3", "--out", "whole"]]);
    assert_eq!(sweep["rows"].as_array().unwrap().len(), 4);
    let row = &sweep["rows"][3];
    assert_eq!(row["settings"], serde_json::json!({"learner.rule": "actor-critic", "policy.sigma": "0.002"}));
    assert!(row["loss"]["median"].is_f64() && row["weights_hash"].as_array().unwrap().len() == 3, "{row}");
    let again: [&[&str]; 2] = [&["--set", "policy.sigma=0.001"], &["--seeds", "2..3", "--out", "one"]];
    let again = run(&test_folder, &[one[0], again[0], &["--set", "learner.rule=paper", "--ticks", "500"], again[1]]);
    assert_eq!(again["rows"][0]["weights_hash"][0], sweep["rows"][0]["weights_hash"][1]);
    for (seeds, part) in [("1..2", "a"), ("2..4", "b")] {
        run(&test_folder, &[one[0], one[1], &["--seeds", seeds, "--part", part]]);
    }
    run(&test_folder, &[&["merge", "a", "b", "--out", "merged", "--json"]]);
    let [whole, merged] = ["whole", "merged"].map(|name| test_folder.path().join(name));
    assert_same(&whole, &merged, &["sweep.csv", "curves.csv", "figure.svg"]);
    let csv = fs::read_to_string(whole.join("sweep.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 4 * 3);
    assert!(csv.starts_with("learner.rule,policy.sigma,seed,ticks,first_loss,loss,"), "{csv}");
    for (setting, what) in [
        ("learner.bta=1", "learner.bta=1: unknown key \"learner.bta\""),
        ("policy.sigma=-1", "policy.sigma=-1: policy.sigma is -1"),
        ("ticks.x=1", "--set ticks.x: \"x\" stands in a value that is no table"),
    ] {
        let text = test_folder.refused("sweep", &["arm", "--set", setting, "--out", "no"]);
        assert!(text.contains(what) && !test_folder.path().join("no").exists(), "{text}");
    }
}

/// A plant that is a program of its own is swept with processes of its own, beside the simulated one.
#[test]
fn plants_of_ones_own_are_swept() {
    let test_folder = TestFolder::new();
    let point = fs::read_to_string("examples/point.toml").unwrap();
    let program = support::example("point");
    let point = point.replace("target/release/examples/point", program.to_str().unwrap());
    let file = test_folder.write_file("point.toml", point).to_str().unwrap().to_owned();
    let arguments = ["--set", "policy.sigma=0.1,0.2", "--ticks", "300", "--seeds", "2", "--out", "out", "--json"];
    let sweep = run(&test_folder, &[&["sweep", &file], &arguments]);
    let run = test_folder.run(&[&file, "--ticks", "300", "--seed", "2", "--json"]).wait().expect(0).json();
    let own = sweep["rows"].as_array().unwrap();
    assert_eq!(own.len(), 2);
    assert!(own.iter().all(|row| row["loss"]["median"].is_f64()), "{sweep}");
    assert_eq!(own[1]["weights_hash"][1], run["weights_hash"], "{sweep}\n{run}");
}

/// GNU parallel as docs/clusters.md has it: four parts, of which one is killed and started again.
#[test]
#[ignore = "needs GNU parallel (apt-get install parallel)"]
fn gnu_parallel_starts_a_killed_part_again() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[&COMPARE, &["--seeds", "6000..6008", "--out", "whole"]]);
    let compare = COMPARE.join(" ");
    let job = format!(
        "part() {{ \"{TECTUM}\" {compare} --seeds $1..$(($1 + 2)) --part $1.jsonl > $1.json; }}
if [ $1 = 6004 ] && [ ! -e killed ]; then
    part $1 & until [ \"$(cat $1.jsonl 2> /dev/null | wc -l)\" -ge 2 ]; do :; done
    pkill -KILL -P $! && touch killed
    wait $!
else
    part $1
fi"
    );
    test_folder.write_file("job.sh", job);
    let parallel = ["--will-cite", "--retries", "3", "-j", "4", "sh job.sh {}", ":::", "6000", "6002", "6004", "6006"];
    test_folder.start("parallel", &parallel).wait().expect(0);
    assert!(test_folder.path().join("killed").exists());
    let parts = ["6000.jsonl", "6002.jsonl", "6004.jsonl", "6006.jsonl"];
    run(&test_folder, &[&["merge"], &parts, &["--out", "merged", "--json"]]);
    let [whole, merged] = ["whole", "merged"].map(|name| test_folder.path().join(name));
    assert_same(&whole, &merged, &["compare.csv", "curves.csv", "figure.svg"]);
}

/// `xargs` shares a comparison out to four processes, as a scheduler does to machines. Together they are equal to one
/// process's result, a changed result is found, and a part of the seeds can be made again.
#[test]
fn results_are_verified_bit_for_bit() {
    let test_folder = TestFolder::new();
    run(&test_folder, &[&COMPARE, &["--seeds", "5000..5008", "--out", "whole"]]);
    let compare = COMPARE.join(" ");
    let script = format!(
        "seq 5000 2 5006 | xargs -P 4 -I FIRST sh -c '\"{TECTUM}\" {compare} --seeds FIRST..$((FIRST + 2)) \
         --part FIRST.jsonl > FIRST.json'"
    );
    test_folder.start("/bin/sh", &["-c", &script]).wait().expect(0);
    let parts = ["5000.jsonl", "5002.jsonl", "5004.jsonl", "5006.jsonl"];
    run(&test_folder, &[&["merge"], &parts, &["--out", "merged", "--json"]]);
    let [whole, merged] = ["whole", "merged"].map(|name| test_folder.path().join(name));
    assert_same(&whole, &merged, &["compare.csv", "curves.csv", "figure.svg"]);
    let found = run(&test_folder, &[&["compare", "--json", "--verify", "whole"], &parts]);
    assert_eq!((&found["compared"], &found["equal"]), (&Value::from(16), &Value::from(16)), "{found}");
    assert_eq!((&found["holds"], &found["alone"]), (&Value::from(true), &serde_json::json!([0, 0])), "{found}");
    let text = test_folder.tectum("compare", &["--verify", "whole", parts[1]]).expect(0).stdout;
    assert_eq!(
        text,
        "compare: 4 of 4 runs are equal, bit for bit; 12 runs are only in the first result, 0 only in the second\n"
    );

    // Of one result, a share is made again.
    let again = run(&test_folder, &[&["compare", "--json", "--verify", "5002.jsonl", "--sample", "0.3"]]);
    assert_eq!((&again["compared"], &again["holds"]), (&Value::from(2), &Value::from(true)), "{again}");
    assert_eq!(again["made_again"].as_array().unwrap().len(), 1, "{again}");

    // A number that differs by its last bit, under a checksum that fits.
    let file = test_folder.path().join("5002.jsonl");
    let text = fs::read_to_string(&file).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for line in &mut lines[1..] {
        let mut row: Value = serde_json::from_str(line).unwrap();
        let hash = row["result"]["weights_hash"].as_str().unwrap();
        let flipped = format!("{:016x}", u64::from_str_radix(hash, 16).unwrap() ^ 1);
        row["result"]["weights_hash"] = flipped.into();
        let sum = format!("{}\n{}", row["job"].as_str().unwrap(), row["result"]);
        row["check"] = format!("{:016x}", xxhash_rust::xxh3::xxh3_64(sum.as_bytes())).into();
        *line = row.to_string();
    }
    fs::write(&file, lines.join("\n") + "\n").unwrap();
    for arguments in [&["whole", "5002.jsonl"][..], &["5002.jsonl", "--sample", "1"]] {
        let outcome = test_folder.tectum("compare", &[&["--verify"], arguments].concat()).expect(1);
        assert!(outcome.stdout.starts_with("compare: 0 of 4 runs are equal, bit for bit"), "{outcome:#?}");
        assert!(outcome.stdout.contains("actor-critic seed 5002: weights_hash is \""), "{outcome:#?}");
    }
    for (arguments, what) in [
        (&["--verify", "5000.jsonl", "5004.jsonl"][..], "the results have no run in common"),
        (&["--verify", "nowhere"], "nowhere cannot be read"),
        (&["--verify", "5000.jsonl", "--sample", "0"], "--sample is 0; give a share of the seeds"),
        (&["--verify", "5000.jsonl", "--sample", "nan"], "--sample is NaN"),
    ] {
        let refused = test_folder.refused("compare", arguments);
        assert!(refused.contains(what), "{refused}");
    }
}

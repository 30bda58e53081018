//! `tectum log info`, `repair` and `csv` on the logs of real runs: whole, torn, damaged, thinned, lossy, and in use.

mod support;

use std::collections::BTreeMap;
use std::fs;

use serde_json::Value;
use support::content::read_log;
use support::slow::run_with_a_stopped_logger;
use support::{TestFolder, append, signal_process};
use tectum::log::LogRecord;
use tectum::wire::flag;

/// Runs the arm for so many ticks and returns its log, which holds every tick with a multiple of `every`.
fn recorded(test_folder: &TestFolder, every: &str, ticks: &str) -> Vec<u8> {
    let scenario = test_folder.arm_scenario(&[("every", every)]);
    test_folder.run(&[&scenario, "--ticks", ticks]).wait().expect(0);
    fs::read(test_folder.log_path()).unwrap()
}

#[test]
fn info_describes_a_whole_log() {
    let test_folder = TestFolder::new();
    let bytes = recorded(&test_folder, "1", "3000").len();
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    for (key, value) in [
        ("bytes", Value::from(bytes)),
        ("state", "whole".into()),
        ("torn_at", Value::Null),
        ("scenario", "paper".into()),
        ("seed", 1.into()),
        ("planned_ticks", 3000.into()),
        ("mode", "lockstep".into()),
        ("build", tectum::BUILD.into()),
        ("period_s", 0.05.into()),
        ("every", 1.into()),
        ("duration_s", 150.0.into()),
        ("complete", true.into()),
        ("gaps", 0.into()),
    ] {
        assert_eq!(info[key], value, "{key}: {info}");
    }
    assert!(info["machine"]["kernel"].as_str().unwrap().starts_with("Linux"));
    assert!(info["started"].as_str().unwrap().ends_with(" UTC"), "{info}");
    assert_eq!(info["weights_hash"][1], 2999);
    for (i, topic) in ["/observation", "/command", "/learning"].into_iter().enumerate() {
        let expected = serde_json::json!({
            "topic": topic, "messages": 3000, "first_tick": 0, "last_tick": 2999, "per_second": 20.0,
            "lost_stated": 0, "lost_found": 0, "thinned": 0, "duplicates": 0, "incarnations": [[0, 0]], "agrees": true,
        });
        assert_eq!(info["channels"][i], expected);
    }
    let text = test_folder.tectum("log", &["info", "run/log.mcap"]).expect(0).stdout;
    for words in
        ["state    whole\n", "run      paper, lockstep, seed 1\n", "3000 planned, all of them; 150 s of 0.05 s each"]
    {
        assert!(text.contains(words), "{words}: {text}");
    }
    // A whole log needs no repair.
    let before = fs::read(test_folder.log_path()).unwrap();
    let text = test_folder.tectum("log", &["repair", "run"]).expect(0).stdout;
    assert_eq!(text, "run/log.mcap is whole; it was left alone\n");
    assert!(before == fs::read(test_folder.log_path()).unwrap());
    assert!(!test_folder.run_folder().join("log.mcap.torn").exists());
}

#[test]
fn a_packed_log_is_smaller_and_reads_the_same() {
    let test_folder = TestFolder::new();
    let before = recorded(&test_folder, "1", "3000");
    let path = test_folder.log_path();
    let (_, content) = read_log(&path);
    let done =
        test_folder.tectum("log", &["pack", "run", "--no-views", "--out", "packed.mcap", "--json"]).expect(0).json();
    assert!(before == fs::read(&path).unwrap(), "with --out the log stays as it is");
    let bytes = done["bytes"].as_u64().unwrap();
    assert_eq!(bytes, test_folder.path().join("packed.mcap").metadata().unwrap().len());
    assert!(bytes * 2 < done["bytes_before"].as_u64().unwrap(), "{done}");
    let archive = test_folder.tectum("log", &["pack", "run", "--archive", "--out", "archive.mcap", "--json"]);
    assert!(archive.expect(0).json()["bytes"].as_u64().unwrap() < bytes);
    let refused = test_folder.refused("log", &["pack", "run", "--out", "packed.mcap"]);
    assert!(refused.contains("packed.mcap cannot be written: the file exists already"), "{refused}");

    let csv = |log: &str| test_folder.tectum("log", &["csv", log]).expect(0).stdout;
    assert!(csv("archive.mcap") == csv("run"));
    let (table, info) = (csv("run"), test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json());
    let text = test_folder.tectum("log", &["pack", "run"]).expect(0).stdout;
    assert!(text.starts_with("run/log.mcap is packed: "), "{text}");
    let (reader, packed) = read_log(&path);
    assert!(reader.finished() && reader.packed() && packed == content);
    assert!(csv("run") == table);
    let packed_info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    assert_eq!((&packed_info["channels"], &packed_info["state"]), (&info["channels"], &info["state"]));
    test_folder.tectum("replay", &["run"]).expect(0);
    let again = test_folder.tectum("log", &["pack", "run"]).expect(0).stdout;
    assert_eq!(again, "run/log.mcap is packed already; it was left alone\n");

    test_folder.write_file("torn.mcap", &before[..before.len() / 2]);
    let torn = test_folder.refused("log", &["pack", "torn.mcap"]);
    assert!(torn.contains("torn.mcap is torn") && torn.contains("tectum log repair"), "{torn}");
}

#[test]
fn info_tells_thinned_from_lost() {
    let test_folder = TestFolder::new();
    recorded(&test_folder, "7", "1000");
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    let channel = &info["channels"][2];
    assert_eq!((&info["every"], &info["state"]), (&7.into(), &"whole".into()));
    assert_eq!((&channel["messages"], &channel["thinned"]), (&143.into(), &(1000 - 143).into()));
    assert_eq!((&channel["lost_found"], &channel["agrees"]), (&Value::Null, &true.into()));
}

#[test]
fn a_torn_log_is_repaired_once() {
    let test_folder = TestFolder::new();
    let whole = recorded(&test_folder, "1", "1000");
    let path = test_folder.log_path();
    let torn = &whole[..whole.len() * 2 / 3];
    fs::write(&path, torn).unwrap();
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    let at = info["torn_at"].as_u64().unwrap();
    assert_eq!((&info["state"], &info["complete"]), (&"torn".into(), &Value::Null));
    let text = test_folder.tectum("log", &["info", "run"]).expect(0).stdout;
    assert!(text.contains(&format!("state    torn at byte {at}: `tectum log repair` makes it whole\n")), "{text}");

    // A repair into another file leaves the torn log as it is.
    let text = test_folder.tectum("log", &["repair", "run", "--out", "elsewhere.mcap"]).expect(0).stdout;
    assert!(text.starts_with(&format!("run/log.mcap was torn at byte {at}; elsewhere.mcap is whole\n")), "{text}");
    assert!(torn == fs::read(&path).unwrap());
    let again = test_folder.refused("log", &["repair", "run", "--out", "elsewhere.mcap"]);
    assert!(again.contains("elsewhere.mcap cannot be written: the file exists already"), "{again}");

    let done = test_folder.tectum("log", &["repair", "run", "--json"]).expect(0).json();
    assert_eq!((&done["whole"], &done["torn"]), (&"run/log.mcap".into(), &"run/log.mcap.torn".into()));
    assert_eq!(done["mended"]["left_out"].as_u64(), Some(torn.len() as u64 - at));
    assert!(torn == fs::read(test_folder.run_folder().join("log.mcap.torn")).unwrap());
    let repaired = fs::read(&path).unwrap();
    assert!(repaired == fs::read(test_folder.path().join("elsewhere.mcap")).unwrap());
    assert!(repaired[..at as usize] == torn[..at as usize], "what was there is there byte for byte");
    assert!(
        test_folder.run_folder().read_dir().unwrap().all(|e| !e
            .unwrap()
            .file_name()
            .to_string_lossy()
            .starts_with('.'))
    );

    let (reader, content) = read_log(&path);
    assert!(reader.finished() && reader.repaired());
    let n = content.observations.len() as u64;
    assert_eq!(done["mended"]["messages"][0], n);
    assert_eq!(reader.metadata()["tectum.totals"]["repaired"], "true");
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    assert_eq!((&info["state"], &info["complete"]), (&"repaired".into(), &Value::Null));
    assert!(info["channels"].as_array().unwrap().iter().all(|channel| channel["agrees"] == true), "{info}");

    // The repaired log is whole. When it is torn again, a repair does not overwrite the first torn log.
    assert!(test_folder.tectum("log", &["repair", "run"]).expect(0).stdout.contains("is whole; it was left alone"));
    fs::write(&path, torn).unwrap();
    let kept = test_folder.refused("log", &["repair", "run"]);
    assert!(kept.contains("run/log.mcap.torn exists already") && kept.contains("--out"), "{kept}");
    assert!(torn == fs::read(&path).unwrap());
}

#[test]
fn a_damaged_log_is_refused_with_name_and_byte() {
    let test_folder = TestFolder::new();
    let whole = recorded(&test_folder, "1", "300");
    let path = test_folder.log_path();
    let mut bytes = whole.clone();
    let at = bytes.len() / 2;
    bytes[at] ^= 0x10;
    fs::write(&path, &bytes).unwrap();
    for command in ["info", "repair", "csv"] {
        let outcome = test_folder.tectum("log", &[command, "run"]).expect(2);
        assert!(outcome.stderr.starts_with("tectum: the log run/log.mcap is damaged at byte "), "{outcome:#?}");
    }
    assert!(bytes == fs::read(&path).unwrap() && !test_folder.run_folder().join("log.mcap.torn").exists());
    test_folder.write_file("text.mcap", "not a log");
    let text = test_folder.refused("log", &["info", "text.mcap"]);
    assert!(text.starts_with("tectum: text.mcap is not a log of this program: "), "{text}");
    let text = test_folder.refused("log", &["csv", "nowhere"]);
    assert_eq!(text, "tectum: nowhere does not exist; give a log, or the folder of a run");
}

/// A log that still grows is not torn, and a repair would damage it.
#[test]
fn a_log_that_is_being_written_is_not_repaired() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "5")]);
    append(&scenario, "\n[restart]\nlogger = \"never\"\n");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "100000"]);
    run.wait_until_ticking();
    let text = test_folder.refused("log", &["repair", "run"]);
    assert!(text.contains("is still being written by its logger; wait until its run is over"), "{text}");
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    assert_eq!(info["state"], "growing", "{info}");
    assert!(info["started"].as_str().unwrap().ends_with(" UTC"));
    // The log of a killed logger can be repaired.
    let logger = run.child_pid("tectum-logger");
    signal_process(logger, "KILL");
    run.wait().expect(4);
    assert_eq!(test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json()["state"], "torn");
    test_folder.tectum("log", &["repair", "run"]).expect(0);
    assert_eq!(test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json()["state"], "repaired");
}

/// The fields of a line; these tables have no quoted fields.
fn fields(line: &str) -> Vec<&str> {
    line.split(',').collect()
}

#[test]
fn csv_writes_a_channel_as_a_table() {
    let test_folder = TestFolder::new();
    recorded(&test_folder, "1", "200");
    let (_, content) = read_log(&test_folder.log_path());
    let table = test_folder.tectum("log", &["csv", "run"]).expect(0).stdout;
    let lines: Vec<Vec<&str>> = table.lines().map(fields).collect();
    assert_eq!(lines.len(), 201);
    let at: BTreeMap<&str, usize> = lines[0].iter().enumerate().map(|(i, name)| (*name, i)).collect();
    assert_eq!(lines[0].len(), at.len(), "no name twice: {:?}", lines[0]);
    for (row, o) in lines[1..].iter().zip(&content.observations) {
        assert_eq!(row.len(), at.len());
        assert_eq!(row[at["tick"]], o.header.tick.to_string());
        assert_eq!(row[at["theta_4 (rad)"]].parse::<f32>().unwrap().to_bits(), o.inputs[5].to_bits());
        assert_eq!(row[at["reward"]].parse::<f32>().unwrap().to_bits(), o.reward.to_bits());
        assert_eq!(row[at["error"]].parse::<f32>().unwrap().to_bits(), o.measures[0].to_bits());
        assert_eq!(row[at["lost before"]], "0");
    }
    assert_eq!(lines[1][at["flags"]], "FIRST|NEW_TARGET");
    assert_eq!((lines[81][at["flags"]], lines[81][at["time (s)"]]), ("NEW_TARGET", "4.0"));

    for (channel, column, last) in [("command", "drawn ", 0), ("learning", "weights hash", 1)] {
        let file = format!("{channel}.csv");
        test_folder.tectum("log", &["csv", "run/log.mcap", "--channel", channel, "--out", &file]).expect(0);
        let table = fs::read_to_string(test_folder.path().join(file)).unwrap();
        let lines: Vec<Vec<&str>> = table.lines().map(fields).collect();
        assert!(lines.len() == 201 && lines.iter().all(|line| line.len() == lines[0].len()), "{channel}");
        assert!(lines[0].iter().any(|name| name.starts_with(column)), "{:?}", lines[0]);
        if last == 1 {
            assert_eq!(lines[200].last().unwrap(), &format!("{:016x}", content.learnings[199].weights_hash));
            assert_eq!((lines[199].last(), lines[2][7]), (Some(&""), "LEARNED"));
        }
    }
    assert_eq!(
        test_folder.tectum("log", &["csv", "run", "--channel", "gap"]).expect(0).stdout,
        "channel,first,count,total\n"
    );
    let text = test_folder.refused("log", &["csv", "run", "--out", "run/log.mcap"]);
    assert!(text.contains("run/log.mcap cannot be written: it is the log itself; choose another --out"), "{text}");
    assert!(
        test_folder.refused("log", &["csv", "run", "--out", "no/such/folder.csv"]).contains("no such file or folder")
    );
}

/// The three durations of a run in real time are the same in the log, in the summary and in the samples.
#[test]
fn durations_are_in_the_log_and_in_the_summary() {
    const KEYS: [&str; 3] = ["wake_up_lateness_us", "observation_to_command_us", "command_to_applied_us"];
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "5")]);
    let summary =
        test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "200", "--json"]).wait().expect(0).json();
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    let path = test_folder.log_path();
    let (_, content) = read_log(&path);
    let expected = [
        content.observations.iter().map(|o| 1 + u64::from(o.skipped)).sum(),
        content.commands.len() as u64,
        content
            .observations
            .iter()
            .filter(|o| o.header.flags & (flag::FIRST | flag::MISSED | flag::SKIPPED) == 0)
            .count() as u64,
    ];
    for (key, count) in KEYS.into_iter().zip(expected) {
        assert_eq!(summary[key]["count"], count, "{key}: {summary}");
        assert!(summary[key]["p50"].as_f64() > Some(0.0), "{key}: {summary}");
        assert_eq!(info[key], summary[key], "{key}");
    }
    assert_eq!(info["recounted"], false);
    let text = test_folder.tectum("log", &["info", "run"]).expect(0).stdout;
    assert!(text.contains("\ncommand to applied      p50 "), "{text}");

    // The durations of a torn log are counted anew from its samples, which is reported; the result is the same.
    let (messages, _) = support::bytes::messages(&fs::read(&path).unwrap());
    let last = messages.last().unwrap();
    test_folder.write_file("torn.mcap", &fs::read(&path).unwrap()[..last.offset + last.length]);
    let torn = test_folder.tectum("log", &["info", "torn.mcap", "--json"]).expect(0).json();
    assert_eq!((&torn["recounted"], &torn["state"]), (&true.into(), &"torn".into()));
    for key in KEYS {
        assert_eq!(torn[key], summary[key], "{key}");
    }
    // Lockstep has no durations.
    let test_folder = TestFolder::new();
    recorded(&test_folder, "1", "100");
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    assert!(KEYS.iter().all(|key| info[key] == Value::Null) && info["recounted"] == false, "{info}");
}

/// The losses of a real run are stated by the log, found by `info`, and marked by `csv` where they occurred.
#[test]
fn losses_are_stated_found_and_marked() {
    let test_folder = TestFolder::new();
    let summary = run_with_a_stopped_logger(&test_folder, 2560);
    assert!(summary["lost"].as_u64() > Some(0), "{summary}");
    let info = test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json();
    let (reader, content) = read_log(&test_folder.log_path());
    assert_eq!(info["gaps"], content.gaps.len());
    let mut rows = 0;
    for (i, name) in ["observation", "command", "learning"].into_iter().enumerate() {
        let (channel, lost) = (&info["channels"][i], reader.totals().unwrap().lost[i]);
        assert_eq!((&channel["lost_stated"], &channel["lost_found"]), (&lost.into(), &lost.into()), "{info}");
        assert_eq!(channel["agrees"], true, "{info}");
        let table = test_folder.tectum("log", &["csv", "run", "--channel", name]).expect(0).stdout;
        let marked: u64 = table.lines().skip(1).map(|line| fields(line)[8].parse::<u64>().unwrap()).sum();
        assert_eq!(marked, lost, "{name}");
        rows += table.lines().skip(1).filter(|line| !line.starts_with(',')).count();
    }
    assert_eq!(rows, content.observations.len() + content.commands.len() + content.learnings.len());
    let gaps = test_folder.tectum("log", &["csv", "run", "--channel", "gap"]).expect(0).stdout;
    assert_eq!(gaps.lines().count(), 1 + content.gaps.len());
    let first = &content.gaps[0];
    let name = ["observation", "command", "learning"][first.channel as usize];
    assert_eq!(gaps.lines().nth(1).unwrap(), format!("{name},{},{},{}", first.first, first.count, first.total));

    // A log that states less than it lost is reported.
    let path = test_folder.log_path();
    let (messages, end) = support::bytes::messages(&fs::read(&path).unwrap());
    let gap = messages.iter().find(|message| matches!(message.sample, LogRecord::Gap(_))).unwrap();
    let mut bytes = fs::read(&path).unwrap()[..end].to_vec();
    bytes[gap.offset + 16] ^= 1;
    test_folder.write_file("false.mcap", bytes);
    let info = test_folder.tectum("log", &["info", "false.mcap", "--json"]).expect(0).json();
    assert_eq!(info["channels"][first.channel as usize]["agrees"], false, "{info}");
    let text = test_folder.tectum("log", &["info", "false.mcap"]).expect(0).stdout;
    assert!(
        text.contains(&format!("/{name}: what the log states to be lost is not what its sequence numbers say")),
        "{text}"
    );
}

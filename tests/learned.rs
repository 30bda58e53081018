//! What a run has learned, in later runs: `--from`, `--freeze`, `--resume` with more ticks, and `tectum policy`.

mod support;

use std::fs;
use std::path::Path;

use serde_json::Value;
use support::{TECTUM, TestFolder, example, planner_scenario, read_json};
use tectum::encoder::{Axis, Map, naive};
use tectum::log::{LogReader, LogRecord};
use tectum::wire::{Command, Learning, Observation, flag};

/// `tectum run` with these arguments, which must succeed: its summary.
fn run(test_folder: &TestFolder, arguments: &[&str]) -> Value {
    test_folder.start(TECTUM, &[&["run", "--json"], arguments].concat()).wait().expect(0).json()
}

/// Observations, commands and learning records of a log.
fn samples(log: &Path) -> (Vec<Observation>, Vec<Command>, Vec<Learning>) {
    let mut all = (Vec::new(), Vec::new(), Vec::new());
    for record in LogReader::open(log).unwrap() {
        match record.unwrap() {
            LogRecord::Observation(s) => all.0.push(s),
            LogRecord::Command(s) => all.1.push(s),
            LogRecord::Learning(s) => all.2.push(s),
            LogRecord::Gap(gap) => panic!("{gap:?}"),
        }
    }
    all
}

/// A scenario of the arm with every tick in its log, and a policy that a run can be tested by.
fn arm(test_folder: &TestFolder, name: &str) -> String {
    test_folder.scenario(name, &[("every", "1"), ("rule", "\"learned-reward\"")], "")
}

/// A frozen run sends the policy's mean, learns nothing, ends with the weights that it began with, and replays; in
/// lockstep, in one process and in real time.
#[test]
fn a_frozen_run_changes_nothing() {
    let test_folder = TestFolder::new();
    let scenario = arm(&test_folder, "arm");
    let first = run(&test_folder, &[&scenario, "--ticks", "300", "--out", "first"]);
    assert_eq!((&first["started_from"], &first["frozen"]), (&Value::Null, &Value::Bool(false)));
    let frozen = ["--from", "first", "--freeze", "--ticks", "200", "--seed", "5"];
    let lockstep = run(&test_folder, &[&frozen[..], &["--out", "lockstep"]].concat());
    assert_eq!(lockstep["weights_hash"], first["weights_hash"]);
    assert_eq!(lockstep["started_from"]["source"], "first");
    assert_eq!(lockstep["started_from"]["tick"], 300);
    assert_eq!(lockstep["progress"][0]["when"], "at the start");
    assert_eq!(
        lockstep["progress"][0]["test_error_m"],
        lockstep["progress"].as_array().unwrap().last().unwrap()["test_error_m"]
    );
    assert_eq!(lockstep["warnings"].as_array().unwrap().len(), 0, "{lockstep}");
    let (_, commands, learnings) = samples(&test_folder.path().join("lockstep/log.mcap"));
    assert_eq!(commands.len(), 200);
    for (command, learning) in commands.iter().zip(&learnings) {
        assert_eq!(command.drawn, command.mean);
        assert_eq!(learning.header.flags & (flag::LEARNED | flag::TRACE_CUT), 0);
        assert_eq!(learning.noise, [0.0; 16]);
    }
    assert!(commands.iter().any(|command| command.mean[0] != 0.0));
    let one = run(&test_folder, &[&frozen[..], &["--mode", "in-process", "--out", "one"]].concat());
    assert_eq!((&one["weights_hash"], &one["loss_per_tick"]), (&first["weights_hash"], &lockstep["loss_per_tick"]));
    let real = run(&test_folder, &[&frozen[..4], &["20", "--mode", "realtime", "--out", "real"]].concat());
    assert_eq!(real["weights_hash"], first["weights_hash"]);
    for log in ["lockstep", "real"] {
        test_folder.tectum("replay", &[log]).expect(0);
    }
    // Without the copy in its folder, a run that began with what was learned before cannot be told.
    fs::remove_file(test_folder.path().join("lockstep/start.controller.safetensors")).unwrap();
    let refused = test_folder.refused("replay", &["lockstep"]);
    assert!(refused.contains("lockstep/start.controller.safetensors should hold that, and does not"), "{refused}");
}

/// A run that begins with a learner goes on learning: real time's checkpoints are loaded, the run is repeatable, equal
/// in one process and in three, survives kills, replays, and can be resumed.
#[test]
fn a_run_begins_with_what_another_has_learned() {
    let test_folder = TestFolder::new();
    let keys = [("every", "1"), ("period_ms", "5"), ("rule", "\"learned-reward\"")];
    let scenario = test_folder.scenario("arm", &keys, "\n[restart]\nbackoff_ms = 1\n");
    let real = run(&test_folder, &[&scenario, "--mode", "realtime", "--ticks", "400", "--out", "real"]);
    let from = ["--from", "real", "--seed", "3", "--ticks", "300"];
    let whole = run(&test_folder, &[&from[..], &["--out", "whole"]].concat());
    let fresh = run(&test_folder, &[&scenario, "--seed", "3", "--ticks", "300", "--out", "fresh"]);
    // It begins with the very policy with which the other ended.
    let error = |summary: &Value, row: usize| summary["progress"][row]["test_error_m"].as_f64().unwrap();
    let last = real["progress"].as_array().unwrap().len() - 1;
    assert_eq!(error(&whole, 0).to_bits(), error(&real, last).to_bits(), "{whole}\n{real}");
    assert_ne!(error(&whole, 0).to_bits(), error(&fresh, 0).to_bits());
    let one = run(&test_folder, &[&from[..], &["--mode", "in-process", "--out", "one"]].concat());
    assert_eq!(one["weights_hash"], whole["weights_hash"]);
    assert_ne!(fresh["weights_hash"], whole["weights_hash"]);
    // The exploration noise is that of this run's seed.
    let noise = |run: &str| samples(&test_folder.path().join(run).join("log.mcap")).2[0].noise;
    assert_eq!(noise("whole"), noise("fresh"));
    test_folder.tectum("replay", &["whole"]).expect(0);

    let mut killed = test_folder.start(TECTUM, &[&["run", "--json"], &from[..], &["--out", "killed"]].concat());
    let log = test_folder.path().join("killed/log.mcap");
    killed.wait_until("the log", || log.exists());
    killed.kill_child("tectum-controller");
    let killed = killed.wait().expect(0).json();
    assert_eq!(killed["weights_hash"], whole["weights_hash"]);

    // A checkpoint alone is enough, without its run's folder.
    fs::copy(test_folder.path().join("real/checkpoints/400.controller.safetensors"), test_folder.path().join("lone"))
        .unwrap();
    let lone = run(&test_folder, &["--from", "lone", "--seed", "3", "--ticks", "300", "--out", "of-lone"]);
    assert_eq!(lone["weights_hash"], whole["weights_hash"]);

    let mut arguments = from.to_vec();
    arguments.extend(["--checkpoint-every", "50", "--out", "half"]);
    arguments[5] = "150";
    run(&test_folder, &arguments);
    let rest = run(&test_folder, &["--resume", "half", "--ticks", "300", "--out", "rest"]);
    assert_eq!(rest["weights_hash"], whole["weights_hash"]);
    assert_eq!(rest["started_from"]["tick"], 400);
}

/// A run that came to its end goes on with more ticks, as one that had them from the beginning: also over a change of
/// the arm that the first part did not reach.
#[test]
fn a_finished_run_goes_on_with_more_ticks() {
    let test_folder = TestFolder::new();
    // A quick rule, on an arm with a change at tick 2400.
    let text = fs::read_to_string("scenarios/arm.toml").unwrap();
    let (head, rest) = text.split_once("\n[learner]").unwrap();
    let (_, tail) = rest.split_once("\n[gate]").unwrap();
    let text = format!("{head}\n[learner]\nrule = \"actor-critic\"\n[gate]{tail}");
    let scenario = test_folder.write_file("quick.toml", text).to_str().unwrap().to_owned();
    let whole = run(&test_folder, &[&scenario, "--ticks", "3000", "--out", "whole"]);
    run(&test_folder, &[&scenario, "--ticks", "1500", "--out", "half"]);
    let rest = run(&test_folder, &["--resume", "half", "--ticks", "3000", "--out", "rest"]);
    assert_eq!((&rest["weights_hash"], &rest["resumed_at"]), (&whole["weights_hash"], &Value::from(1500)));
    assert_eq!((&rest["ticks"], &rest["lost"]), (&Value::from(3000), &Value::from(0)));
    let commands = |run: &str| -> Vec<_> {
        let (_, commands, _) = samples(&test_folder.path().join(run).join("log.mcap"));
        commands.into_iter().filter(|command| command.header.tick >= 1500).map(|command| command.drawn).collect()
    };
    assert!(commands("rest") == commands("whole"));
    let again = run(&test_folder, &["--resume", "rest", "--ticks", "3600", "--out", "more"]);
    assert_eq!(again["ticks"], 3600);
    let text = test_folder.refused("run", &["--resume", "half", "--ticks", "1500", "--out", "no"]);
    assert!(
        text.ends_with("half: the run is at tick 1500 already; give --ticks more than that, and it goes on"),
        "{text}"
    );
}

/// A planner and a controller of one's own begin with what they knew, and are frozen.
#[test]
fn planners_and_controllers_of_ones_own_begin_with_it_too() {
    let test_folder = TestFolder::new();
    let planner = planner_scenario(&test_folder, "pendulum", "");
    run(&test_folder, &[&planner, "--ticks", "300", "--out", "first"]);
    let more = run(&test_folder, &["--from", "first", "--ticks", "200", "--seed", "9", "--out", "more"]);
    assert!(more["learner"]["refits"].as_u64() > run_count(&test_folder, "first", "refits"), "{more}");
    let frozen = run(&test_folder, &["--from", "first", "--ticks", "200", "--freeze", "--out", "frozen"]);
    assert_eq!(frozen["learner"]["refits"].as_u64(), run_count(&test_folder, "first", "refits"));
    let (_, commands, _) = samples(&test_folder.path().join("frozen/log.mcap"));
    assert!(commands.iter().all(|command| command.drawn == command.mean));
    for log in ["more", "frozen"] {
        test_folder.tectum("replay", &[log]).expect(0);
    }

    let text = format!(
        "name = \"pd\"\nticks = 1000\n[plant.arm]\nlengths = [1.0, 0.5]\n[controller]\nprogram = {:?}\n\
         [learner]\ngain = 0.1\nposition = \"theta_1\"\ntarget = \"target_x\"\n\
         [gate]\nmax_command = 0.05\n",
        example("pd").to_str().unwrap()
    );
    let own = test_folder.write_file("pd.toml", text).to_str().unwrap().to_owned();
    let first = run(&test_folder, &[&own, "--ticks", "1000", "--out", "own"]);
    let frozen = run(&test_folder, &["--from", "own", "--ticks", "300", "--freeze", "--out", "own-frozen"]);
    assert_eq!((frozen["frozen"].as_bool(), &frozen["started_from"]["tick"]), (Some(true), &Value::from(1000)));
    let more = run(&test_folder, &[&own, "--from", "own", "--ticks", "300", "--out", "own-more"]);
    let piped = ["--from", "own", "--ticks", "300", "--mode", "in-process", "--out", "own-one"];
    assert_eq!(run(&test_folder, &piped)["weights_hash"], more["weights_hash"]);
    assert_ne!(first["weights_hash"], more["weights_hash"]);
    for log in ["own-more", "own-frozen"] {
        test_folder.tectum("replay", &[log]).expect(0);
    }
}

fn run_count(test_folder: &TestFolder, run: &str, count: &str) -> Option<u64> {
    read_json(test_folder.path().join(run).join("summary.json"))["learner"][count].as_u64()
}

/// The exported file has all that another program needs: features by the paper's formula, times the weights, are the
/// commands of a frozen run.
#[test]
fn an_exported_policy_gives_the_same_commands() {
    let test_folder = TestFolder::new();
    let scenario = arm(&test_folder, "arm");
    let first = run(&test_folder, &[&scenario, "--ticks", "300", "--out", "first"]);
    run(&test_folder, &["--from", "first", "--freeze", "--ticks", "50", "--out", "frozen"]);
    let shown = test_folder.tectum("policy", &["show", "first", "--json"]).expect(0).json();
    assert_eq!(shown["weights_hash"], first["weights_hash"]);
    let exported = test_folder.tectum("policy", &["export", "first", "--out", "arm.safetensors", "--json"]);
    assert_eq!(exported.expect(0).json(), shown);
    let text = test_folder.tectum("policy", &["show", "first"]).expect(0).stdout;
    assert!(text.starts_with("arm, learned by learned-reward until tick 300 (run "), "{text}");

    let bytes = fs::read(test_folder.path().join("arm.safetensors")).unwrap();
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
    let facts: Value = serde_json::from_str(&header.metadata().as_ref().unwrap()["tectum_policy"]).unwrap();
    assert_eq!(facts, shown);
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let weights = file.tensor("weights").unwrap();
    let (outputs, features) = (weights.shape()[0], weights.shape()[1]);
    let weights: Vec<f32> = weights.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let names: Vec<&str> = facts["inputs"].as_array().unwrap().iter().map(|i| i["name"].as_str().unwrap()).collect();
    let maps: Vec<Map> = facts["maps"].as_array().unwrap().iter().map(|map| map_of(map, &names)).collect();
    let (observations, commands, _) = samples(&test_folder.path().join("frozen/log.mcap"));
    for (observation, command) in observations.iter().zip(&commands) {
        let inputs: Vec<f64> = observation.inputs.iter().map(|x| f64::from(*x)).collect();
        let encoded = naive::reference(&maps, &inputs, facts["normalise"].as_bool().unwrap());
        assert_eq!(encoded.len(), features);
        for output in 0..outputs {
            let row = &weights[output * features..(output + 1) * features];
            let mean: f64 = row.iter().zip(&encoded).map(|(w, g)| f64::from(*w) * g).sum();
            assert!((mean - f64::from(command.drawn[output])).abs() < 1e-5, "{mean} {}", command.drawn[output]);
        }
    }
    let again = test_folder.refused("policy", &["export", "first", "--out", "arm.safetensors"]);
    assert!(again.contains("arm.safetensors cannot be written: File exists"), "{again}");
    let planner = planner_scenario(&test_folder, "pendulum", "");
    run(&test_folder, &[&planner, "--ticks", "100", "--out", "planner"]);
    let none = test_folder.refused("policy", &["export", "planner", "--out", "x"]);
    assert!(none.contains("model-predictive has no linear policy to export"), "{none}");
    let text = test_folder.tectum("policy", &["show", "planner"]).expect(0).stdout;
    assert!(text.contains("weights  none"), "{text}");
}

fn map_of(map: &Value, names: &[&str]) -> Map {
    let axis = |axis: &Value| Axis {
        input: names.iter().position(|name| axis["input"] == *name).unwrap(),
        units: axis["units"].as_u64().unwrap() as usize,
        min: axis["min"].as_f64().unwrap(),
        max: axis["max"].as_f64().unwrap(),
        radius: axis["radius"].as_f64().unwrap(),
    };
    match &map.as_array().unwrap()[..] {
        [line] => Map::Line(axis(line)),
        [slow, fast] => Map::Plane(axis(slow), axis(fast)),
        _ => panic!("{map}"),
    }
}

/// One sentence names the first difference, and nothing is started.
#[test]
fn what_does_not_fit_is_refused() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    run(&test_folder, &[&scenario, "--ticks", "300", "--out", "paper"]);
    let refused = |arguments: &[&str], what: &str| {
        let text = test_folder.refused("run", &[arguments, &["--out", "no"]].concat());
        assert!(text.contains(what), "{text}");
        assert!(!test_folder.path().join("no").exists());
    };
    refused(&["arm", "--from", "paper"], "its learner is paper, here it is model-predictive");
    refused(&["relative", "--from", "paper"], "its learner is paper, here it is actor-critic");
    refused(&["eye", "--from", "paper"], "here");
    let own = test_folder.write_file("own.toml", fs::read_to_string("examples/pd.toml").unwrap());
    refused(&[own.to_str().unwrap(), "--from", "paper"], "its controller is tectum-controller, here it is");
    refused(&["--from", "nowhere"], "nowhere: this is neither the folder of a run nor a checkpoint");
    refused(&["--from", "paper/checkpoints/300.plant.safetensors"], "this is a checkpoint of the plant");
    refused(&["--from", "paper/log.mcap"], "the checkpoint is damaged");
    let file = test_folder.path().join("paper/checkpoints/300.controller.safetensors");
    let mut bytes = fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&file, bytes).unwrap();
    refused(&["--from", "paper"], "300.controller.safetensors: the checkpoint is damaged: its checksum does not fit");
    fs::remove_file(&file).unwrap();
    refused(&["--from", "paper"], "paper: there is no checkpoint of its controller");
    let usage = test_folder.tectum("run", &["--freeze"]);
    assert!(usage.code == Some(2) && usage.stderr.contains("--from"), "{usage:#?}");
}

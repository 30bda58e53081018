//! A link between two network namespaces, with a bad network in a third one between them: what is missed is what the
//! network lost, a cut is survived, and how long each leg takes beside bare UDP and plain zenoh.
//!
//! ```text
//! cargo test -p tectum-link --test network -- --ignored --test-threads 1              # as root
//! cargo test --release -p tectum-link --test network -- --ignored --nocapture study   # docs/performance.md's table
//! ```

mod common;

use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use common::{LINK, carriers};
use serde_json::Value;
use tectum_testkit::{Process, TestFolder, read_json};

/// Address of the plant's machine, and that of the network towards it.
const PLANT: [&str; 2] = ["10.77.1.1", "10.77.1.2"];
/// The same for the controller's machine.
const CONTROLLER: [&str; 2] = ["10.77.2.1", "10.77.2.2"];
const PORT: u16 = 7447;

fn ip(arguments: &str) -> Output {
    Command::new("ip").args(arguments.split(' ')).output().expect("the program ip")
}

/// Two machines and what lies between them.
struct Namespaces {
    /// Of the plant, the network and the controller.
    names: [String; 3],
}

impl Namespaces {
    fn new() -> Self {
        let id = std::process::id();
        let new = Self { names: ["plant", "network", "controller"].map(|name| format!("tectum-{id}-{name}")) };
        let [plant, network, controller] = &new.names;
        for name in &new.names {
            done(&format!("netns add {name}"));
            done(&format!("-n {name} link set lo up"));
        }
        for (machine, [own, other], link) in [(plant, PLANT, "p"), (controller, CONTROLLER, "c")] {
            done(&format!("-n {network} link add to-{link} type veth peer name net netns {machine}"));
            for (name, device, address) in [(machine, "net", own), (network, &*format!("to-{link}"), other)] {
                done(&format!("-n {name} addr add {address}/24 dev {device}"));
                done(&format!("-n {name} link set {device} up"));
            }
        }
        new
    }

    /// A command of the link in one of the namespaces.
    fn command(&self, namespace: usize, arguments: &[&str]) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[namespace], LINK]).args(arguments);
        command
    }
}

fn done(arguments: &str) {
    let output = ip(arguments);
    assert!(output.status.success(), "ip {arguments}: {}", String::from_utf8_lossy(&output.stderr));
}

impl Drop for Namespaces {
    fn drop(&mut self) {
        for name in &self.names {
            ip(&format!("netns del {name}"));
        }
    }
}

/// What a run over the network left.
struct LinkedRun {
    /// Summaries of the plant's and of the controller's machine.
    plant: Value,
    controller: Value,
    /// `link.json` of the plant's machine.
    link: Value,
    /// What the network counted.
    network: Value,
}

impl LinkedRun {
    /// Observations and commands that the network lost.
    fn injected(&self) -> u64 {
        ["to_listener", "to_connecting"].iter().map(|way| count(&self.network[way]["samples_lost"])).sum()
    }
}

fn count(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no count"))
}

/// A scenario in which the link may use the addresses of the namespaces.
fn scenario(folder: &TestFolder) -> String {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/arm.toml")).unwrap();
    let hosts = [PLANT, CONTROLLER].concat().join("\", \"");
    folder.write_file("arm.toml", format!("{text}\n[link]\nhosts = [\"{hosts}\"]\n"));
    "arm.toml".to_owned()
}

fn linked(namespaces: &Namespaces, carrier: &str, network: &[&str], ticks: u64) -> LinkedRun {
    linked_with(namespaces, carrier, network, ticks, |_| ())
}

/// A run in which `meanwhile` happens, which is given the plant's machine.
fn linked_with(
    namespaces: &Namespaces,
    carrier: &str,
    network: &[&str],
    ticks: u64,
    meanwhile: impl FnOnce(&mut Process),
) -> LinkedRun {
    let folders = [TestFolder::new(), TestFolder::new(), TestFolder::new()];
    let start = |i: usize, arguments: &[&str]| folders[i].start_command(namespaces.command(i, arguments));
    let (listen, to) = (format!("{}:{PORT}", CONTROLLER[1]), format!("{}:{PORT}", PLANT[0]));
    let between = start(1, &[&["network", "--json", "--listen", &listen, "--to", &to], network].concat());
    let (listen, connect) = (format!("{carrier}/{to}"), format!("{carrier}/{listen}"));
    let ticks = ticks.to_string();
    let machine = |i: usize, side: &str, meeting: [&str; 2]| -> Process {
        let scenario = scenario(&folders[i]);
        start(i, &[&[side, &*scenario, "--out", "run", "--json", "--ticks", &ticks], &meeting[..]].concat())
    };
    let mut plant = machine(0, "plant", ["--listen", &listen]);
    let controller = machine(2, "controller", ["--connect", &connect]);
    meanwhile(&mut plant);
    let [plant, controller] = [plant, controller].map(|run| run.wait().expect(0).json());
    between.signal("INT");
    let network = between.wait().expect(0).json();
    LinkedRun { plant, controller, link: read_json(folders[0].run_folder().join("link.json")), network }
}

#[test]
#[ignore = "needs root and network namespaces"]
fn what_is_missed_is_what_the_network_lost() {
    let namespaces = Namespaces::new();
    for [loss, delay] in [["0", "0"], ["0.01", "5"], ["0.05", "20"]] {
        let run = linked(&namespaces, "raw", &["--loss", loss, "--delay-ms", delay], 200);
        let (lost, missed, injected) = (count(&run.link["commands_lost"]), count(&run.plant["missed"]), run.injected());
        println!("loss {loss}, delay {delay} ms: injected {injected}, lost {lost}, missed {missed}");
        // At the very end an answer may be on its way when the run is over. A machine that stands still adds misses.
        assert!(lost.abs_diff(injected) <= 2, "{loss}, {delay}: lost {lost}, injected {injected}");
        assert!(missed + 2 >= lost, "{loss}, {delay}: missed {missed}, lost {lost}");
        assert!(count(&run.controller["ticks"]) > 100, "{}", run.controller);
    }
}

/// The cable to the plant's machine is pulled for so long, at tick 40 of `ticks`.
fn pulled(seconds: u64, ticks: u64, misses: std::ops::Range<u64>) {
    let namespaces = Namespaces::new();
    let cable = |state| done(&format!("-n {} link set to-p {state}", namespaces.names[1]));
    for carrier in carriers() {
        let run = linked_with(&namespaces, carrier, &[], ticks, |plant| {
            plant.wait_until_tick(40);
            cable("down");
            // The fault itself takes this long.
            std::thread::sleep(Duration::from_secs(seconds));
            cable("up");
        });
        let (missed, answered) = (count(&run.plant["missed"]), count(&run.controller["ticks"]));
        println!("{carrier}, {seconds} s: {missed} ticks missed of {ticks}, {answered} answered");
        assert!(misses.contains(&missed), "{carrier}: missed {missed}: {}", run.plant);
        // It goes on after it: before the cut there were not so many.
        assert!(answered > 60, "{carrier}: {}", run.controller);
    }
}

#[test]
#[ignore = "needs root and network namespaces"]
fn after_a_cut_of_three_seconds_the_run_goes_on() {
    pulled(3, 240, 50..180);
}

#[test]
#[ignore = "needs root and network namespaces, and takes some minutes"]
fn after_a_cut_of_a_minute_the_run_goes_on() {
    pulled(60, 1440, 1180..1360);
}

/// Percentiles of a leg or of round trips, in words.
fn words(percentiles: &Value) -> String {
    let number = |name: &str| percentiles[name].as_f64().unwrap_or(f64::NAN);
    format!("{:.0} / {:.0}", number("p50"), number("p99"))
}

/// Round trips without a run between the two namespaces, over the same network.
fn ping(namespaces: &Namespaces, carrier: &str, network: &[&str]) -> Value {
    let folder = TestFolder::new();
    let start = |i: usize, arguments: &[&str]| folder.start_command(namespaces.command(i, arguments));
    let (listen, to) = (format!("{}:{PORT}", CONTROLLER[1]), format!("{}:{PORT}", PLANT[0]));
    let between = start(1, &[&["network", "--listen", &listen, "--to", &to], network].concat());
    let answers = start(0, &["ping", "--listen", &format!("{carrier}/{to}")]);
    let measured = start(2, &["ping", "--connect", &format!("{carrier}/{listen}"), "--json"]).wait().expect(0).json();
    for process in [&between, &answers] {
        process.signal("INT");
    }
    between.wait().expect(0);
    answers.wait().expect(0);
    measured
}

/// The table of docs/performance.md.
#[test]
#[ignore = "a study: needs root and network namespaces, and takes ten minutes"]
fn study_of_loss_and_delay() {
    let namespaces = Namespaces::new();
    let legs = ["plant_to_link_us", "network_both_ways_us", "controllers_machine_us", "link_to_plant_us"];
    let whole = "observation_to_command_us";
    println!(
        "| lost | delay | bare UDP | plain zenoh | carrier: {} | {whole} | injected, missed | loss |",
        legs.join(" | ")
    );
    for (loss, delay) in [
        ("0", "0"),
        ("0", "5"),
        ("0", "20"),
        ("0.01", "0"),
        ("0.01", "5"),
        ("0.01", "20"),
        ("0.05", "0"),
        ("0.05", "5"),
        ("0.05", "20"),
    ] {
        let network = ["--loss", loss, "--delay-ms", delay];
        let bare = ping(&namespaces, "raw", &network);
        let zenoh = if cfg!(feature = "zenoh") { ping(&namespaces, "udp", &network) } else { Value::Null };
        for carrier in carriers() {
            let run = linked(&namespaces, carrier, &network, 300);
            let legs: Vec<String> = legs.iter().map(|leg| words(&run.link["legs"][leg])).collect();
            println!(
                "| {loss} | {delay} ms | {} | {} | {carrier}: {} | {} | {}, {} | {} |",
                words(&bare["round_trip_us"]),
                words(&zenoh["round_trip_us"]),
                legs.join(" | "),
                words(&run.link["legs"][whole]),
                run.injected(),
                run.plant["missed"],
                run.plant["loss_per_tick"],
            );
        }
    }
}

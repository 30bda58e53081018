//! Python's `mcap` and `mcap-ros2-support` read our logs unaided. Ignored by default, because it needs a Python with the
//! packages of `tests/python/requirements.txt`; `.ci/run` makes one and runs it:
//!
//! ```text
//! TECTUM_PYTHON=path/to/python cargo test --locked --test python -- --ignored
//! ```

mod support;

use std::fs;
use std::path::Path;

use support::{Place, TECTUM};

fn python() -> String {
    std::env::var("TECTUM_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

fn script(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(name);
    path.to_str().unwrap().to_owned()
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_whole_log_and_recomputes_its_means() {
    let python = python();
    let place = Place::new();
    let scenario = place.arm(&[("every", "1")]);
    place.run(&[&scenario, "--ticks", "20000", "--seed", "77"]).wait().expect(0);

    let checked = place.start(&python, &[&script("check_log.py"), "run/log.mcap"]).wait().expect(0).json();
    for topic in ["/observation", "/command", "/learning"] {
        assert_eq!(checked["topics"][topic]["messages"], 20000, "{checked}");
    }
    // In double precision; the controller's single precision differs by parts in 10^7 of the means.
    let means = [&script("recompute_means.py"), "run/log.mcap", "1e-7"];
    let recomputed = place.start(&python, &means).wait().expect(0).json();
    assert!(recomputed["largest_mean"].as_f64().unwrap() > 1e-4, "{recomputed}");
}

/// The summary is what a torn log lacks, and what tools that seek look for first.
#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_repaired_log() {
    let place = Place::new();
    let scenario = place.arm(&[("every", "1")]);
    place.run(&[&scenario, "--ticks", "1000"]).wait().expect(0);
    let whole = fs::read(place.run_folder().join("log.mcap")).unwrap();
    for share in [2, 3, 5, 7] {
        place.file("torn.mcap", &whole[..whole.len() - whole.len() / share]);
        let repair = ["log", "repair", "torn.mcap", "--out", &format!("{share}.mcap"), "--json"];
        let done = place.start(TECTUM, &repair).wait().expect(0).json();
        let read = [&script("check_repaired.py"), &format!("{share}.mcap")];
        let read = place.start(python(), &read.map(String::as_str)).wait().expect(0).json();
        assert_eq!(read["messages"], read["stated"], "{read}");
        for (i, topic) in ["/observation", "/command", "/learning"].into_iter().enumerate() {
            assert_eq!(read["messages"][topic], done["mended"]["messages"][i], "{read}");
        }
        assert_eq!(read["metadata"]["tectum.totals"]["repaired"], "true", "{read}");
        assert_eq!(read["metadata"]["tectum.repair"]["torn_at"], done["mended"]["torn_at"].to_string(), "{read}");
        assert_eq!(read["attachments"], serde_json::json!(["scenario.toml"]), "{read}");
    }
}

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_checkpoint() {
    let place = Place::new();
    let scenario = place.arm(&[]);
    let run = place.run(&[&scenario, "--ticks", "3000", "--json"]).wait().expect(0).json();
    let read = [&script("read_checkpoint.py"), "run/checkpoints/3000.controller.safetensors"];
    let read = place.start(python(), &read).wait().expect(0).json();
    assert_eq!(read["weights_hash"], run["weights_hash"], "{read}");
    assert_eq!(read["shape"], serde_json::json!([4, 320]), "{read}");
    assert_eq!(read["facts"]["tick"], 3000, "{read}");
    let names = read["tensors"].as_array().unwrap();
    assert!(names.iter().any(|name| name == "controller.learner.trace.tiles"), "{read}");
}

//! Python's `mcap` and `mcap-ros2-support` read our logs unaided. Ignored by default, because it needs a Python with the
//! packages of `tests/python/requirements.txt`; `.ci/run` makes one and runs it:
//!
//! ```text
//! TECTUM_PYTHON=path/to/python cargo test --locked --test python -- --ignored
//! ```

mod support;

use std::path::Path;

use support::Place;

#[test]
#[ignore = "needs a Python with the packages of tests/python/requirements.txt, named by TECTUM_PYTHON"]
fn python_reads_a_whole_log_and_recomputes_its_means() {
    let python = std::env::var("TECTUM_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(name);
        path.to_str().unwrap().to_owned()
    };
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

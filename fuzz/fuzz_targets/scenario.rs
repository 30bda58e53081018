//! Any text either parses and plans as a scenario or gives an error with a message. A valid scenario that is
//! written and parsed again has the same hash.

#![no_main]

use libfuzzer_sys::fuzz_target;
use tectum::scenario::Scenario;

fuzz_target!(|bytes: &[u8]| {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Scenario::parse(text, "fuzz.toml").and_then(Scenario::plan) {
        Ok(plan) => {
            let again = plan.scenario.to_toml();
            let other = Scenario::parse(&again, "again.toml").and_then(Scenario::plan);
            let other = other.unwrap_or_else(|error| panic!("{error}\n{again}"));
            assert_eq!(other.hash, plan.hash, "{again}");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});

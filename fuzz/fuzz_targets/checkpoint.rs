//! Any bytes either parse as a checkpoint or give an error that names the file. A parsed checkpoint either
//! restores into a plant or is refused with such an error. (The parser itself checks that writing the
//! checkpoint again gives the same bytes.)

#![no_main]

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use tectum::checkpoint::Checkpoint;
use tectum::runtime::PlantSide;
use tectum::scenario::{Plan, Scenario};

static PLAN: LazyLock<Plan> = LazyLock::new(|| Scenario::built_in("paper").unwrap().plan().unwrap());

fuzz_target!(|bytes: &[u8]| {
    match Checkpoint::parse(Path::new("7.plant.safetensors"), bytes) {
        Ok(checkpoint) => {
            let mut side = PlantSide::new(PLAN.simulated_plant().unwrap(), &PLAN);
            if let Err(error) = checkpoint.restore(&mut side) {
                assert!(error.to_string().starts_with("7.plant.safetensors: "));
            }
        }
        Err(error) => assert!(error.to_string().starts_with("7.plant.safetensors: ")),
    }
});

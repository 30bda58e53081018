//! Any bytes are a checkpoint or an error that names the file; and what is a checkpoint is what would be written again, and
//! either fits a plant or is refused.

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

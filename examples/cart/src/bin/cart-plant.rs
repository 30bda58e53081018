//! The plant's process.

use std::process::ExitCode;

use cart::Cart;
use tectum::runtime::run_plant;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Plant, "A cart on a track that has to stand at a target", |participant| {
        let scenario = &participant.plan.scenario;
        let cart = Cart::new((scenario.period_ms / 1000.0) as f32, scenario.seed);
        run_plant(participant, cart)
    })
}

//! A plant and a controller of your own, in a project of your own.
//!
//! | | |
//! |---|---|
//! | [`Cart`] | the plant: a cart on a track that has to stand at a target |
//! | [`ProportionalDerivative`] | the controller: pushes towards the target, and brakes |
//! | `src/bin/` | a process for each |
//! | `tests/cart.rs` | both without processes, and the whole run with processes that are killed |

mod cart;
mod proportional_derivative;

pub use cart::Cart;
pub use proportional_derivative::ProportionalDerivative;

//! wip
#![allow(missing_docs, dead_code, clippy::too_many_arguments, clippy::needless_range_loop)]
mod evidence;
mod features;
mod functions;
mod layout;
mod linalg;
mod regression;
mod weighted;
#[cfg(test)]
mod tests;

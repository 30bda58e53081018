//! Empty. iceoryx2 0.10 lists `bindgen` as a build dependency on every system, and calls it only where it is itself
//! compiled on QNX (`build.rs` of iceoryx2-pal-posix: `#[cfg(target_os = "nto")]`). The real crate and what it needs
//! were 20 s of processor time of a build from nothing.

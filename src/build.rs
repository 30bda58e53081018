//! Build script: puts the build's identity (package version and git commit) into `TECTUM_BUILD`.
//!
//! The identity is part of the handshake between processes and of every log's header. Outside a git checkout the
//! commit reads `unknown`, and the version alone identifies the build.

use std::{path::Path, process::Command};

fn main() {
    let commit = Command::new("git")
        .args(["rev-parse", "--short=12", "HEAD"])
        .output()
        .ok()
        .filter(|out| out.status.success())
        .and_then(|out| String::from_utf8(out.stdout).ok())
        .map_or_else(|| "unknown".to_owned(), |text| text.trim().to_owned());
    let version = std::env::var("CARGO_PKG_VERSION").expect("cargo sets CARGO_PKG_VERSION");
    println!("cargo:rustc-env=TECTUM_BUILD={version}+{commit}");
    println!("cargo:rerun-if-changed=src/build.rs");
    // HEAD's log grows with every commit and checkout, which is when the identity changes.
    if Path::new(".git/logs/HEAD").exists() {
        println!("cargo:rerun-if-changed=.git/logs/HEAD");
    }
}

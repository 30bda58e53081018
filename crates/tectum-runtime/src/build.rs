//! Build script: puts the build's identity (package version and git commit) into `TECTUM_BUILD`.
//!
//! The identity is part of the handshake between processes and of every log's header. Outside a git checkout the
//! commit reads `unknown`, and the version alone identifies the build.

use std::{path::Path, process::Command};

/// What `git rev-parse` answers, if there is a git and this is a checkout.
fn git(arguments: &[&str]) -> Option<String> {
    let out = Command::new("git").arg("rev-parse").args(arguments).output().ok()?;
    let text = String::from_utf8(out.stdout).ok().filter(|_| out.status.success())?;
    Some(text.trim().to_owned())
}

fn main() {
    let commit = git(&["--short=12", "HEAD"]).unwrap_or_else(|| "unknown".to_owned());
    let version = std::env::var("CARGO_PKG_VERSION").expect("cargo sets CARGO_PKG_VERSION");
    println!("cargo:rustc-env=TECTUM_BUILD={version}+{commit}");
    println!("cargo:rerun-if-changed=src/build.rs");
    // HEAD's log grows with every commit and checkout, which is when the identity changes. A second worktree has a log
    // of its own elsewhere.
    if let Some(log) = git(&["--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists()) {
        println!("cargo:rerun-if-changed={log}");
    }
}

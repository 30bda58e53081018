//! `tectum link`: starts `tectum-link`, which is built by itself because few runs need it.

use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::process::{Command, ExitCode};

use clap::Args;
use tectum::process::print_error_line;
use tectum::runtime::exit;

/// The program.
const PROGRAM: &str = "tectum-link";

#[derive(Debug, Args)]
#[command(
    disable_help_flag = true,
    after_help = "\
Examples:
  tectum link key > link.key                                           a key for both machines
  tectum link plant arm --listen udp/192.168.7.2:7447 --key link.key        on the robot's computer
  tectum link controller arm --connect udp/192.168.7.2:7447 --key link.key  on yours"
)]
pub struct Arguments {
    /// What tectum-link is started with (tectum link --help)
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    let beside = std::env::current_exe().ok().map(|own| own.with_file_name(PROGRAM)).filter(|path| path.is_file());
    let program = beside.unwrap_or_else(|| PROGRAM.into());
    let error = Command::new(&program).args(&arguments.arguments).exec();
    let text = match error.kind() {
        std::io::ErrorKind::NotFound => format!(
            "tectum: there is no program {PROGRAM} beside this one or in PATH; build it with `cargo build -p {PROGRAM} \
             --release`"
        ),
        _ => format!("tectum: {} cannot be started: {error}", program.display()),
    };
    print_error_line(&text);
    ExitCode::from(exit::INPUT)
}

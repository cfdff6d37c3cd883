//! The `graphfix` binary: hands its arguments to [`graphfix::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    graphfix::cli::run(std::env::args_os())
}

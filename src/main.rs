//! The `graphfix` binary: hands its arguments to [`graphfix::cli`].

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    graphfix::cli::run(std::env::args_os())
}

//! Door: the command line, one file per subcommand.
//!
//! A command that cannot do its work ends with a non-zero exit code and one line on standard
//! error, `error[CODE]: what is wrong (what to do)`.

mod bearer;
mod cargo;
mod compare;
mod config;
mod connection;
mod database;
mod demo;
mod device_stream;
mod evaluate;
mod failure;
mod files;
mod health;
mod host;
mod keys;
mod load;
mod option_arguments;
mod output;
mod progress;
mod recording;
mod replay;
mod secrets;
mod serve;
mod simulate;
mod solve;
mod solve_report;
mod stream;
mod stream_raw;
mod tenants;
mod trust;
mod worker;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::refusal::Code;

use output::note;

pub(crate) use failure::Failure;

/// GNSS positioning: observations in, positions out.
#[derive(Debug, Parser)]
#[command(name = "graphfix", version, about, arg_required_else_help = true)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Solve(Box<solve::SolveArguments>),
    Compare(Box<compare::CompareArguments>),
    Config(config::ConfigArguments),
    Evaluate(Box<evaluate::EvaluateArguments>),
    Simulate(simulate::SimulateArguments),
    Demo(demo::DemoArguments),
    Serve(Box<serve::ServeArguments>),
    Worker(worker::WorkerArguments),
    Stream(Box<stream::StreamArguments>),
    Load(load::LoadArguments),
    Health(health::HealthArguments),
    Replay(replay::ReplayArguments),
    Keys(keys::KeysArguments),
    Tenants(tenants::TenantsArguments),
    Secrets(secrets::SecretsArguments),
}

impl Command {
    fn run(self) -> Result<(), Failure> {
        match self {
            Self::Solve(arguments) => solve::run(&arguments),
            Self::Compare(arguments) => compare::run(&arguments),
            Self::Config(arguments) => config::run(&arguments),
            Self::Evaluate(arguments) => evaluate::run(&arguments),
            Self::Simulate(arguments) => simulate::run(&arguments),
            Self::Demo(arguments) => demo::run(arguments),
            Self::Serve(arguments) => serve::run(*arguments),
            Self::Worker(arguments) => worker::run(arguments),
            Self::Stream(arguments) => stream::run(*arguments),
            Self::Load(arguments) => load::run(arguments),
            Self::Health(arguments) => health::run(&arguments),
            Self::Replay(arguments) => replay::run(&arguments),
            Self::Keys(arguments) => keys::run(arguments),
            Self::Tenants(arguments) => tenants::run(arguments),
            Self::Secrets(arguments) => secrets::run(arguments),
        }
    }
}

/// Runs the command in `arguments`. The first argument is the name of the program.
///
/// Exit codes: 0 done, 1 the command failed, 2 the command line was not understood.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let command = match CommandLine::try_parse_from(arguments) {
        Ok(command_line) => command_line.command,
        Err(refusal) => return refuse(&refusal),
    };
    match command.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            note!("{failure}");
            ExitCode::FAILURE
        }
    }
}

/// Prints help or version if requested, otherwise the reason in one line.
fn refuse(refusal: &clap::Error) -> ExitCode {
    if !refusal.use_stderr() {
        // Err: standard output is closed, so nobody reads the help.
        refusal.print().ok();
        return ExitCode::SUCCESS;
    }
    note!("{}", usage_failure(refusal));
    ExitCode::from(2)
}

/// The first paragraph of clap's message, in one line.
fn usage_failure(refusal: &clap::Error) -> Failure {
    use clap::error::ErrorKind;
    let message = match refusal.kind() {
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => "no command was given".to_owned(),
        _ => {
            let text = refusal.render().to_string();
            let paragraph = text.lines().take_while(|line| !line.is_empty());
            let line = paragraph.map(str::trim).collect::<Vec<_>>().join(" ");
            line.trim_start_matches("error: ").to_owned()
        }
    };
    Failure::of(Code::Usage, message)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn refusal(line: &str) -> String {
        let error = CommandLine::try_parse_from(line.split(' ')).unwrap_err();
        usage_failure(&error).to_string()
    }

    #[test]
    fn the_command_line_is_consistent() {
        CommandLine::command().debug_assert();
    }

    #[test]
    fn a_refusal_is_one_line() {
        for line in ["graphfix", "graphfix fly", "graphfix config --sett a=b"] {
            let text = refusal(line);
            assert!(text.starts_with("error[USAGE]: ") && !text.contains('\n'), "{text}");
        }
    }
}

//! The database that a command works in beside the service.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches};

use crate::app;
use crate::config::{STANDARD_DATABASE, ServiceConfiguration};
use crate::refusal::Code;
use crate::store::{Author, COMMAND_LINE, Store};
use crate::tenant::Tenant;

use super::Failure;

/// Longest file with a URL that is read (bytes).
const FILE_BYTES: u64 = 4096;

/// The arguments that name the service's database: its URL, or the file with the URL, or neither.
#[derive(Clone, Debug)]
pub(super) struct DatabaseArgument {
    url: Option<String>,
    file: Option<PathBuf>,
}

/// Both arguments as they are given.
#[derive(Clone, Debug, Args)]
struct Given {
    /// The service's database: sqlite://FILE (serve creates it if absent) or postgres://….
    /// Default: sqlite://graphfix.db.
    #[arg(long, value_name = "URL", env = "GRAPHFIX_DATABASE", global = true)]
    database: Option<String>,
    /// File with that URL, which may have a password.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_DATABASE_FILE", global = true)]
    database_file: Option<PathBuf>,
}

impl Args for DatabaseArgument {
    fn augment_args(command: Command) -> Command {
        Given::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Given::augment_args_for_update(command)
    }
}

impl FromArgMatches for DatabaseArgument {
    /// An argument on the command line takes precedence over the environment variable of the other.
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let Given { database: url, database_file: file } = Given::from_arg_matches(matches)?;
        let is_argument = |id| matches.value_source(id) == Some(ValueSource::CommandLine);
        let conflict = |message| Err(clap::Error::raw(ErrorKind::ArgumentConflict, message));
        match (is_argument("database"), is_argument("database_file")) {
            (true, true) => conflict("--database and --database-file exclude each other"),
            (true, false) => Ok(Self { url, file: None }),
            (false, true) => Ok(Self { url: None, file }),
            (false, false) if url.is_some() && file.is_some() => {
                conflict("GRAPHFIX_DATABASE and GRAPHFIX_DATABASE_FILE exclude each other")
            }
            (false, false) => Ok(Self { url, file }),
        }
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl DatabaseArgument {
    /// Opens the database, which a service may be using.
    ///
    /// # Errors
    /// It cannot be opened, or its schema is another version's.
    pub(super) async fn open(&self) -> Result<Store, Failure> {
        Ok(Store::open_beside(&self.url()?, &app::random_node()).await?)
    }

    /// The same for a database that must exist.
    ///
    /// # Errors
    /// As for [`Self::open`], or there is no such file.
    pub(super) async fn open_existing(&self) -> Result<Store, Failure> {
        match Store::file_of(&self.url()?)? {
            Some(file) if !file.exists() => {
                let message = format!("{}: there is no such database", file.display());
                Err(Failure::of(Code::FileNotReadable, message))
            }
            _ => self.open().await,
        }
    }

    /// Replaces the database of the configuration file by this one, if one is given.
    pub(super) fn choose(self, configuration: &mut ServiceConfiguration) {
        if let Some(url) = self.url {
            (configuration.database, configuration.database_file) = (url, None);
        }
        if let Some(file) = self.file {
            configuration.database = STANDARD_DATABASE.to_owned();
            configuration.database_file = Some(file);
        }
    }

    /// URL of the database.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(super) fn url(&self) -> Result<String, Failure> {
        match (&self.url, &self.file) {
            (_, Some(file)) => url_in(file),
            (Some(url), None) => Ok(url.clone()),
            (None, None) => Ok(STANDARD_DATABASE.to_owned()),
        }
    }
}

/// Reads the URL of the database from the file that the configuration names, if it names one.
///
/// # Errors
/// The file cannot be read.
pub(super) fn read_url(configuration: &mut ServiceConfiguration) -> Result<(), Failure> {
    if let Some(file) = configuration.database_file.take() {
        configuration.database = url_in(&file)?;
    }
    Ok(())
}

/// The URL in a file, without white space around it.
///
/// # Errors
/// The file cannot be read.
fn url_in(path: &Path) -> Result<String, Failure> {
    let mut text = String::new();
    let file = File::open(path);
    let read = file.and_then(|file| file.take(FILE_BYTES).read_to_string(&mut text));
    read.map_err(|error| {
        Failure::of(Code::FileNotReadable, format!("{}: {error}", path.display()))
    })?;
    Ok(text.trim().to_owned())
}

/// The author of a command's changes, for the audit log.
pub(super) fn author() -> Author {
    let (actor, tenant) = (COMMAND_LINE.to_owned(), Tenant::operator());
    Author { actor, tenant, request: String::new(), node: app::host_name() }
}

//! The database that a command works in beside the service.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use clap::Args;

use crate::app;
use crate::config::{STANDARD_DATABASE, ServiceConfiguration};
use crate::refusal::Code;
use crate::store::{Author, COMMAND_LINE, Store};
use crate::tenant::Tenant;

use super::Failure;

/// Longest file with a URL that is read (bytes).
const FILE_BYTES: u64 = 4096;

/// The arguments that name the service's database.
#[derive(Clone, Debug, Args)]
pub(super) struct DatabaseArgument {
    /// The service's database: sqlite://FILE or postgres://…. Default: sqlite://graphfix.db.
    #[arg(
        long,
        value_name = "URL",
        env = "GRAPHFIX_DATABASE",
        global = true,
        conflicts_with = "database_file"
    )]
    database: Option<String>,
    /// File with that URL, which may have a password.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_DATABASE_FILE", global = true)]
    database_file: Option<PathBuf>,
}

impl DatabaseArgument {
    /// Opens the database, which a service may be using.
    ///
    /// # Errors
    /// It cannot be opened, or its schema is another version's.
    pub(super) async fn open(&self) -> Result<Store, Failure> {
        Ok(Store::open_beside(&self.url()?, &app::random_node()).await?)
    }

    /// URL of the database.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(super) fn url(&self) -> Result<String, Failure> {
        match (&self.database, &self.database_file) {
            (_, Some(file)) => url_in(file),
            (Some(url), None) => Ok(url.clone()),
            (None, None) => Ok(STANDARD_DATABASE.to_owned()),
        }
    }
}

/// Prefers the database of the arguments to that of the configuration's file.
pub(super) fn choose(
    configuration: &mut ServiceConfiguration,
    url: Option<String>,
    file: Option<PathBuf>,
) {
    if let Some(url) = url {
        (configuration.database, configuration.database_file) = (url, None);
    }
    if let Some(file) = file {
        configuration.database = STANDARD_DATABASE.to_owned();
        configuration.database_file = Some(file);
    }
}

/// Reads the URL of the database from its file, if the configuration names one.
///
/// # Errors
/// The file cannot be read.
pub(super) fn read_url(configuration: &mut ServiceConfiguration) -> Result<(), Failure> {
    if let Some(file) = configuration.database_file.take() {
        configuration.database = url_in(&file)?;
    }
    Ok(())
}

/// The URL in a file, without blanks around it.
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

/// Who works by a command, for the audit log.
pub(super) fn author() -> Author {
    let (actor, tenant) = (COMMAND_LINE.to_owned(), Tenant::operator());
    Author { actor, tenant, request: String::new(), node: app::host_name() }
}

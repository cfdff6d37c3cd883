//! The database that a command works in beside the service.

use clap::Args;

use crate::app;
use crate::store::{Author, COMMAND_LINE, Store};
use crate::tenant::Tenant;

use super::Failure;

/// The argument that names the service's database.
#[derive(Debug, Args)]
pub(super) struct DatabaseArgument {
    /// The service's database: sqlite://FILE or postgres://….
    #[arg(
        long,
        value_name = "URL",
        env = "GRAPHFIX_DATABASE",
        default_value = "sqlite://graphfix.db",
        global = true
    )]
    database: String,
}

impl DatabaseArgument {
    /// Opens the database, which a service may be using.
    ///
    /// # Errors
    /// It cannot be opened, or its schema is another version's.
    pub(super) async fn open(&self) -> Result<Store, Failure> {
        Ok(Store::open_beside(&self.database, &app::random_node()).await?)
    }
}

/// Who works by a command, for the audit log.
pub(super) fn author() -> Author {
    let (actor, tenant) = (COMMAND_LINE.to_owned(), Tenant::operator());
    Author { actor, tenant, request: String::new(), node: app::host_name() }
}

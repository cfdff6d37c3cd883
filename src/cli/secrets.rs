//! `graphfix secrets`: under which keys the secrets in a database are stored.

use std::fmt::Write as _;

use clap::{Args, Subcommand};

use crate::clock::unix_ms;
use crate::refusal::Code;
use crate::store::{Act as AuditedAct, Store};
use crate::tenant::Tenant;

use super::database::{DatabaseArgument, author};
use super::output::print;
use super::{Failure, host};

/// Lists the keys under which secrets are stored (passwords at casters, secrets of webhooks), and
/// gives up those whose key is lost. `serve --secrets-key-file` names the key.
#[derive(Debug, Args)]
pub(super) struct SecretsArguments {
    #[command(subcommand)]
    act: Act,
    #[command(flatten)]
    database: DatabaseArgument,
}

#[derive(Debug, Subcommand)]
enum Act {
    /// Lists the ids of the keys, and how many secrets each of them encrypts.
    List,
    /// Removes the secrets that a lost key encrypts. Their casters are then contacted without a
    /// password, and their webhooks are no longer called. The service must be stopped.
    Forget {
        /// Id of the key.
        #[arg(value_name = "KEY")]
        key: String,
    },
}

/// Does what one subcommand asks.
///
/// # Errors
/// The database cannot be opened, or fails.
pub(super) fn run(arguments: SecretsArguments) -> Result<(), Failure> {
    let text = host::block_on(async {
        let store = arguments.database.open().await?;
        let done = act(&store, arguments.act).await;
        store.close().await;
        done
    })?;
    print(&text)
}

/// Does what one subcommand asks; returns the text to print.
///
/// # Errors
/// No secret is stored under the key that is to be forgotten, or the database fails.
async fn act(store: &Store, act: Act) -> Result<String, Failure> {
    match act {
        Act::List => {
            let mut text = String::new();
            for under in store.secrets_by_key().await? {
                let key = under.key.as_deref().unwrap_or("not encrypted");
                let count = under.secrets;
                writeln!(text, "{key}: {count} secrets").expect("a text takes any text");
            }
            Ok(text)
        }
        Act::Forget { key } => {
            let (tenant, change) = (Tenant::operator(), "gives the secrets under it up".to_owned());
            let act = AuditedAct { call: "Secrets.Forget", tenant: &tenant, object: &key, change };
            let forgotten = store.forget_secrets(&key, &author().does(act, unix_ms())).await?;
            if forgotten == 0 {
                let message = format!("no secret is stored under the key {key:?}");
                return Err(Failure::new(Code::Usage, message, "see graphfix secrets list"));
            }
            Ok(format!("{forgotten} secrets are given up\n"))
        }
    }
}

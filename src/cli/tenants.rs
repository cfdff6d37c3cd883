//! `graphfix tenants`: the tenants in a database, which a service may be using.

use std::fmt::Write as _;

use clap::{Args, Subcommand};

use crate::quotas::{Meters, QuotaError, StoredAmounts, TenantInfo, TenantQuotas};
use crate::tenant::{Quotas, Tenant};

use super::database::{DatabaseArgument, author};
use super::output::print;
use super::{Failure, host, keys};

/// Tenants read at a time.
const PAGE: usize = 1000;
/// Largest quota.
const MOST: f64 = 9e15;

/// Sets the quotas of tenants in the service's database, also while it runs, and lists them. A
/// running service takes a change within a second.
#[derive(Debug, Args)]
pub(super) struct TenantsArguments {
    #[command(subcommand)]
    act: Act,
    #[command(flatten)]
    database: DatabaseArgument,
}

#[derive(Debug, Subcommand)]
enum Act {
    /// Sets all quotas of a tenant. A quota that is not given is removed.
    Set {
        /// Name of the tenant.
        #[arg(value_name = "NAME", value_parser = keys::tenant)]
        tenant: Tenant,
        /// Sessions that may be stored, open and closed.
        #[arg(long, value_name = "N")]
        sessions: Option<u64>,
        /// Epochs per second, averaged over ten seconds.
        #[arg(long, value_name = "RATE", value_parser = number)]
        epochs_per_s: Option<f64>,
        /// Processor time of the solvers per minute (s), including that of jobs.
        #[arg(long, value_name = "SECONDS", value_parser = number)]
        cpu_s_per_minute: Option<f64>,
        /// Bytes of stored epochs and solutions, approximately.
        #[arg(long, value_name = "BYTES")]
        stored_bytes: Option<u64>,
        /// Bytes of the files of jobs and uploads that are stored.
        #[arg(long, value_name = "BYTES")]
        job_bytes: Option<u64>,
    },
    /// Lists all tenants by name, with their quotas and their stored amounts.
    List,
}

fn number(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "this is not a number".to_owned())?;
    let is_quota = (0.0..=MOST).contains(&number);
    is_quota.then_some(number).ok_or_else(|| "a quota is from 0 to 9e15".to_owned())
}

/// Does what one subcommand asks.
///
/// # Errors
/// The database cannot be opened, or the store fails.
pub(super) fn run(arguments: TenantsArguments) -> Result<(), Failure> {
    let text = host::block_on(async {
        let store = match arguments.act {
            Act::Set { .. } => arguments.database.open().await?,
            Act::List => arguments.database.open_existing().await?,
        };
        let done = async {
            let tenants = TenantQuotas::open(store.clone(), Meters::default()).await?;
            let done = act(&tenants, arguments.act).await;
            tenants.close().await;
            done
        };
        let done: Result<String, QuotaError> = done.await;
        store.close().await;
        Ok(done?)
    })?;
    print(&text)
}

/// Does what one subcommand asks; returns the text to print.
async fn act(tenants: &TenantQuotas, act: Act) -> Result<String, QuotaError> {
    match act {
        Act::Set { tenant, sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes } => {
            let most = |number: Option<u64>| number.map(|number| number.min(MOST as u64));
            let (sessions, stored_bytes) = (most(sessions), most(stored_bytes));
            let job_bytes = most(job_bytes);
            let quotas =
                Quotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes };
            let info = tenants.set(&tenant, &quotas, None, &author()).await?;
            Ok(line(&info))
        }
        Act::List => {
            let (mut text, mut after) = (String::new(), String::new());
            loop {
                let page = tenants.list(&after, PAGE).await?;
                let Some(last) = page.last() else { return Ok(text) };
                after = last.tenant.to_string();
                text.extend(page.iter().map(line));
            }
        }
    }
}

/// A line about a tenant. It has no present rates: only the running service knows these.
fn line(info: &TenantInfo) -> String {
    let TenantInfo { tenant, quotas, stored, .. } = info;
    let Quotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes } = quotas;
    let of = |limit: Option<String>| limit.map_or(String::new(), |limit| format!(" of {limit}"));
    let limit = |limit: Option<u64>| of(limit.map(|limit| limit.to_string()));
    let amount = |of: fn(&StoredAmounts) -> u64| {
        stored.as_ref().map_or("unknown".to_owned(), |stored| of(stored).to_string())
    };
    let mut line = format!(
        "{tenant}: {} sessions{}, {} bytes{}, {} bytes of jobs{}",
        amount(|stored| stored.of_sessions.sessions),
        limit(*sessions),
        amount(|stored| stored.of_sessions.stored_bytes),
        limit(*stored_bytes),
        amount(|stored| stored.job_bytes),
        limit(*job_bytes)
    );
    let rates = [(epochs_per_s, "epochs a second"), (cpu_s_per_minute, "s of processor a minute")];
    for (rate, unit) in rates {
        if let Some(rate) = rate {
            write!(line, ", at most {rate} {unit}").expect("a text takes any text");
        }
    }
    line + "\n"
}

impl From<QuotaError> for Failure {
    fn from(error: QuotaError) -> Self {
        Self::of(error.code(), error)
    }
}

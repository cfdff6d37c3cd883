//! `graphfix serve`: the service.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::Args;
use tokio::net::TcpListener;

use crate::app;
use crate::config::{S3Keys, ServiceConfiguration};
use crate::feeds::{FeedOptions, TimeLimits};
use crate::refusal::Code;

use super::database::{DatabaseArgument, read_url};
use super::{Failure, host};

/// Environment variable with the key that encrypts stored secrets.
const SECRETS_KEY: &str = "GRAPHFIX_SECRETS_KEY";

/// Runs the service until it is interrupted.
#[derive(Clone, Debug, Args)]
pub(super) struct ServeArguments {
    /// Configuration file (TOML). The other arguments override its values, and a value that is in
    /// neither has its default.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_CONFIG")]
    config: Option<PathBuf>,
    /// Address and port to listen on. An address other than loopback needs an existing key
    /// (graphfix keys create), and TLS or --plaintext. Default: 127.0.0.1:8080.
    #[arg(long, value_name = "ADDRESS:PORT", env = "GRAPHFIX_LISTEN")]
    listen: Option<SocketAddr>,
    /// Certificate of the service (PEM), followed by the intermediate certificates. The port then
    /// accepts TLS only. A changed file is read within seconds, without a restart. Default: none.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_TLS_CERTIFICATE")]
    tls_certificate: Option<PathBuf>,
    /// Private key of the certificate (PEM), without a password.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_TLS_KEY")]
    tls_key: Option<PathBuf>,
    /// Certificate authorities of clients (PEM). Each client then needs a certificate signed by one
    /// of them, in addition to its key. Default: none.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_TLS_CLIENT_CA")]
    tls_client_ca: Option<PathBuf>,
    /// Certificate revocation lists (PEM), one of each of these authorities. Certificates on them
    /// are refused. A changed file is read within seconds. Default: none.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_TLS_CLIENT_CRL")]
    tls_client_crl: Option<PathBuf>,
    /// Listen on an address other than loopback without TLS. Use it if a proxy or load balancer in
    /// front of the service terminates TLS.
    #[arg(long, env = "GRAPHFIX_PLAINTEXT")]
    plaintext: bool,
    /// Host name or address that clients use for the service, besides localhost; may be repeated.
    #[arg(long, value_name = "NAME", env = "GRAPHFIX_HOSTS", value_delimiter = ',')]
    host: Vec<String>,
    /// Name of this node in the log and in answers. Default: the host's name and a random suffix.
    #[arg(long, value_name = "NAME", env = "GRAPHFIX_NODE")]
    node: Option<String>,
    #[command(flatten)]
    database: DatabaseArgument,
    /// Join the cluster of nodes on the database, which must be on Postgres. URL is the address at
    /// which the other nodes reach this node, such as http://10.0.0.2:8080. Default: no cluster.
    #[arg(long, value_name = "URL", env = "GRAPHFIX_CLUSTER")]
    cluster: Option<String>,
    /// Certificate authorities of the other nodes (PEM). Default: those that browsers trust.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_CLUSTER_CA")]
    cluster_ca: Option<PathBuf>,
    /// File with the key (64 hexadecimal digits) that encrypts stored secrets: passwords for
    /// casters and secrets of webhooks. The variable GRAPHFIX_SECRETS_KEY may contain the key
    /// itself. Default: none.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_SECRETS_KEY_FILE")]
    secrets_key_file: Option<PathBuf>,
    /// File with a former key. At the start, secrets that it has encrypted are encrypted again with
    /// the present key; may be repeated.
    #[arg(
        long,
        value_name = "FILE",
        env = "GRAPHFIX_SECRETS_FORMER_KEY_FILES",
        value_delimiter = ','
    )]
    secrets_former_key_file: Vec<PathBuf>,
    /// Host to which the service may connect at the request of clients, such as a caster: HOST,
    /// HOST:PORT or *.DOMAIN; may be repeated. Default: none.
    #[arg(long, value_name = "HOST", env = "GRAPHFIX_FETCH_HOSTS", value_delimiter = ',')]
    fetch_host: Vec<String>,
    /// Allow these hosts to have addresses of private networks.
    #[arg(long, env = "GRAPHFIX_FETCH_PRIVATE")]
    fetch_private: bool,
    /// URL of RINEX navigation files to fetch each hour, with placeholders for the date such as
    /// {yyyy} and {ddd}; may be repeated.
    #[arg(long, value_name = "URL", env = "GRAPHFIX_NAV_ARCHIVES", value_delimiter = ' ')]
    nav_archive: Vec<String>,
    /// Phase centres of antennas (ANTEX), for sessions that name the rover's antenna.
    /// Default: none.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_ANTEX")]
    antex: Option<PathBuf>,
    /// Table of the geoid's heights (PGM of GeographicLib, GTX or ISG), for sessions and jobs with
    /// the option geoid. Default: none.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_GEOID_FILE")]
    geoid: Option<PathBuf>,
    /// Send traces of requests to a collector that takes OTLP over gRPC, such as
    /// http://127.0.0.1:4317, in a build with the feature otlp. Default: none.
    #[arg(long, value_name = "URL", env = "GRAPHFIX_OTLP_ENDPOINT")]
    otlp_endpoint: Option<String>,
    /// Filter of the log, such as info or graphfix=debug.
    #[arg(long, value_name = "FILTER", env = "GRAPHFIX_LOG")]
    log: Option<String>,
    /// Log one JSON object per line.
    #[arg(long, env = "GRAPHFIX_LOG_JSON")]
    log_json: bool,
}

impl ServeArguments {
    /// The configuration from the file and the arguments, checked.
    fn configuration(self) -> Result<ServiceConfiguration, Failure> {
        let mut configuration = configuration_of(self.config.as_deref())?;
        configuration.listen = self.listen.unwrap_or(configuration.listen);
        configuration.plaintext |= self.plaintext;
        let tls = &mut configuration.tls;
        tls.certificate_file = self.tls_certificate.or(tls.certificate_file.take());
        tls.key_file = self.tls_key.or(tls.key_file.take());
        tls.client_ca_file = self.tls_client_ca.or(tls.client_ca_file.take());
        tls.client_crl_file = self.tls_client_crl.or(tls.client_crl_file.take());
        configuration.hosts.extend(self.host);
        configuration.node = self.node.unwrap_or(configuration.node);
        self.database.choose(&mut configuration);
        let secrets = &mut configuration.secrets;
        secrets.key_file = self.secrets_key_file.or(secrets.key_file.take());
        secrets.former_key_files.extend(self.secrets_former_key_file);
        // The key is no argument, because everybody on the machine sees arguments.
        secrets.key = std::env::var(SECRETS_KEY).ok().filter(|key| !key.is_empty());
        let cluster = &mut configuration.cluster;
        cluster.address = self.cluster.unwrap_or(std::mem::take(&mut cluster.address));
        cluster.ca_file = self.cluster_ca.or(cluster.ca_file.take());
        configuration.fetch.hosts.extend(self.fetch_host);
        configuration.fetch.private_addresses |= self.fetch_private;
        configuration.navigation.archives.extend(self.nav_archive);
        configuration.geoid_file = self.geoid.or(configuration.geoid_file);
        configuration.antennas.antex = self.antex.or(configuration.antennas.antex);
        let telemetry = &mut configuration.telemetry;
        telemetry.otlp_endpoint = self.otlp_endpoint.or(telemetry.otlp_endpoint.take());
        configuration.log.filter = self.log.unwrap_or(configuration.log.filter);
        configuration.log.json |= self.log_json;
        if configuration.node.is_empty() {
            configuration.node = app::random_node(); // The log needs the name, too.
        }
        configuration.check()?;
        read_url(&mut configuration)?;
        Ok(configuration)
    }
}

/// The configuration of a file, or the default one.
///
/// # Errors
/// The file cannot be read, or is no configuration.
pub(super) fn configuration_of(file: Option<&Path>) -> Result<ServiceConfiguration, Failure> {
    let Some(path) = file else { return Ok(ServiceConfiguration::standard()) };
    let text = std::fs::read_to_string(path).map_err(|error| {
        let message = format!("{}: {error}", path.display());
        Failure::of(Code::FileNotReadable, message)
    })?;
    let mut configuration = ServiceConfiguration::from_toml(&text)?;
    if let Some(s3) = &mut configuration.jobs.s3 {
        s3.keys = s3_keys();
    }
    Ok(configuration)
}

/// The credentials of an S3 service in the environment, in the variables that other S3 clients use.
fn s3_keys() -> Option<S3Keys> {
    let value = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    Some(S3Keys {
        id: value("AWS_ACCESS_KEY_ID")?,
        secret: value("AWS_SECRET_ACCESS_KEY")?,
        token: value("AWS_SESSION_TOKEN"),
    })
}

/// Runs the service.
///
/// # Errors
/// The configuration is refused, the address is in use, or others can reach it without a key or
/// TLS. The database cannot be opened, or another service has taken it meanwhile.
pub(super) fn run(arguments: ServeArguments) -> Result<(), Failure> {
    let configuration = arguments.configuration()?;
    host::start_log(&configuration)?;
    host::block_on(serve(configuration))
}

async fn serve(configuration: ServiceConfiguration) -> Result<(), Failure> {
    let listener = TcpListener::bind(configuration.listen).await.map_err(|error| {
        let message = format!("{}: {error}", configuration.listen);
        Failure::of(Code::AddressUnavailable, message)
    })?;
    let opened = app::open(&configuration, TimeLimits::standard(), FeedOptions::standard());
    let app = opened.await?;
    app.check_address(configuration.listen, configuration.plaintext)?;
    let address = listener.local_addr().unwrap_or(configuration.listen);
    let scheme = if configuration.tls.certificate_file.is_some() { "https" } else { "http" };
    tracing::info!(%address, "serving gRPC and REST; see {scheme}://{address}/");
    app.serve(listener, host::interrupted()).await?;
    tracing::info!("stopped; everything acknowledged is stored");
    Ok(())
}

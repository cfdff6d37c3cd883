//! Configuration: one struct per concern, every value named, explained and echoed back.
//!
//! A configuration is a profile plus overrides by name. Nothing here reads a file, an argument or
//! the environment: the doors do, and pass the texts to [`PositioningOptions::set`].

mod choices;
mod cluster;
mod dashboard;
mod error;
mod graph_options;
mod graph_table;
mod integrity_options;
mod integrity_table;
mod jobs;
mod limits;
mod option_specification;
mod option_table;
mod output_options;
mod output_table;
mod positioning;
mod rtk_options;
mod rtk_table;
mod s3;
mod secrets;
mod service;
mod telemetry;
mod tls;

pub use choices::{
    BandSet, Beyond, ConstellationSet, DopplerUse, IonosphereModel, KernelLaw, Mode, OutputFrame,
    Profile, TroposphereMapping, TroposphereModel, WeightModel,
};
pub use cluster::ClusterConfiguration;
pub use dashboard::DashboardConfiguration;
pub use error::ConfigError;
pub use graph_options::GraphOptions;
pub use integrity_options::IntegrityOptions;
pub use jobs::JobsConfiguration;
pub use limits::{IntakeLimits, Limits};
pub use option_table::OptionEntry;
pub use output_options::OutputOptions;
pub use positioning::PositioningOptions;
pub(crate) use positioning::REFERENCE_CN0_DB_HZ;
pub use rtk_options::RtkOptions;
pub use s3::{S3Configuration, S3Keys};
pub use secrets::SecretsConfiguration;
pub use service::{
    AntennasConfiguration, BasesConfiguration, CasterConfiguration, FetchConfiguration,
    LogConfiguration, NavigationConfiguration, NetworkConfiguration, ServiceConfiguration,
};
pub use service::{RETENTION_MAX_DAYS, STANDARD_DATABASE, ServiceConfigurationError};
pub use telemetry::TelemetryConfiguration;
pub use tls::TlsConfiguration;

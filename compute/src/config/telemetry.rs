//! Options of the traces that the service sends.

use std::path::PathBuf;

use serde::Deserialize;

/// Traces of requests for OpenTelemetry. Without an endpoint there are none.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TelemetryConfiguration {
    /// Address of a collector that takes OTLP over gRPC, such as `http://127.0.0.1:4317`.
    pub otlp_endpoint: Option<String>,
    /// PEM file of the authorities that sign the collector's certificate, in place of the usual
    /// ones.
    pub otlp_ca_file: Option<PathBuf>,
    /// Part of the requests that are traced, 0 to 1, where the caller's `traceparent` does not
    /// decide it.
    pub otlp_ratio: f64,
}

impl TelemetryConfiguration {
    /// No traces.
    pub(super) const fn standard() -> Self {
        Self { otlp_endpoint: None, otlp_ca_file: None, otlp_ratio: 1.0 }
    }

    /// What is out of range; `None` if nothing is.
    pub(super) fn wrong(&self) -> Option<&'static str> {
        let is_part = (0.0..=1.0).contains(&self.otlp_ratio);
        (!is_part).then_some("telemetry.otlp_ratio must be from 0 to 1")
    }
}

// `serde(default)` asks for `Default`. Nothing else uses it.
impl Default for TelemetryConfiguration {
    fn default() -> Self {
        Self::standard()
    }
}

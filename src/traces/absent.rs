//! The types that replace traces in a build without the feature `otlp`. They have no values.

use std::convert::Infallible;
use std::time::Instant;

use crate::config::TelemetryConfiguration;

use super::{TraceMeters, TracesError, Work};

/// Replaces the identity of a span.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TraceContext(Infallible);

impl TraceContext {
    /// Nothing: no request is traced.
    pub(crate) fn parse(_: &str) -> Option<Self> {
        None
    }
}

/// Replaces a span.
#[derive(Debug)]
pub(crate) struct TraceSpan(Infallible);

impl TraceSpan {
    pub(crate) fn context(&self) -> TraceContext {
        match self.0 {}
    }

    pub(crate) fn name(&mut self, _: &'static str) {
        match self.0 {}
    }

    pub(crate) fn set(&mut self, _: &'static str, _: impl ToString) {
        match self.0 {}
    }

    pub(crate) fn forget(self) {
        match self.0 {}
    }

    pub(crate) fn fail(&mut self) {
        match self.0 {}
    }

    pub(crate) fn done(&self, _: Work, _: (Instant, Instant)) {
        match self.0 {}
    }
}

/// Replaces the tracer.
#[derive(Clone, Debug)]
pub(crate) struct Tracer(Infallible);

impl Tracer {
    pub(crate) fn meters(&self) -> &TraceMeters {
        match self.0 {}
    }

    pub(crate) fn begin(&self, _: Work, _: Option<TraceContext>, _: Instant) -> Option<TraceSpan> {
        match self.0 {}
    }

    pub(crate) fn begin_linked(&self, _: Work, _: TraceContext) -> Option<TraceSpan> {
        match self.0 {}
    }
}

/// Replaces the task that sends spans.
#[derive(Debug)]
pub(crate) struct Exporter(Infallible);

impl Exporter {
    /// Refuses a configuration that names a collector.
    ///
    /// # Errors
    /// [`TracesError::NotBuilt`].
    pub(crate) fn start(
        configuration: &TelemetryConfiguration,
        _: &str,
    ) -> Result<Option<Self>, TracesError> {
        match configuration.otlp_endpoint {
            None => Ok(None),
            Some(_) => Err(TracesError::NotBuilt),
        }
    }

    pub(crate) const fn tracer(&self) -> &Tracer {
        match self.0 {}
    }

    pub(crate) async fn close(self) {
        match self.0 {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    #[test]
    fn a_collector_is_a_feature_of_the_build() {
        let without = TelemetryConfiguration::default();
        assert!(Exporter::start(&without, "node").unwrap().is_none());
        let otlp_endpoint = Some("http://127.0.0.1:4317".to_owned());
        let refused = Exporter::start(&TelemetryConfiguration { otlp_endpoint, ..without }, "node");
        let refused = refused.unwrap_err();
        assert_eq!(refused.code(), Code::FeatureNotBuilt);
        assert!(refused.to_string().contains("\"otlp\""), "{refused}");
    }
}

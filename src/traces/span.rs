//! A timed part of the work for a request, which OpenTelemetry calls a span.

use std::time::Instant;

use super::{TraceContext, Tracer, Work};

/// Most attributes of a span.
const ATTRIBUTES: usize = 12;

/// A span that has begun. It ends when it is dropped.
#[derive(Debug)]
pub(crate) struct TraceSpan {
    tracer: Tracer,
    span: Option<EndedSpan>,
}

/// A span that waits for the collector.
#[derive(Debug)]
pub(super) struct EndedSpan {
    pub(super) work: Work,
    /// Its name; empty for that of its work.
    pub(super) name: &'static str,
    pub(super) context: TraceContext,
    /// Id of the span within which it is.
    pub(super) parent: Option<u64>,
    /// What it follows from.
    pub(super) link: Option<TraceContext>,
    pub(super) begun: Instant,
    pub(super) ended: Instant,
    pub(super) attributes: Vec<(&'static str, String)>,
    /// The service is at fault.
    pub(super) has_failed: bool,
}

impl TraceSpan {
    pub(super) fn new(
        tracer: Tracer,
        work: Work,
        caller: Option<TraceContext>,
        begun: Instant,
    ) -> Self {
        let context = caller.map_or_else(TraceContext::random, TraceContext::child);
        let span = EndedSpan {
            work,
            name: "",
            context,
            parent: caller.map(|caller| caller.span_id),
            link: None,
            begun,
            ended: begun,
            attributes: Vec::new(),
            has_failed: false,
        };
        Self { tracer, span: Some(span) }
    }

    pub(super) fn linked(mut self, origin: TraceContext) -> Self {
        if let Some(span) = &mut self.span {
            span.link = Some(origin);
        }
        self
    }

    /// What names it.
    pub(crate) fn context(&self) -> TraceContext {
        self.span.as_ref().expect("a span is there until it is dropped").context
    }

    /// Gives it a name of its own.
    pub(crate) fn name(&mut self, name: &'static str) {
        if let Some(span) = &mut self.span {
            span.name = name;
        }
    }

    /// Adds an attribute, up to a limit.
    pub(crate) fn set(&mut self, key: &'static str, value: impl ToString) {
        if let Some(span) = self.span.as_mut().filter(|span| span.attributes.len() < ATTRIBUTES) {
            span.attributes.push((key, value.to_string()));
        }
    }

    /// Ends it without a trace of it.
    pub(crate) fn forget(mut self) {
        self.span = None;
    }

    /// Notes that the service is at fault.
    pub(crate) fn fail(&mut self) {
        if let Some(span) = &mut self.span {
            span.has_failed = true;
        }
    }

    /// Records work within it that has been done.
    pub(crate) fn done(&self, work: Work, (begun, ended): (Instant, Instant)) {
        let mut within = Self::new(self.tracer.clone(), work, Some(self.context()), begun);
        if let Some(mut span) = within.span.take() {
            span.ended = ended;
            self.tracer.end(span);
        }
    }
}

impl Drop for TraceSpan {
    fn drop(&mut self) {
        if let Some(mut span) = self.span.take() {
            span.ended = Instant::now();
            self.tracer.end(span);
        }
    }
}

//! Spans, which are timed parts of the work for a request, and the tracer that begins them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use tokio::sync::mpsc;

use super::{TraceContext, TraceMeters, Work};

/// Most attributes of a span.
const ATTRIBUTES: usize = 12;

/// Begins traces. Clones share the queue.
#[derive(Clone, Debug)]
pub(crate) struct Tracer(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    queue: mpsc::Sender<EndedSpan>,
    meters: TraceMeters,
    ratio: f64,
    /// Number of requests that could have begun a trace.
    asked: AtomicU64,
}

impl Tracer {
    pub(super) fn new(queue: mpsc::Sender<EndedSpan>, ratio: f64) -> Self {
        let (meters, asked) = (TraceMeters::default(), AtomicU64::new(0));
        Self(Arc::new(Shared { queue, meters, ratio, asked }))
    }

    /// What happened to the spans.
    pub(crate) fn meters(&self) -> &TraceMeters {
        &self.0.meters
    }

    /// The span of work that continues a trace, or begins one; `None` if it is not traced.
    pub(crate) fn begin(
        &self,
        work: Work,
        caller: Option<TraceContext>,
        since: Instant,
    ) -> Option<TraceSpan> {
        let is_traced = caller.map_or_else(|| self.is_chosen(), |caller| caller.is_traced);
        is_traced.then(|| TraceSpan::new(self.clone(), work, caller, since))
    }

    /// The span of work with a trace of its own, linked to the span from which it follows; `None`
    /// if it is not traced. So a stream that lasts for days does not become one trace.
    pub(crate) fn begin_linked(&self, work: Work, origin: TraceContext) -> Option<TraceSpan> {
        let begun =
            self.is_chosen().then(|| TraceSpan::new(self.clone(), work, None, Instant::now()));
        begun.map(|span| span.linked(origin))
    }

    /// Whether the next request is traced if its caller has not decided. The chosen requests are
    /// evenly spaced, so their fraction is exact.
    fn is_chosen(&self) -> bool {
        let number = self.0.asked.fetch_add(1, Ordering::Relaxed) as f64;
        let ratio = self.0.ratio;
        (number * ratio).floor() < ((number + 1.0) * ratio).floor()
    }

    fn end(&self, span: EndedSpan) {
        if self.0.queue.try_send(span).is_err() {
            self.0.meters.dropped.inc();
        }
    }
}

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
    /// Its name; empty for the name of its work.
    pub(super) name: &'static str,
    pub(super) context: TraceContext,
    /// Id of the parent span.
    pub(super) parent: Option<u64>,
    /// The span from which it follows.
    pub(super) link: Option<TraceContext>,
    pub(super) begun: Instant,
    pub(super) ended: Instant,
    pub(super) attributes: Vec<(&'static str, String)>,
    /// The service is at fault.
    pub(super) has_failed: bool,
}

impl TraceSpan {
    fn new(tracer: Tracer, work: Work, caller: Option<TraceContext>, begun: Instant) -> Self {
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

    fn linked(mut self, origin: TraceContext) -> Self {
        if let Some(span) = &mut self.span {
            span.link = Some(origin);
        }
        self
    }

    /// Its identity.
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

    /// Ends it without recording it.
    pub(crate) fn forget(mut self) {
        self.span = None;
    }

    /// Notes that the service is at fault.
    pub(crate) fn fail(&mut self) {
        if let Some(span) = &mut self.span {
            span.has_failed = true;
        }
    }

    /// Records completed work as a child of this span.
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

#[cfg(test)]
mod tests {
    use super::super::Trace;
    use super::*;

    fn tracer(ratio: f64, queue: usize) -> (Tracer, mpsc::Receiver<EndedSpan>) {
        let (sender, receiver) = mpsc::channel(queue);
        (Tracer::new(sender, ratio), receiver)
    }

    fn begun(tracer: &Tracer, caller: Option<TraceContext>) -> Option<TraceSpan> {
        tracer.begin(Work::Request, caller, Instant::now())
    }

    #[test]
    fn the_ratio_chooses_that_part_of_the_requests() {
        for (ratio, chosen) in [(0.0, 0), (0.25, 250), (1.0, 1000)] {
            let (tracer, _queue) = tracer(ratio, 1);
            let count = (0..1000).filter(|_| begun(&tracer, None).is_some()).count();
            assert_eq!(count, chosen, "{ratio}");
        }
    }

    #[test]
    fn the_caller_decides_where_it_has() {
        let (tracer, _queue) = tracer(0.0, 8);
        let caller = TraceContext::random();
        let continued = begun(&tracer, Some(caller)).unwrap();
        assert_eq!(continued.context().trace_id, caller.trace_id);
        assert_ne!(continued.context().span_id, caller.span_id);
        assert!(begun(&tracer, Some(TraceContext { is_traced: false, ..caller })).is_none());
    }

    #[test]
    fn a_full_queue_drops_and_counts() {
        let (tracer, mut queue) = tracer(1.0, 2);
        (0..5).for_each(|_| drop(begun(&tracer, None)));
        assert_eq!(tracer.meters().dropped.get(), 3);
        assert_eq!((0..5).filter_map(|_| queue.try_recv().ok()).count(), 2);
    }

    #[test]
    fn a_push_of_a_stream_has_a_trace_of_its_own() {
        let (tracer, mut queue) = tracer(1.0, 8);
        let (tracer, context) = (tracer.clone(), TraceContext::random());
        let trace = Trace { tracer, context, request_id: "".into() };
        drop((trace.push(true), trace.push(false)));
        let [streamed, called] = [queue.try_recv().unwrap(), queue.try_recv().unwrap()];
        assert_ne!(streamed.context.trace_id, trace.context.trace_id);
        assert_eq!(streamed.link, Some(trace.context));
        assert_eq!(called.context.trace_id, trace.context.trace_id);
        assert_eq!((called.parent, called.link), (Some(trace.context.span_id), None));
    }
}

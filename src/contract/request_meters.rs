//! Meters of the requests and connections of both doors.

use std::time::Duration;

use crate::meters::{self, Counter, Family, Gauge, Histogram, Label};

/// Meters of the requests and connections of both doors. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct RequestMeters {
    /// Open connections.
    pub(crate) connections: Gauge,
    pub(super) requests: Family<[(&'static str, &'static str); 2], Counter>,
    pub(super) seconds: Family<Label, Histogram, fn() -> Histogram>,
}

/// The outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// It was answered, or its answer has begun.
    Answered,
    /// It was refused: the client is at fault, or must wait.
    Refused,
    /// The service is at fault.
    Failed,
}

impl Outcome {
    const ALL: [Self; 3] = [Self::Answered, Self::Refused, Self::Failed];

    const fn name(self) -> &'static str {
        match self {
            Self::Answered => "answered",
            Self::Refused => "refused",
            Self::Failed => "failed",
        }
    }
}

fn outcomes_of(door: &'static str) -> [(&'static str, Outcome); 3] {
    Outcome::ALL.map(|outcome| (door, outcome))
}

const fn door(is_grpc: bool) -> &'static str {
    if is_grpc { "grpc" } else { "rest" }
}

impl RequestMeters {
    pub(super) fn new() -> Self {
        let requests = Family::default();
        // An outcome that has not occurred is reported as 0.
        for (door, outcome) in ["grpc", "rest"].into_iter().flat_map(outcomes_of) {
            drop(requests.get_or_create(&[("door", door), ("outcome", outcome.name())]));
        }
        let seconds = Family::new_with_constructor(meters::times as fn() -> Histogram);
        for door in ["grpc", "rest"] {
            drop(seconds.get_or_create(&[("door", door)]));
        }
        Self { connections: Gauge::default(), requests, seconds }
    }

    /// Counts a request, with the time until the head of its answer.
    pub(crate) fn count(&self, is_grpc: bool, outcome: Outcome, elapsed: Duration) {
        let door = door(is_grpc);
        self.requests.get_or_create(&[("door", door), ("outcome", outcome.name())]).inc();
        self.seconds.get_or_create(&[("door", door)]).observe(elapsed.as_secs_f64());
    }
}

#[cfg(test)]
mod tests {
    use prometheus_client::encoding::text::encode;
    use prometheus_client::registry::Registry;

    use super::*;

    #[test]
    fn requests_are_counted_by_door_and_outcome() {
        let meters = RequestMeters::new();
        meters.count(true, Outcome::Answered, Duration::from_millis(3));
        meters.count(false, Outcome::Refused, Duration::from_millis(30));
        let mut registry = Registry::default();
        registry.register("requests", "Requests", meters.requests.clone());
        registry.register("seconds", "Seconds", meters.seconds.clone());
        let mut text = String::new();
        encode(&mut text, &registry).unwrap();
        for line in [
            "requests_total{door=\"grpc\",outcome=\"answered\"} 1",
            "requests_total{door=\"rest\",outcome=\"refused\"} 1",
            "requests_total{door=\"rest\",outcome=\"failed\"} 0",
            "seconds_bucket{le=\"0.005\",door=\"grpc\"} 1",
            "seconds_bucket{le=\"0.005\",door=\"rest\"} 0",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
        }
    }
}

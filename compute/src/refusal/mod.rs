//! Stable codes of refusals and failures, each with its class and its remedy, defined once.
//!
//! An error of any module has a [`Code`]. The doors turn the code's [`Class`] into a status. Users
//! find the table in `docs/errors.md`, and at `/docs/errors` of a service. A command may give the
//! remedy in terms of its own arguments.

mod code;

pub use code::Code;

/// The kind of a refusal. Each door has one status for each class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// The request is wrong, and the same request stays wrong.
    Malformed,
    /// The call does not take a body of this content type.
    MediaType,
    /// The request is larger than allowed.
    TooLarge,
    /// The session or base does not exist.
    NotFound,
    /// The call does not exist.
    Route,
    /// The path exists, but not with this method.
    Method,
    /// The request contradicts stored data.
    Conflict,
    /// What is stored has changed since the caller read it.
    Changed,
    /// The session or base is not in a state to serve the request.
    Precondition,
    /// The request needs a key that is in force.
    Unauthenticated,
    /// Requests for this host, from this origin or with this key are not accepted.
    Forbidden,
    /// The request or its answer took too long.
    Timeout,
    /// A limit is reached; the same request may succeed later.
    Exhausted,
    /// The service cannot serve now.
    Unavailable,
    /// The service failed.
    Internal,
    /// No request is refused with it. It appears in the health of a stream or archive, in the log,
    /// or when a command ends.
    NoCall,
}

impl Class {
    /// Whether the same request may be sent again unchanged, as users read it; empty if no request
    /// is refused with it.
    pub const fn retry(self) -> &'static str {
        match self {
            Self::Malformed
            | Self::MediaType
            | Self::TooLarge
            | Self::NotFound
            | Self::Route
            | Self::Method
            | Self::Conflict
            | Self::Changed
            | Self::Precondition
            | Self::Unauthenticated
            | Self::Forbidden => "no",
            Self::Timeout => "yes",
            Self::Exhausted | Self::Unavailable => "after the delay",
            Self::Internal => "once",
            Self::NoCall => "",
        }
    }

    /// Whether time cures it: such a refusal has a delay.
    pub const fn is_passing(self) -> bool {
        matches!(self, Self::Exhausted | Self::Unavailable)
    }
}

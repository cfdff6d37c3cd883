//! How long requests to a bucket are repeated, and the items of its lists.

use std::time::Duration;

/// How often a request is repeated that fails for a temporary reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Patience {
    /// A caller waits for the answer.
    Call,
    /// A run waits for it, and would lose its work.
    Run,
}

/// An object of a list.
pub(crate) struct Listed {
    /// Its name.
    pub(crate) name: String,
    /// Its size (bytes).
    pub(crate) bytes: u64,
    /// Time since it was last put, by the clocks of the server and of this machine.
    pub(crate) age: Duration,
}

/// A page of a list, and the token of the next page.
pub(crate) type ListedPage = (Vec<Listed>, Option<String>);

//! Changes that must not affect an answer: restarts, snapshots, the order of the input.

mod restoring;
mod windows;

//! What must not change an answer: restarts, snapshots, the order of what comes.

mod restoring;
mod windows;

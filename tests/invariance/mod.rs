//! What must not affect an answer: restarts and snapshots of estimators and sessions, pauses and
//! rates of a receiver.

mod moves;
mod restoring;
mod windows;

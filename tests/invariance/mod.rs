//! Restarts and snapshots of estimators and sessions, which must not affect an answer.

mod restoring;
mod windows;

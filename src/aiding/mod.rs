//! Desk: the ephemerides that sessions ask for and uploads fill.

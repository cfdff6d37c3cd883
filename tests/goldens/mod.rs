//! Answers compared with a truth: a survey, a reference receiver, a simulator.

mod antennas;
mod ekf;
mod fgo;
mod measured;
mod rinex;
mod rtk;
mod spp;

//! The estimator that sessions, jobs and the command line run.

use std::sync::Arc;

use crate::config::{Mode, PositioningOptions};
use crate::gnss::{Ecef, Epoch, Navigation, Solution};

use super::spp::SinglePoint;

/// What an epoch needs beside its own observations.
#[derive(Clone, Copy, Debug)]
pub struct Aiding<'a> {
    /// Ephemerides and ionosphere coefficients.
    pub navigation: &'a Navigation,
}

/// Turns epochs into solutions, one at a time.
///
/// In mode `spp` an epoch is solved from its own observations alone. The previous position serves
/// as the point to start from, which saves iterations and moves the answer by less than 0.1 mm.
/// That position is all the state there is: [`Self::resume`] restores it bit by bit.
#[derive(Debug)]
pub struct Estimator {
    options: Arc<PositioningOptions>,
    start: Option<Ecef>,
    single_point: SinglePoint,
}

impl Estimator {
    /// An estimator that has seen nothing yet.
    pub fn new(options: PositioningOptions) -> Self {
        let single_point = SinglePoint::new(&options);
        Self { options: Arc::new(options), start: None, single_point }
    }

    /// What it was told.
    pub fn options(&self) -> &PositioningOptions {
        &self.options
    }

    /// Solves one epoch. No position is an answer too, with its reasons.
    pub fn advance(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) -> Solution {
        let solution = match self.options.mode {
            Mode::Spp => {
                self.single_point.solve(epoch, aiding.navigation, &self.options, self.start)
            }
        };
        self.resume(&solution);
        solution
    }

    /// Goes on as if `last` had been its own last answer.
    pub fn resume(&mut self, last: &Solution) {
        self.start = last.estimate.as_ref().map(|estimate| estimate.position);
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for Estimator {
    fn clone(&self) -> Self {
        Self {
            options: Arc::clone(&self.options),
            start: self.start,
            single_point: self.single_point.with_fresh_memory(),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        if !Arc::ptr_eq(&self.options, &source.options) {
            *self = source.clone();
        }
        self.start = source.start;
    }
}

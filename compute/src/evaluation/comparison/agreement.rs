//! Distances between the positions of two methods.

use std::collections::BTreeMap;

use super::Method;
use crate::evaluation::ErrorStatistics;
use crate::gnss::{Ecef, GpsTime, LocalFrame, Solution, Status};

/// Horizontal distance between the positions of two methods, epoch by epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreement {
    /// Indices of the two methods in the comparison.
    pub pair: (usize, usize),
    /// Distances over the epochs that both answer (m).
    pub all: ErrorStatistics,
    /// Distances over the epochs that both fix (m), if there are any.
    pub fixed: Option<ErrorStatistics>,
    /// Of the epochs that both fix, the shares within 5 cm and within 10 cm.
    pub fixed_within_5_and_10_cm: Option<(f64, f64)>,
}

impl Agreement {
    /// The agreement of two methods; `None` if no epoch has answers of both.
    pub(super) fn of(methods: &[Method], pair: (usize, usize)) -> Option<Self> {
        let of_first: BTreeMap<GpsTime, &Solution> =
            methods[pair.0].with_position().map(|solution| (solution.time, solution)).collect();
        let (mut all_m, mut fixed_m) = (Vec::new(), Vec::new());
        for solution in methods[pair.1].with_position() {
            let Some(first) = of_first.get(&solution.time) else { continue };
            let Some(distance_m) = horizontal_distance_m(first, solution) else { continue };
            all_m.push(distance_m);
            if first.status == Status::Fixed && solution.status == Status::Fixed {
                fixed_m.push(distance_m);
            }
        }
        let within = |limit_m: f64| {
            let count = fixed_m.iter().filter(|distance_m| **distance_m <= limit_m).count();
            count as f64 / fixed_m.len() as f64
        };
        Some(Self {
            pair,
            all: ErrorStatistics::of(&all_m)?,
            fixed: ErrorStatistics::of(&fixed_m),
            fixed_within_5_and_10_cm: (!fixed_m.is_empty()).then(|| (within(0.05), within(0.1))),
        })
    }
}

fn horizontal_distance_m(a: &Solution, b: &Solution) -> Option<f64> {
    let position = |solution: &Solution| solution.estimate.as_ref().map(|e| e.position);
    let (a, b): (Ecef, Ecef) = (position(a)?, position(b)?);
    Some(LocalFrame::at(a).to_enu(b).0.xy().norm())
}

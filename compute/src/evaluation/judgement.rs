//! Judges every solution row against its reference.

use std::collections::BTreeMap;

use super::epoch::JudgedEpoch;
use super::matching::Trajectory;
use super::report::{Report, matched_report, share};
use crate::formats::pos::PosRow;
use crate::formats::truth::TruthRow;
use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame};

/// Tolerance at the ends of the time window (s).
const WINDOW_SLACK_S: f64 = 1e-6;

/// The true antenna position.
#[derive(Clone, Debug, PartialEq)]
pub enum Truth {
    /// One fixed position.
    Static(Ecef),
    /// A trajectory; rows in any order.
    Trajectory(Vec<TruthRow>),
}

/// The number of epochs that should have a solution.
#[derive(Clone, Debug, PartialEq)]
pub enum Expected {
    /// The number of reference rows in the window; for a static truth, of judged rows.
    Reference,
    /// The rover's epochs in the window that have a reference.
    RoverEpochs(Vec<GpsTime>),
    /// A number given by the caller.
    Count(usize),
}

/// What is judged, and the limits.
#[derive(Clone, Debug, PartialEq)]
pub struct Criteria {
    /// First and last second of week in the window (s). A window whose last second is before its
    /// first one crosses the end of the week.
    pub window_tow_s: (f64, f64),
    /// Largest time difference to the nearest reference row, where interpolation is impossible (s).
    pub tolerance_s: f64,
    /// Longest gap of the reference that is interpolated (s).
    pub max_gap_s: f64,
    /// Shift added to the times of solutions and rover epochs (s).
    pub shift_s: f64,
    /// Vector from the reference point to the antenna, east, north, up (m).
    pub lever: Option<Enu>,
    /// Quality numbers that are judged; empty: all.
    pub qualities: Vec<i64>,
    /// Largest error of a correct fix, in 2D or in 3D (m).
    pub fix_tolerance_m: f64,
    /// The number of epochs that should have a solution.
    pub expected: Expected,
}

impl Criteria {
    /// The whole file, 20 ms tolerance, gaps up to 1.5 s, fixes correct within 10 cm.
    pub(crate) const fn whole_file() -> Self {
        Self {
            window_tow_s: (f64::NEG_INFINITY, f64::INFINITY),
            tolerance_s: 0.02,
            max_gap_s: 1.5,
            shift_s: 0.0,
            lever: None,
            qualities: Vec::new(),
            fix_tolerance_m: 0.10,
            expected: Expected::Reference,
        }
    }

    fn covers(&self, time: GpsTime) -> bool {
        let (tow_s, (from_s, to_s)) = (time.seconds_of_week(), self.window_tow_s);
        let is_after = from_s - WINDOW_SLACK_S <= tow_s;
        let is_before = tow_s <= to_s + WINDOW_SLACK_S;
        if from_s <= to_s { is_after && is_before } else { is_after || is_before }
    }
}

/// The outcome of [`judge`].
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// Statistics over all judged rows.
    pub report: Report,
    /// The judged rows, in order of time.
    pub epochs: Vec<JudgedEpoch>,
    /// The reference in the window; one row at the first epoch's time if it is static.
    pub reference: Vec<TruthRow>,
}

/// Judges `rows`, in any order, against `truth`; of several rows at one time the last one counts.
pub fn judge(rows: &[PosRow], truth: Truth, criteria: &Criteria) -> Judgement {
    let reference = Reference::new(truth, criteria);
    let mut in_window: BTreeMap<GpsTime, &PosRow> = BTreeMap::new();
    for row in rows {
        in_window.insert(row.time + criteria.shift_s, row);
    }
    in_window.retain(|time, _| criteria.covers(*time));
    let judged = |(time, row): (&GpsTime, &&PosRow)| {
        let position = reference.at(*time)?;
        Some(JudgedEpoch::of(*time, row, position))
    };
    let mut epochs: Vec<_> = in_window.iter().filter_map(judged).collect();
    let unmatched_solutions = in_window.len() - epochs.len();
    if !criteria.qualities.is_empty() {
        epochs.retain(|epoch| criteria.qualities.contains(&epoch.quality));
    }
    let expected = reference.expected(&epochs);
    let report = Report {
        expected,
        matched: epochs.len(),
        unmatched_solutions,
        availability: share(epochs.len(), expected),
        errors: matched_report(&epochs, expected, criteria.fix_tolerance_m),
    };
    let reference = reference.rows(epochs.first().map(|epoch| epoch.time));
    Judgement { report, epochs, reference }
}

/// The truth, with the limits of the criteria.
struct Reference<'a> {
    source: Source,
    criteria: &'a Criteria,
}

enum Source {
    Static(Ecef),
    Trajectory(Trajectory),
}

impl<'a> Reference<'a> {
    fn new(truth: Truth, criteria: &'a Criteria) -> Self {
        let source = match truth {
            Truth::Static(position) => Source::Static(position),
            Truth::Trajectory(rows) => Source::Trajectory(Trajectory::new(rows)),
        };
        Self { source, criteria }
    }

    fn at(&self, time: GpsTime) -> Option<Ecef> {
        let c = self.criteria;
        let position = match &self.source {
            Source::Static(position) => *position,
            Source::Trajectory(trajectory) => trajectory.at(time, c.tolerance_s, c.max_gap_s)?,
        };
        Some(c.lever.map_or(position, |lever| LocalFrame::at(position).to_ecef(lever)))
    }

    fn expected(&self, epochs: &[JudgedEpoch]) -> usize {
        let covered = |time: GpsTime| self.criteria.covers(time);
        match (&self.criteria.expected, &self.source) {
            (Expected::Count(count), _) => *count,
            (Expected::RoverEpochs(times), _) => {
                let mut times: Vec<_> =
                    times.iter().map(|time| *time + self.criteria.shift_s).collect();
                times.sort_unstable();
                times.dedup();
                times.into_iter().filter(|t| covered(*t) && self.at(*t).is_some()).count()
            }
            (Expected::Reference, Source::Static(_)) => epochs.len(),
            (Expected::Reference, Source::Trajectory(trajectory)) => {
                trajectory.rows().iter().filter(|row| covered(row.time)).count()
            }
        }
    }

    fn rows(self, first: Option<GpsTime>) -> Vec<TruthRow> {
        match self.source {
            Source::Static(position) => {
                let time = first.unwrap_or(GpsTime::EPOCH);
                vec![TruthRow { time, position }]
            }
            Source::Trajectory(trajectory) => {
                let rows = trajectory.rows().iter();
                rows.filter(|row| self.criteria.covers(row.time)).copied().collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;

    const PLACE: Ecef = Ecef::new(6_378_137.0, 0.0, 0.0);

    /// Row `seconds` into the week, off PLACE by east, north, up; 2 m of standard deviation.
    fn row(seconds: f64, quality: i64, enu: [f64; 3]) -> PosRow {
        PosRow {
            time: GpsTime::from_week_seconds(2300, seconds),
            position: LocalFrame::at(PLACE).to_ecef(Enu(enu.into())),
            quality,
            satellites: None,
            covariance: Some(Matrix3::identity() * 4.0),
        }
    }

    fn static_report(rows: &[PosRow], criteria: &Criteria) -> Report {
        judge(rows, Truth::Static(PLACE), criteria).report
    }

    #[test]
    fn four_rows_worked_by_hand() {
        let rows = [
            row(3.0, 1, [0.03, 0.04, 0.0]),
            row(1.0, 5, [3.0, 4.0, 12.0]),
            row(2.0, 2, [0.0, -1.0, 0.0]),
            row(4.0, 1, [0.6, 0.8, 0.0]),
            row(4.0, 1, [0.3, 0.4, 0.0]),
        ];
        let report = static_report(&rows, &Criteria::whole_file());
        assert_eq!((report.expected, report.matched, report.availability), (4, 4, Some(1.0)));
        let errors = report.errors.unwrap();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-8, "{a} {b}");
        near(errors.err2d.mean, (0.05 + 5.0 + 1.0 + 0.5) / 4.0);
        near(errors.err3d.max, 13.0);
        near(errors.err_up.p50, 0.0);
        near(errors.bias_enu_median[0], 0.165);
        assert_eq!(errors.q_counts, BTreeMap::from([(1, 2), (2, 1), (5, 1)]));
        let fixed = errors.fix.errors.unwrap();
        assert_eq!((fixed.correct_3d, fixed.wrong_3d_gt_tol, fixed.ttff_s), (0.5, 0.5, 2.0));
        assert_eq!(errors.within["1"], [0.5, 0.5]);
        // eᵀC⁻¹e: 25/4 and 169/4 lie outside, the rest inside.
        let stated = errors.uncertainty.unwrap();
        assert_eq!((stated.n, stated.inside_95_2d, stated.inside_95_3d), (4, 0.75, 0.75));
        near(stated.normalised_rms_2d.powi(2), (0.0025 + 25.0 + 1.0 + 0.25) / 4.0 / 4.0 / 2.0);
    }

    #[test]
    fn window_qualities_lever_and_expectation() {
        let rows = [row(1.0, 5, [1.0, 0.0, 0.0]), row(2.0, 1, [1.0, 2.0, 0.0])];
        let mut criteria = Criteria::whole_file();
        criteria.lever = Some(Enu(Vector3::new(1.0, 0.0, 0.0)));
        criteria.qualities = vec![1];
        criteria.window_tow_s = (0.0, 2.0);
        criteria.expected = Expected::RoverEpochs(vec![rows[0].time, rows[1].time + 1.0]);
        let report = static_report(&rows, &criteria);
        assert_eq!((report.expected, report.matched), (1, 1));
        assert!((report.errors.unwrap().err2d.mean - 2.0).abs() < 1e-6);
    }

    #[test]
    fn a_window_may_cross_the_end_of_the_week() {
        let seconds = [604_000.0, 604_500.0, 604_799.0, 604_800.0, 604_900.0, 605_300.0];
        let rows = seconds.map(|seconds| row(seconds, 5, [0.0; 3]));
        let window_tow_s = (604_500.0, 100.0);
        let criteria = Criteria { window_tow_s, ..Criteria::whole_file() };
        let judged = judge(&rows, Truth::Static(PLACE), &criteria);
        let inside: Vec<GpsTime> = judged.epochs.iter().map(|epoch| epoch.time).collect();
        assert_eq!(inside, rows[1..5].iter().map(|row| row.time).collect::<Vec<_>>());
    }

    #[test]
    fn rows_without_reference_are_counted() {
        let truth = vec![TruthRow { time: GpsTime::from_week_seconds(2300, 1.0), position: PLACE }];
        let rows = [row(1.01, 5, [0.0; 3]), row(5.0, 5, [0.0; 3])];
        let judged = judge(&rows, Truth::Trajectory(truth), &Criteria::whole_file());
        assert_eq!((judged.report.matched, judged.report.unmatched_solutions), (1, 1));
        let nothing = judge(&[], Truth::Static(PLACE), &Criteria::whole_file()).report;
        assert_eq!((nothing.expected, nothing.availability, nothing.errors), (0, None, None));
    }
}

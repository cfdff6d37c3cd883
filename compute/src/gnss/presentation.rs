//! Solutions as they are given out: in the frame and with the heights that are asked for.
//!
//! Everything inside computes and stores positions as computed: relative to a base in the base's
//! frame, others in WGS 84 as broadcast. Only who gives a solution out presents it, so that what is
//! stored does not depend on it, a replay gives the same bits whatever is asked for, and what was
//! stored before can be given in another frame.
//!
//! Covariances and velocities stay as they are: the rotation between the ITRS and the ETRS89 is
//! 0.15 µrad, and the plate moves by 0.8 nm/s. So does the baseline, whose direction in the frame
//! of a base in the ETRS89 is wrong by that rotation: 1.5 mm in 10 km.

use std::borrow::Cow;
use std::sync::Arc;

use super::etrs89::{etrs89_of, to_etrs89};
use super::{CoordinateFrame, FrameRefusal, Geoid, Solution};

/// The frame of positions from satellites alone.
const BROADCAST_FRAME: &str = "WGS84";
/// The frame of positions relative to a base.
const BASE_FRAME: &str = "BASE";
/// The frame of a base that states none.
const UNKNOWN_FRAME: &str = "UNKNOWN";

/// How solutions are presented. The default: as they are computed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Presentation {
    /// Whether positions are given in the ETRS89.
    pub etrs89: bool,
    /// The frame of a base that states none.
    pub base_frame: Option<CoordinateFrame>,
    /// Whether files name the frame of each position: one is asked for, or a base states its own.
    pub names_frames: bool,
    /// The geoid above which heights are given, too.
    pub geoid: Option<Arc<Geoid>>,
}

/// A solution as it is given out.
#[derive(Clone, Debug, PartialEq)]
pub struct Presented<'a> {
    /// The solution, with its position in `frame`.
    pub solution: Cow<'a, Solution>,
    /// The frame of its position, in the API's words.
    pub frame: &'static str,
    /// The epoch of its position (decimal year), if a frame was asked for.
    pub epoch_year: Option<f64>,
    /// The frame that the base states, if the position is in the base's.
    pub base_frame: Option<CoordinateFrame>,
    /// Height of the geoid above the ellipsoid at the position (m), if it is asked for and known.
    pub geoid_height_m: Option<f64>,
    /// Why the position is not in the frame that is asked for.
    pub refusal: Option<FrameRefusal>,
}

impl<'a> Presented<'a> {
    /// A solution as it is computed.
    pub fn as_computed(solution: &'a Solution) -> Self {
        let estimate = solution.estimate.as_ref();
        let is_relative = estimate.is_some_and(|estimate| estimate.relative.is_some());
        Self {
            solution: Cow::Borrowed(solution),
            frame: if is_relative { BASE_FRAME } else { BROADCAST_FRAME },
            epoch_year: None,
            base_frame: None,
            geoid_height_m: None,
            refusal: None,
        }
    }

    /// Name of the frame that the base states, in the API's words; empty if the position is not in
    /// the base's frame.
    pub fn base_frame_name(&self) -> &'static str {
        match (self.frame, self.base_frame) {
            (BASE_FRAME, stated) => stated.map_or(UNKNOWN_FRAME, |frame| frame.name),
            _ => "",
        }
    }

    /// The frame of the position with its epoch: in the base's frame the one that the base states,
    /// if it states one.
    pub fn frame_of_position(&self) -> CoordinateFrame {
        let computed = CoordinateFrame { name: self.frame, epoch_year: self.epoch_year };
        match self.frame {
            BASE_FRAME => self.base_frame.unwrap_or(computed),
            _ => computed,
        }
    }

    /// The height of the position above the geoid (m), if it is asked for and known.
    pub fn orthometric_height_m(&self) -> Option<f64> {
        let estimate = self.solution.estimate.as_ref()?;
        Some(estimate.position.to_geodetic().height_m - self.geoid_height_m?)
    }

    /// The same without a position that is in another frame than the one that is asked for.
    #[must_use]
    pub fn without_foreign_position(self) -> Self {
        match self.refusal {
            None => self,
            Some(_) => {
                let solution = Solution::none(self.solution.time, self.solution.reasons.clone());
                Self { solution: Cow::Owned(solution), geoid_height_m: None, ..self }
            }
        }
    }
}

impl Presentation {
    /// Whether solutions are given as they are computed.
    pub fn is_plain(&self) -> bool {
        !self.etrs89 && self.geoid.is_none()
    }

    /// Checks that positions relative to a base in `frame` can be given as it is asked for.
    ///
    /// # Errors
    /// Nothing leads from this frame to the one that is asked for.
    pub fn check(&self, frame: Option<CoordinateFrame>) -> Result<(), FrameRefusal> {
        match self.etrs89 {
            true => etrs89_of(frame.or(self.base_frame)).map(drop),
            false => Ok(()),
        }
    }

    /// A solution as it is given out. `base_frame` knows the frames of bases by name.
    pub fn present<'a>(
        &self,
        solution: &'a Solution,
        base_frame: impl FnOnce(&str) -> Option<CoordinateFrame>,
    ) -> Presented<'a> {
        let mut computed = Presented::as_computed(solution);
        if computed.frame == BASE_FRAME {
            let base = solution.provenance.base.as_ref();
            let stated = base.and_then(|used| base_frame(&used.base));
            computed.base_frame = stated.or(self.base_frame);
        }
        let mut presented = if self.etrs89 { in_etrs89(computed) } else { computed };
        if let (Some(geoid), Some(estimate)) = (&self.geoid, &presented.solution.estimate) {
            presented.geoid_height_m = geoid.height_m(&estimate.position.to_geodetic());
        }
        presented
    }
}

/// A computed solution with its position in the ETRS89.
fn in_etrs89(computed: Presented<'_>) -> Presented<'_> {
    let solution = &computed.solution;
    let Some(estimate) = &solution.estimate else { return computed };
    let from = match &estimate.relative {
        None => {
            let epoch_year = Some(solution.time.decimal_year());
            Some(CoordinateFrame { name: BROADCAST_FRAME, epoch_year })
        }
        Some(_) => computed.base_frame,
    };
    match to_etrs89(estimate.position, from) {
        Err(refusal) => Presented { refusal: Some(refusal), ..computed },
        Ok((position, CoordinateFrame { name, epoch_year })) => {
            let mut solution = computed.solution.into_owned();
            if let Some(estimate) = &mut solution.estimate {
                estimate.position = position;
            }
            Presented {
                solution: Cow::Owned(solution),
                frame: name,
                epoch_year,
                base_frame: None,
                geoid_height_m: None,
                refusal: None,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::gnss::{
        BaseEpochIssue, Dops, Ecef, Geodetic, GeoidGrid, GpsTime, Provenance, RelativeEstimate,
        SolutionEstimate, Status,
    };

    /// 2020-07-01T12:00 GPS time, half of the year: day 182.5 of 366.
    const TIME: f64 = 3.0 * 86_400.0 + 43_200.0;

    fn solution(base: Option<&str>) -> Solution {
        let time = GpsTime::from_week_seconds(2112, TIME);
        let relative = RelativeEstimate {
            baseline_m: Vector3::zeros(),
            age_s: 0.0,
            ambiguities: 0,
            fixed_ambiguities: 0,
            ratio: None,
            success_rate: None,
            fix_probability: None,
        };
        let estimate = SolutionEstimate {
            position: Geodetic::from_degrees(48.0, 11.0, 550.0).to_ecef(),
            covariance: Matrix3::identity(),
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: time,
            dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.0, vdop: 1.1, tdop: 1.2 },
            satellites_used: Vec::new(),
            relative: base.map(|_| relative),
        };
        let base = base.map(|base| BaseEpochIssue { base: base.to_owned(), time });
        Solution {
            time,
            status: Status::Single,
            estimate: Some(estimate),
            protection: None,
            reasons: Vec::new(),
            provenance: Provenance { base, ..Provenance::default() },
        }
    }

    fn position(presented: &Presented<'_>) -> Ecef {
        presented.solution.estimate.as_ref().unwrap().position
    }

    fn etrs89() -> Presentation {
        Presentation { etrs89: true, ..Presentation::default() }
    }

    #[test]
    fn without_a_request_nothing_changes() {
        for (base, frame, of_base) in [(None, "WGS84", ""), (Some("bas_1"), "BASE", "UNKNOWN")] {
            let solution = solution(base);
            let presented = Presentation::default().present(&solution, |_| None);
            assert_eq!(presented, Presented::as_computed(&solution));
            assert!(matches!(presented.solution, Cow::Borrowed(_)));
            assert_eq!((presented.frame, presented.base_frame_name()), (frame, of_base));
            assert_eq!(presented.frame_of_position().name, frame);
        }
    }

    /// The base's own statement counts before what is stated for all bases.
    #[test]
    fn a_position_relative_to_a_base_says_the_frame_that_the_base_states() {
        let (stated, for_all) = (CoordinateFrame::parse("ITRF2014@2010.0"), "NAD83(2011)");
        let presentation =
            Presentation { base_frame: CoordinateFrame::parse(for_all), ..Presentation::default() };
        let solution = solution(Some("bas_1"));
        let presented = presentation.present(&solution, |base| stated.filter(|_| base == "bas_1"));
        assert_eq!((presented.frame, presented.base_frame_name()), ("BASE", "ITRF2014"));
        assert_eq!((presented.epoch_year, presented.base_frame), (None, stated));
        assert_eq!(Some(presented.frame_of_position()), stated);
        let presented = presentation.present(&solution, |_| None);
        assert_eq!(presented.base_frame_name(), for_all);
        // In another frame than the base's there is none.
        let presented = etrs89().present(&solution, |_| stated);
        assert_eq!((presented.frame, presented.base_frame_name()), ("ETRF2000", ""));
        assert_eq!(presented.frame_of_position().name, "ETRF2000");
        let refused = etrs89().present(&solution, |_| CoordinateFrame::parse("GDA94"));
        assert_eq!((refused.frame, refused.base_frame_name()), ("BASE", "GDA94"));
    }

    /// In 2020.5 the plate is 31.5 years of some 2.5 cm away from 1989.
    #[test]
    fn a_position_of_its_own_is_of_the_epoch_of_its_observations() {
        let solution = solution(None);
        let presented = etrs89().present(&solution, |_| unreachable!());
        let moved_m = position(&presented).distance_m(solution.estimate.as_ref().unwrap().position);
        assert!((0.6..0.9).contains(&moved_m), "{moved_m}");
        assert_eq!((presented.frame, presented.refusal), ("ETRF2000", None));
        let year = presented.epoch_year.unwrap();
        assert!((year - (2020.0 + 182.5 / 366.0)).abs() < 1e-9, "{year}");
    }

    #[test]
    fn a_position_relative_to_a_base_is_of_the_epoch_of_the_base() {
        let solution = solution(Some("bas_1"));
        let computed = solution.estimate.as_ref().unwrap().position;
        let of = |text: &str| {
            let frame = CoordinateFrame::parse(text);
            let presented = etrs89().present(&solution, |base| frame.filter(|_| base == "bas_1"));
            (position(&presented).distance_m(computed), presented.frame, presented.epoch_year)
        };
        assert_eq!(of("ETRF2014"), (0.0, "ETRF2014", None));
        let (moved_m, frame, epoch_year) = of("ITRF2014@1995.0");
        assert!((0.05..0.3).contains(&moved_m), "{moved_m}");
        assert_eq!((frame, epoch_year), ("ETRF2000", Some(1995.0)));
    }

    #[test]
    fn an_unknown_frame_is_refused_and_the_position_stays() {
        let solution = solution(Some("bas_1"));
        let presented = etrs89().present(&solution, |_| None);
        assert_eq!(presented.refusal, Some(FrameRefusal::Unknown));
        assert_eq!((presented.frame, &*presented.solution), ("BASE", &solution));
        assert_eq!(presented.without_foreign_position().solution.estimate, None);
        // What was stated for all bases counts where the base states nothing.
        let base_frame = CoordinateFrame::parse("ETRF2000");
        let stated = Presentation { base_frame, ..etrs89() };
        assert_eq!(stated.present(&solution, |_| None).frame, "ETRF2000");
        assert_eq!(stated.check(None), Ok(()));
        assert_eq!(etrs89().check(None), Err(FrameRefusal::Unknown));
        assert_eq!(Presentation::default().check(None), Ok(()));
    }

    #[test]
    fn a_height_above_the_geoid_is_stated_beside() {
        let grid = GeoidGrid {
            south_deg: 40.0,
            west_deg: 0.0,
            latitude_step_deg: 20.0,
            longitude_step_deg: 20.0,
            rows: 2,
            columns: 2,
        };
        let geoid = Geoid::new(grid, vec![46.5; 4]).map(Arc::new);
        let solution = solution(None);
        let presented = Presentation { geoid, ..Presentation::default() };
        let presented = presented.present(&solution, |_| None);
        assert_eq!(presented.geoid_height_m, Some(46.5));
        assert!((presented.orthometric_height_m().unwrap() - 503.5).abs() < 1e-6);
        assert_eq!(*presented.solution, solution);
    }
}

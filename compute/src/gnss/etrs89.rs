//! From the ITRS to the ETRS89: positions in ETRF2000.
//!
//! The ETRS89 moves with the stable part of the Eurasian plate, so points in Europe keep their
//! coordinates, while those in the ITRS and in WGS 84 move by some 2.5 cm a year. The
//! transformation has 14 parameters: seven at an epoch t₀, and their rates.
//!
//! X_E = X_I + T + D·X_I + R·X_I, each of T, D, R at the epoch t of the position:
//! P(t) = P(t₀) + Ṗ·(t − t₀), with R = [[0, −R₃, R₂], [R₃, 0, −R₁], [−R₂, R₁, 0]].
//!
//! Source: Altamimi (2018, and its revision of 2024 for the ITRF2020), *EUREF Technical Note 1:
//! Relationship and Transformation between the International and the European Terrestrial Reference
//! Systems*, parameters from ITRFyy to ETRF2000. The same numbers are EPSG:10586 (ITRF2020), 8405
//! (2014), 7951 (2008), 7950 (2005) and 7941 (2000). They also are the sum of IERS's published
//! parameters from ITRFyy to ITRF2000 and of those from ITRF2000 to ETRF2000; a test adds them up.
//!
//! WGS 84 as the satellites broadcast it agrees with the ITRF within a few centimetres, its
//! realisation G2139 with ITRF2014 and G2296 with ITRF2020, which differ by millimetres: so does
//! Graphfix take it for ITRF2020. Realisations of the IGS are those of their ITRF.

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use nalgebra::Vector3;

use super::{CoordinateFrame, Ecef};

/// Radians in a thousandth of an arc second.
const RAD_PER_MAS: f64 = PI / 180.0 / 3600.0 / 1000.0;
const M_PER_MM: f64 = 1e-3;
const PER_PPB: f64 = 1e-9;

/// The realisation of the ETRS89 in which positions are given.
const REALISATION: &str = "ETRF2000";
/// Realisations of the ETRS89, whose positions stay as they are.
const REALISATIONS: [&str; 4] = ["ETRS89", REALISATION, "ETRF2014", "ETRF2020"];

/// Where the ETRS89 is used (degrees): EPSG's extent of ETRF2000, by latitude and longitude.
const LATITUDES_DEG: RangeInclusive<f64> = 33.26..=84.73;
const LONGITUDES_DEG: RangeInclusive<f64> = -16.1..=38.01;

/// Seven parameters of a transformation: translation (mm), scale (ppb), rotation (mas).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seven {
    t: [f64; 3],
    d: f64,
    r: [f64; 3],
}

/// Parameters at an epoch and their rates a year.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Fourteen {
    epoch_year: f64,
    at: Seven,
    rate: Seven,
}

/// Frames, and the parameters from them to ETRF2000.
type Row = (&'static [&'static str], Fourteen);

/// Rates of the rotation: those of Eurasia in ITRF2000 (mas/year).
const TURNS: [f64; 3] = [0.081, 0.490, -0.792];

#[rustfmt::skip]
const TABLE: [Row; 5] = [
    (&["ITRF2020", "IGS20", "WGS84"], Fourteen {
        epoch_year: 2015.0,
        at: Seven { t: [53.8, 51.8, -82.2], d: 2.25, r: [2.106, 12.740, -20.592] },
        rate: Seven { t: [0.1, 0.0, -1.7], d: 0.11, r: TURNS },
    }),
    (&["ITRF2014", "IGS14", "IGb14"], Fourteen {
        epoch_year: 2010.0,
        at: Seven { t: [54.7, 52.2, -74.1], d: 2.12, r: [1.701, 10.290, -16.632] },
        rate: Seven { t: [0.1, 0.1, -1.9], d: 0.11, r: TURNS },
    }),
    (&["ITRF2008", "IGS08", "IGb08"], Fourteen {
        epoch_year: 2000.0,
        at: Seven { t: [52.1, 49.3, -58.5], d: 1.34, r: [0.891, 5.390, -8.712] },
        rate: Seven { t: [0.1, 0.1, -1.8], d: 0.08, r: TURNS },
    }),
    (&["ITRF2005"], Fourteen {
        epoch_year: 2000.0,
        at: Seven { t: [54.1, 50.2, -53.8], d: 0.40, r: [0.891, 5.390, -8.712] },
        rate: Seven { t: [-0.2, 0.1, -1.8], d: 0.08, r: TURNS },
    }),
    (&["ITRF2000"], Fourteen {
        epoch_year: 1989.0,
        at: Seven { t: [54.0, 51.0, -48.0], d: 0.0, r: [0.0, 0.0, 0.0] },
        rate: Seven { t: [0.0, 0.0, 0.0], d: 0.0, r: TURNS },
    }),
];

/// Why a position cannot be given in the ETRS89.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameRefusal {
    /// Nobody has stated the frame of the base's coordinates.
    #[error("the frame of the base's coordinates is unknown")]
    Unknown,
    /// The frame moves against the ETRS89, and nobody has stated the epoch of the coordinates.
    #[error("the epoch of the base's coordinates in {frame} is unknown")]
    NoEpoch {
        /// The frame.
        frame: &'static str,
    },
    /// EUREF publishes no parameters from this frame.
    #[error("no published parameters lead from {frame} to the ETRS89")]
    NoParameters {
        /// The frame.
        frame: &'static str,
    },
    /// The position is not in Europe.
    #[error("the position is outside the area of the ETRS89")]
    Outside,
}

impl FrameRefusal {
    /// Stable code, upper snake case.
    pub const CODE: &str = "FRAME_UNAVAILABLE";

    /// What the user can do about it.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::Unknown | Self::NoEpoch { .. } => {
                "state the frame and epoch of the base's coordinates, or leave out the option frame"
            }
            Self::NoParameters { .. } => {
                "state the base's coordinates in the ETRS89, or leave out the option frame"
            }
            Self::Outside => "leave out the option frame outside of Europe",
        }
    }
}

/// The frame that a position in `from` is given in, if the ETRS89 is asked for; the epoch is that
/// of the coordinates.
///
/// # Errors
/// Nothing leads from this frame to the ETRS89.
pub(super) fn etrs89_of(from: Option<CoordinateFrame>) -> Result<CoordinateFrame, FrameRefusal> {
    let from = from.ok_or(FrameRefusal::Unknown)?;
    if REALISATIONS.contains(&from.name) {
        return Ok(from);
    }
    let (frame, epoch_year) = (from.name, from.epoch_year);
    parameters(frame).ok_or(FrameRefusal::NoParameters { frame })?;
    epoch_year.ok_or(FrameRefusal::NoEpoch { frame })?;
    Ok(CoordinateFrame { name: REALISATION, epoch_year })
}

/// A position of a frame in the ETRS89, and the frame that it then is in: ETRF2000, or the
/// realisation of the ETRS89 that it is in already.
///
/// # Errors
/// Nothing leads from the frame to the ETRS89, or the position is not in Europe.
pub(super) fn to_etrs89(
    position: Ecef,
    from: Option<CoordinateFrame>,
) -> Result<(Ecef, CoordinateFrame), FrameRefusal> {
    let to = etrs89_of(from)?;
    let geodetic = position.to_geodetic();
    let is_inside = LATITUDES_DEG.contains(&geodetic.latitude_rad.to_degrees())
        && LONGITUDES_DEG.contains(&geodetic.longitude_rad.to_degrees());
    if !is_inside {
        return Err(FrameRefusal::Outside);
    }
    let parameters = from.and_then(|from| parameters(from.name).zip(from.epoch_year));
    let moved =
        parameters.map_or(position, |(parameters, year)| parameters.applied(position, year));
    Ok((moved, to))
}

fn parameters(frame: &str) -> Option<&'static Fourteen> {
    let row = TABLE.iter().find(|(frames, _)| frames.contains(&frame));
    row.map(|(_, parameters)| parameters)
}

impl Fourteen {
    /// The parameters at an epoch.
    fn at(&self, year: f64) -> Seven {
        let years = year - self.epoch_year;
        let sum = |at: [f64; 3], rate: [f64; 3]| [0, 1, 2].map(|i| at[i] + rate[i] * years);
        Seven {
            t: sum(self.at.t, self.rate.t),
            d: self.at.d + self.rate.d * years,
            r: sum(self.at.r, self.rate.r),
        }
    }

    /// A position of this epoch after the transformation.
    fn applied(&self, Ecef(position): Ecef, year: f64) -> Ecef {
        let Seven { t, d, r } = self.at(year);
        let rotation = Vector3::from(r) * RAD_PER_MAS;
        let translation_m = Vector3::from(t) * M_PER_MM;
        Ecef(position + translation_m + position * (d * PER_PPB) + rotation.cross(&position))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::gnss::Geodetic;

    fn frame(text: &str) -> Option<CoordinateFrame> {
        Some(CoordinateFrame::parse(text).unwrap())
    }

    /// The published parameters are those from ITRFyy to ITRF2000 (IERS: itrf.ign.fr,
    /// Transfo-ITRF2020_ITRFs, Transfo-ITRF2014_ITRFs, Transfo-ITRF2008_ITRFs; ITRF2005 by
    /// Altamimi et al. 2007), with those from ITRF2000 to ETRF2000 added at the same epoch.
    #[test]
    fn the_parameters_are_the_sum_of_two_published_ones() {
        let zero = [0.0; 3];
        let to_itrf2000 = [
            ("ITRF2020", 2015.0, [-0.2, 0.8, -34.2], 2.25, [0.1, 0.0, -1.7], 0.11),
            ("ITRF2014", 2010.0, [0.7, 1.2, -26.1], 2.12, [0.1, 0.1, -1.9], 0.11),
            ("ITRF2008", 2000.0, [-1.9, -1.7, -10.5], 1.34, [0.1, 0.1, -1.8], 0.08),
            ("ITRF2005", 2000.0, [0.1, -0.8, -5.8], 0.40, [-0.2, 0.1, -1.8], 0.08),
            ("ITRF2000", 1989.0, zero, 0.0, zero, 0.0),
        ];
        let near = |a: &Seven, b: &Seven| {
            let all = |s: &Seven| [s.t, [s.d, 0.0, 0.0], s.r].concat();
            all(a).iter().zip(all(b)).all(|(x, y)| (x - y).abs() < 1e-9)
        };
        for (name, year, t, d, t_rate, d_rate) in to_itrf2000 {
            let last = parameters("ITRF2000").unwrap().at(year);
            let sum = Seven { t: [0, 1, 2].map(|i| t[i] + last.t[i]), d, r: last.r };
            let given = parameters(name).unwrap();
            assert!(given.epoch_year == year && near(&given.at, &sum), "{name}");
            assert!(near(&given.rate, &Seven { t: t_rate, d: d_rate, r: TURNS }), "{name}");
        }
    }

    /// On the x-axis at 6 378 137 m, ITRF2014, epoch 2010: T and scale alone move it along x,
    /// 54.7 mm + 2.12e-9·6 378 137 m = 68.2 mm; R₃ = −16.632 mas moves it along y by
    /// −8.0634e-8·6 378 137 m = −514.3 mm, with 52.2 mm −462.1 mm; −R₂ along z by −318.2 mm, with
    /// −74.1 mm −392.3 mm.
    #[test]
    fn a_point_of_the_x_axis_worked_by_hand() {
        let moved =
            parameters("ITRF2014").unwrap().applied(Ecef::new(6_378_137.0, 0.0, 0.0), 2010.0);
        let by_mm = (moved.0 - Vector3::new(6_378_137.0, 0.0, 0.0)) * 1e3;
        assert!((by_mm - Vector3::new(68.2, -462.1, -392.3)).amax() < 0.06, "{by_mm}");
    }

    #[test]
    fn realisations_of_the_etrs89_stay_as_they_are() {
        let position = Geodetic::from_degrees(48.0, 11.0, 500.0).to_ecef();
        for name in REALISATIONS {
            assert_eq!(to_etrs89(position, frame(name)), Ok((position, frame(name).unwrap())));
        }
    }

    #[test]
    fn what_nobody_knows_is_refused() {
        let position = Geodetic::from_degrees(48.0, 11.0, 500.0).to_ecef();
        let refusal = |from| to_etrs89(position, from).unwrap_err();
        assert_eq!(refusal(None), FrameRefusal::Unknown);
        assert_eq!(refusal(frame("ITRF2014")), FrameRefusal::NoEpoch { frame: "ITRF2014" });
        assert_eq!(refusal(frame("GDA94@1994")), FrameRefusal::NoParameters { frame: "GDA94" });
        for (latitude, longitude) in [(22.3, 114.2), (48.0, 41.0), (-48.0, 11.0), (64.0, -22.0)] {
            let position = Geodetic::from_degrees(latitude, longitude, 5.0).to_ecef();
            assert_eq!(to_etrs89(position, frame("WGS84@2024.5")), Err(FrameRefusal::Outside));
        }
    }

    #[test]
    fn every_known_frame_is_answered() {
        for name in CoordinateFrame::NAMES {
            let to = etrs89_of(CoordinateFrame::named(name, Some(2020.0)));
            assert!(to.is_ok() || to == Err(FrameRefusal::NoParameters { frame: name }), "{name}");
        }
    }

    proptest! {
        /// What rests in WGS 84 moves in the ETRS89 by 1.5 to 4 cm a year.
        #[test]
        fn the_plate_moves_by_centimetres_a_year(lat in 38.0..60.0, lon in -8.0..30.0) {
            let position = Geodetic::from_degrees(lat, lon, 100.0).to_ecef();
            let at = |text| to_etrs89(position, frame(text)).unwrap().0;
            let moved_m = at("WGS84@2020").distance_m(at("WGS84@2021"));
            prop_assert!((0.015..0.04).contains(&moved_m), "{moved_m}");
        }

        /// The realisations of the ITRS since 2005 lead to the same position within 2 cm.
        #[test]
        fn realisations_of_the_itrs_agree(
            lat in 36.0..70.0,
            lon in -9.0..38.0,
            year in 2005.0..2026.0,
        ) {
            let position = Geodetic::from_degrees(lat, lon, 100.0).to_ecef();
            let of = |name| to_etrs89(position, CoordinateFrame::named(name, Some(year))).unwrap().0;
            for name in ["ITRF2014", "ITRF2008", "ITRF2005"] {
                prop_assert!(of(name).distance_m(of("ITRF2020")) < 0.02, "{name}");
            }
        }
    }
}

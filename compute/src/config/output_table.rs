//! The table of the options of what is given out.

use crate::gnss::CoordinateFrame;

use super::choices::OutputFrame;
use super::option_specification::{OptionSpecification, switch, switch_text};

#[rustfmt::skip]
pub(super) const OUTPUT_TABLE: &[OptionSpecification] = &[
    OptionSpecification {
        name: "frame", unit: "",
        meaning: "frame of positions: as computed (WGS 84, or the base's frame), or the ETRS89",
        allowed: "native, ETRS89",
        get: |o| o.output.frame.name().to_owned(),
        set: |o, text| OutputFrame::from_name(text).map(|v| o.output.frame = v),
    },
    OptionSpecification {
        name: "base_frame", unit: "",
        meaning: "frame of the coordinates of a base that states none, with their epoch",
        allowed: "a frame of bases such as ETRF2000 or ITRF2014@2010.0, or nothing",
        get: |o| o.output.base_frame.map(|frame| frame.to_string()).unwrap_or_default(),
        set: |o, text| base_frame(text).map(|v| o.output.base_frame = v),
    },
    OptionSpecification {
        name: "geoid", unit: "",
        meaning: "whether heights above the geoid are stated beside those above the ellipsoid",
        allowed: "on, off",
        get: |o| switch_text(o.output.geoid),
        set: |o, text| switch(text).map(|v| o.output.geoid = v),
    },
];

fn base_frame(text: &str) -> Option<Option<CoordinateFrame>> {
    if text.is_empty() { Some(None) } else { CoordinateFrame::parse(text).map(Some) }
}

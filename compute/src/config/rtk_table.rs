//! The table of the options of positions relative to a base.

use super::option_specification::{OptionSpecification, number, switch, switch_text};

#[rustfmt::skip]
pub(super) const RTK_TABLE: &[OptionSpecification] = &[
    OptionSpecification {
        name: "differencing.pseudorange_sigma_m", unit: "m",
        meaning: "initial standard deviation of a strong signal's pseudorange at zenith",
        allowed: "a number from 0.01 to 100",
        get: |o| o.rtk.pseudorange_sigma_m.to_string(),
        set: |o, text| number(text, 0.01, 100.0).map(|v| o.rtk.pseudorange_sigma_m = v),
    },
    OptionSpecification {
        name: "differencing.pseudorange_cn0_sigma_m", unit: "m",
        meaning: "pseudorange deviation added for the strongest signals; tenfold at 20 dB less",
        allowed: "a number from 0 to 100",
        get: |o| o.rtk.pseudorange_cn0_sigma_m.to_string(),
        set: |o, text| number(text, 0.0, 100.0).map(|v| o.rtk.pseudorange_cn0_sigma_m = v),
    },
    OptionSpecification {
        name: "differencing.carrier_sigma_m", unit: "m",
        meaning: "standard deviation of a carrier phase: this, and this over sin(elevation)",
        allowed: "a number from 0.0001 to 1",
        get: |o| o.rtk.carrier_sigma_m.to_string(),
        set: |o, text| number(text, 0.0001, 1.0).map(|v| o.rtk.carrier_sigma_m = v),
    },
    OptionSpecification {
        name: "differencing.carrier_cn0_sigma_m", unit: "m",
        meaning: "carrier-phase deviation added for the strongest signals; tenfold at 20 dB less",
        allowed: "a number from 0 to 1",
        get: |o| o.rtk.carrier_cn0_sigma_m.to_string(),
        set: |o, text| number(text, 0.0, 1.0).map(|v| o.rtk.carrier_cn0_sigma_m = v),
    },
    OptionSpecification {
        name: "differencing.ionosphere_mm_km", unit: "mm/km",
        meaning: "gradient of the vertical ionospheric delay on L1, times the baseline",
        allowed: "a number from 0 to 1000",
        get: |o| ((o.rtk.ionosphere_gradient * 1e12).round() / 1e6).to_string(),
        set: |o, text| number(text, 0.0, 1000.0).map(|v| o.rtk.ionosphere_gradient = v * 1e-6),
    },
    OptionSpecification {
        name: "differencing.pseudorange_correlation_s", unit: "s",
        meaning: "correlation time of pseudorange errors; closer epochs share one epoch's weight",
        allowed: "a number from 0.01 to 3600",
        get: |o| o.rtk.pseudorange_correlation_s.to_string(),
        set: |o, text| {
            number(text, 0.01, 3600.0).map(|v| o.rtk.pseudorange_correlation_s = v)
        },
    },
    OptionSpecification {
        name: "differencing.carrier_correlation_s", unit: "s",
        meaning: "correlation time of carrier-phase errors; closer epochs share one epoch's weight",
        allowed: "a number from 0.01 to 3600",
        get: |o| o.rtk.carrier_correlation_s.to_string(),
        set: |o, text| number(text, 0.01, 3600.0).map(|v| o.rtk.carrier_correlation_s = v),
    },
    OptionSpecification {
        name: "differencing.base_age_max_s", unit: "s",
        meaning: "largest age of a base epoch",
        allowed: "a number from 0.1 to 600",
        get: |o| o.rtk.base_age_max_s.to_string(),
        set: |o, text| number(text, 0.1, 600.0).map(|v| o.rtk.base_age_max_s = v),
    },
    OptionSpecification {
        name: "differencing.baseline_max_km", unit: "km",
        meaning: "longest baseline",
        allowed: "a number from 0.1 to 1000",
        get: |o| (o.rtk.baseline_max_m / 1e3).to_string(),
        set: |o, text| number(text, 0.1, 1000.0).map(|v| o.rtk.baseline_max_m = v * 1e3),
    },
    OptionSpecification {
        name: "differencing.nearer_percent", unit: "%",
        meaning: "handover to a base nearer by this share of the distance, and by nearer_km",
        allowed: "a number from 0 to 99",
        get: |o| ((o.rtk.handover_distance_share * 1e8).round() / 1e6).to_string(),
        set: |o, text| number(text, 0.0, 99.0).map(|v| o.rtk.handover_distance_share = v / 100.0),
    },
    OptionSpecification {
        name: "differencing.nearer_km", unit: "km",
        meaning: "handover to a base that is nearer by this, and by nearer_percent",
        allowed: "a number from 0 to 1000",
        get: |o| (o.rtk.handover_distance_m / 1e3).to_string(),
        set: |o, text| number(text, 0.0, 1000.0).map(|v| o.rtk.handover_distance_m = v * 1e3),
    },
    OptionSpecification {
        name: "differencing.steady_s", unit: "s",
        meaning: "handover to a nearer base after its stream had no gap for this time",
        allowed: "a number from 0 to 3600",
        get: |o| o.rtk.handover_gap_free_s.to_string(),
        set: |o, text| number(text, 0.0, 3600.0).map(|v| o.rtk.handover_gap_free_s = v),
    },
    OptionSpecification {
        name: "ambiguity.gap_s", unit: "s",
        meaning: "an ambiguity not observed for longer than this restarts",
        allowed: "a number from 0.01 to 3600",
        get: |o| o.rtk.arc_gap_s.to_string(),
        set: |o, text| number(text, 0.01, 3600.0).map(|v| o.rtk.arc_gap_s = v),
    },
    OptionSpecification {
        name: "ambiguity.window_epochs", unit: "",
        meaning: "largest number of epochs in the window; older ones are marginalised into a prior",
        allowed: "a whole number from 1 to 100",
        get: |o| o.rtk.window_epochs.to_string(),
        set: |o, text| whole(text, 1, 100).map(|v| o.rtk.window_epochs = v),
    },
    OptionSpecification {
        name: "ambiguity.single_epoch", unit: "",
        meaning: "whether all ambiguities restart at each epoch",
        allowed: "true, false",
        get: |o| o.rtk.single_epoch.to_string(),
        set: |o, text| text.parse().ok().map(|v| o.rtk.single_epoch = v),
    },
    OptionSpecification {
        name: "ambiguity.resolve", unit: "",
        meaning: "whether integer ambiguities are searched for",
        allowed: "on, off",
        get: |o| switch_text(o.rtk.resolve),
        set: |o, text| switch(text).map(|v| o.rtk.resolve = v),
    },
    OptionSpecification {
        name: "ambiguity.ratio_min", unit: "",
        meaning: "smallest accepted ratio of second-best to best squared norm",
        allowed: "a number from 1 to 1000",
        get: |o| o.rtk.ratio_min.to_string(),
        set: |o, text| number(text, 1.0, 1000.0).map(|v| o.rtk.ratio_min = v),
    },
    OptionSpecification {
        name: "ambiguity.probability_min", unit: "",
        meaning: "smallest posterior probability of integers that a search finds",
        allowed: "a number from 0 to 1",
        get: |o| o.rtk.probability_min.to_string(),
        set: |o, text| number(text, 0.0, 1.0).map(|v| o.rtk.probability_min = v),
    },
    OptionSpecification {
        name: "ambiguity.hold_probability_min", unit: "",
        meaning: "smallest posterior probability of held integers, and of single_epoch=true",
        allowed: "a number from 0 to 1",
        get: |o| o.rtk.hold_probability_min.to_string(),
        set: |o, text| number(text, 0.0, 1.0).map(|v| o.rtk.hold_probability_min = v),
    },
    OptionSpecification {
        name: "ambiguity.success_rate_min", unit: "",
        meaning: "smallest bootstrapped success rate of the ambiguities to be fixed",
        allowed: "a number from 0 to 1",
        get: |o| o.rtk.success_rate_min.to_string(),
        set: |o, text| number(text, 0.0, 1.0).map(|v| o.rtk.success_rate_min = v),
    },
    OptionSpecification {
        name: "ambiguity.hold_epochs", unit: "",
        meaning: "epochs in a row that must find the same integers before they are held",
        allowed: "a whole number from 1 to 1000000",
        get: |o| o.rtk.hold_epochs.to_string(),
        set: |o, text| {
            let epochs = text.parse().ok().filter(|v| (1..=1_000_000).contains(v));
            epochs.map(|v| o.rtk.hold_epochs = v)
        },
    },
    OptionSpecification {
        name: "ambiguity.fixed_min", unit: "",
        meaning: "smallest number of fixed double differences in a fix",
        allowed: "a whole number from 4 to 100",
        get: |o| o.rtk.fixed_min.to_string(),
        set: |o, text| whole(text, 4, 100).map(|v| o.rtk.fixed_min = v),
    },
    OptionSpecification {
        name: "ambiguity.elevation_mask_deg", unit: "deg",
        meaning: "ambiguities of satellites below this elevation stay real-valued",
        allowed: "a number from 0 to 60",
        get: |o| ((o.rtk.elevation_mask_rad.to_degrees() * 1e6).round() / 1e6).to_string(),
        set: |o, text| {
            number(text, 0.0, 60.0).map(|v| o.rtk.elevation_mask_rad = v.to_radians())
        },
    },
];

fn whole(text: &str, lowest: usize, highest: usize) -> Option<usize> {
    text.parse().ok().filter(|value| (lowest..=highest).contains(value))
}

//! The table of the factor graph's options; shown after those of every mode.

use super::option_specification::{OptionSpecification, number, switch, switch_text};
use super::{DopplerUse, KernelLaw};

#[rustfmt::skip]
pub(super) const GRAPH_TABLE: &[OptionSpecification] = &[
    OptionSpecification {
        name: "window_s", unit: "s",
        meaning: "length of the sliding window; older epochs are marginalised into a prior",
        allowed: "a number from 1 to 3600",
        get: |o| o.graph.window_s.to_string(),
        set: |o, text| number(text, 1.0, 3600.0).map(|v| o.graph.window_s = v),
    },
    OptionSpecification {
        name: "window_epochs_max", unit: "",
        meaning: "largest number of epochs in the window, at any rate",
        allowed: "a whole number from 2 to 1000",
        get: |o| o.graph.window_epochs_max.to_string(),
        set: |o, text| {
            let whole = text.parse().ok().filter(|v| (2..=1000).contains(v));
            whole.map(|v| o.graph.window_epochs_max = v)
        },
    },
    OptionSpecification {
        name: "orbit_clock_sigma_m", unit: "m",
        meaning: "range error of broadcast orbits and clocks (1 sigma), in the reported covariance",
        allowed: "a number from 0 to 100",
        get: |o| o.graph.orbit_clock_sigma_m.to_string(),
        set: |o, text| number(text, 0.0, 100.0).map(|v| o.graph.orbit_clock_sigma_m = v),
    },
    OptionSpecification {
        name: "pseudorange_kernel", unit: "",
        meaning: "robust kernel of the pseudoranges, or mixture, which learns the receiver",
        allowed: "quadratic, huber, cauchy, geman-mcclure, mixture",
        get: |o| o.graph.pseudorange_kernel.name().to_owned(),
        set: |o, text| KernelLaw::from_name(text).map(|v| o.graph.pseudorange_kernel = v),
    },
    OptionSpecification {
        name: "early_width", unit: "sigma",
        meaning: "kernel width for pseudoranges shorter than predicted",
        allowed: "a number from 0.1 to 100",
        get: |o| o.graph.early_width.to_string(),
        set: |o, text| number(text, 0.1, 100.0).map(|v| o.graph.early_width = v),
    },
    OptionSpecification {
        name: "late_width", unit: "sigma",
        meaning: "kernel width for pseudoranges longer than predicted, as reflected signals are",
        allowed: "a number from 0.1 to 100",
        get: |o| o.graph.late_width.to_string(),
        set: |o, text| number(text, 0.1, 100.0).map(|v| o.graph.late_width = v),
    },
    OptionSpecification {
        name: "independence_s", unit: "s",
        meaning: "epochs closer than this share the pseudorange weight of one epoch",
        allowed: "a number from 0.01 to 3600",
        get: |o| o.graph.independence_s.to_string(),
        set: |o, text| number(text, 0.01, 3600.0).map(|v| o.graph.independence_s = v),
    },
    OptionSpecification {
        name: "correlation_s", unit: "s",
        meaning: "correlation time of pseudorange errors, in the reported covariance",
        allowed: "a number from 0.01 to 3600",
        get: |o| o.graph.correlation_s.to_string(),
        set: |o, text| number(text, 0.01, 3600.0).map(|v| o.graph.correlation_s = v),
    },
    OptionSpecification {
        name: "doppler", unit: "",
        meaning: "Doppler in the graph: none, one factor a satellite, or one velocity an epoch",
        allowed: "none, satellites, velocity",
        get: |o| o.graph.doppler.name().to_owned(),
        set: |o, text| DopplerUse::from_name(text).map(|v| o.graph.doppler = v),
    },
    OptionSpecification {
        name: "doppler_width", unit: "sigma",
        meaning: "width of the Cauchy kernel of Doppler",
        allowed: "a number from 0.1 to 100",
        get: |o| o.graph.doppler_width.to_string(),
        set: |o, text| number(text, 0.1, 100.0).map(|v| o.graph.doppler_width = v),
    },
    OptionSpecification {
        name: "doppler_velocity_sigma_m_s", unit: "m/s",
        meaning: "standard deviation of the Doppler velocity, with doppler=velocity",
        allowed: "a number from 0.001 to 100",
        get: |o| o.graph.doppler_velocity_sigma_m_s.to_string(),
        set: |o, text| number(text, 0.001, 100.0).map(|v| o.graph.doppler_velocity_sigma_m_s = v),
    },
    OptionSpecification {
        name: "phase", unit: "",
        meaning: "whether time-differenced carrier phase is used",
        allowed: "on, off",
        get: |o| switch_text(o.graph.phase),
        set: |o, text| switch(text).map(|v| o.graph.phase = v),
    },
    OptionSpecification {
        name: "phase_sigma_m", unit: "m",
        meaning: "standard deviation of a strong signal's phase difference, with multipath",
        allowed: "a number from 0.001 to 10",
        get: |o| o.graph.phase_sigma_m.to_string(),
        set: |o, text| number(text, 0.001, 10.0).map(|v| o.graph.phase_sigma_m = v),
    },
    OptionSpecification {
        name: "phase_width", unit: "sigma",
        meaning: "width of the Geman-McClure kernel of phase differences",
        allowed: "a number from 0.1 to 100",
        get: |o| o.graph.phase_width.to_string(),
        set: |o, text| number(text, 0.1, 100.0).map(|v| o.graph.phase_width = v),
    },
    OptionSpecification {
        name: "horizontal_walk_m_s", unit: "m/s/√s",
        meaning: "random walk of the horizontal velocity, per axis",
        allowed: "a number from 0.0001 to 100",
        get: |o| o.graph.horizontal_walk_m_s.to_string(),
        set: |o, text| number(text, 0.0001, 100.0).map(|v| o.graph.horizontal_walk_m_s = v),
    },
    OptionSpecification {
        name: "vertical_walk_m_s", unit: "m/s/√s",
        meaning: "random walk of the vertical velocity",
        allowed: "a number from 0.0001 to 100",
        get: |o| o.graph.vertical_walk_m_s.to_string(),
        set: |o, text| number(text, 0.0001, 100.0).map(|v| o.graph.vertical_walk_m_s = v),
    },
    OptionSpecification {
        name: "vertical_velocity_m_s", unit: "m/s",
        meaning: "standard deviation of the vertical velocity about zero",
        allowed: "a number from 0.0001, or inf",
        get: |o| o.graph.vertical_velocity_m_s.to_string(),
        set: |o, text| {
            let sigma = number(text, 0.0001, f64::INFINITY);
            sigma.map(|v| o.graph.vertical_velocity_m_s = v)
        },
    },
    OptionSpecification {
        name: "zero_velocity", unit: "",
        meaning: "whether epochs at rest, detected in Doppler, get a zero-velocity factor",
        allowed: "on, off",
        get: |o| switch_text(o.graph.zero_velocity),
        set: |o, text| switch(text).map(|v| o.graph.zero_velocity = v),
    },
    OptionSpecification {
        name: "motion", unit: "",
        meaning: "whether motion and clock factors tie consecutive epochs",
        allowed: "on, off",
        get: |o| switch_text(o.graph.motion),
        set: |o, text| switch(text).map(|v| o.graph.motion = v),
    },
    OptionSpecification {
        name: "clock_walk_m", unit: "m/√s",
        meaning: "random walk of the receiver clock",
        allowed: "a number from 0.0001 to 1000000",
        get: |o| o.graph.clock_walk_m.to_string(),
        set: |o, text| number(text, 0.0001, 1000000.0).map(|v| o.graph.clock_walk_m = v),
    },
    OptionSpecification {
        name: "drift_walk_m_s", unit: "m/s/√s",
        meaning: "random walk of the receiver clock drift",
        allowed: "a number from 0.0001 to 1000000",
        get: |o| o.graph.drift_walk_m_s.to_string(),
        set: |o, text| number(text, 0.0001, 1000000.0).map(|v| o.graph.drift_walk_m_s = v),
    },
    OptionSpecification {
        name: "bias_walk_m", unit: "m/√s",
        meaning: "random walk of each inter-system bias",
        allowed: "a number from 0 to 1000",
        get: |o| o.graph.bias_walk_m.to_string(),
        set: |o, text| number(text, 0.0, 1000.0).map(|v| o.graph.bias_walk_m = v),
    },
    OptionSpecification {
        name: "gap_s", unit: "s",
        meaning: "a pause longer than this restarts the graph",
        allowed: "a number from 1 to 86400",
        get: |o| o.graph.gap_s.to_string(),
        set: |o, text| number(text, 1.0, 86400.0).map(|v| o.graph.gap_s = v),
    },
];

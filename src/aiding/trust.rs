//! How far a source of navigation data is trusted, and whether two sources agree.
//!
//! The order of trust is: the operator's archives and streams, then data on which two independent
//! sources agree, then uploads and the streams of bases, and last the data that one device has
//! decoded. Data of the first three serve all sessions; those of a device serve only its own
//! session, until another source agrees. A source of lower trust replaces and contradicts nothing.
//!
//! All sources of a tenant other than the operator (its devices, uploads and bases) count as one
//! source with the trust of a device. It serves only the sessions of the tenant, until a source of
//! another tenant agrees. So no tenant can bring data to others, however many devices it has.

use std::sync::Arc;

use crate::gnss::{
    Ephemeris, GpsTime, GroupDelays, NO_PREDICTION_M, NavigationMessage, SatelliteId,
};
use crate::models::{satellite_state, validity_s};
use crate::store::{OWNER_PREFIX, TENANT_PREFIX};
use crate::tenant::Tenant;

/// Source of uploaded files, as the navigation status names it.
pub const UPLOAD: &str = "upload";
/// Source of data on which two independent sources agree.
pub const AGREED: &str = "agreed";
/// Prefix of the sources that are streams of bases.
pub(crate) const OF_BASE: &str = "base ";
/// Source of the data of devices in earlier versions, which served all sessions at once.
const DEVICE_OF_EARLIER_VERSIONS: &str = "device";
/// Two ephemerides contradict each other if the satellite's positions or clocks by them differ by
/// more (m). Consecutive broadcasts differ by some metres at times for which both are valid.
const CONTRADICTION_M: f64 = 100.0;
/// Copies of one broadcast agree if these differences are below (m). Files round the values.
const AGREEMENT_M: f64 = 0.1;
/// Largest difference of two group delays that are copies of one broadcast (s).
const DELAY_S: f64 = 1e-10;
/// Largest ratio of two stated accuracies that are copies of one broadcast.
const ACCURACY_RATIO: f64 = 1.5;

/// Trust in a source, the lowest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Trust {
    /// A device, trusted by its own session only, or a tenant, trusted by its own sessions only.
    Device,
    /// An upload, or the stream of a base.
    Offer,
    /// Two independent sources.
    Agreed,
    /// The operator's archives and streams.
    Operator,
}

/// The trust in a source.
pub(super) fn trust(source: &str) -> Trust {
    match source {
        UPLOAD | DEVICE_OF_EARLIER_VERSIONS => Trust::Offer,
        AGREED => Trust::Agreed,
        _ if source.starts_with(OWNER_PREFIX) => Trust::Device,
        _ if source.starts_with(OF_BASE) => Trust::Offer,
        _ => Trust::Operator,
    }
}

/// The source that is the device of an operator's session.
pub fn device(session: &str) -> Arc<str> {
    format!("{OWNER_PREFIX}{session}").into()
}

/// The source that is the device of a tenant's session.
pub(crate) fn rover_source(tenant: &Tenant, session: &str) -> Arc<str> {
    tenant_source(tenant).unwrap_or_else(|| device(session))
}

/// The source that stands for all sources of a tenant; `None` for the operator, whose sources
/// differ.
pub(crate) fn tenant_source(tenant: &Tenant) -> Option<Arc<str>> {
    (!tenant.is_operator()).then(|| format!("{TENANT_PREFIX}{tenant}").into())
}

/// Whether two ephemerides of one satellite give different orbits or clocks at a time for which
/// both are valid. False if there is no such time, or if they are of different messages.
pub(super) fn contradict(one: &Ephemeris, other: &Ephemeris) -> bool {
    let apart_s = (one.toe() - other.toe()).abs();
    if message(one) != message(other) || validity_s(one).min(validity_s(other)) < apart_s {
        return false;
    }
    let time = one.toe() + (other.toe() - one.toe()) / 2.0;
    let apart_m = apart_m(one, other, time);
    apart_m.is_nan() || CONTRADICTION_M < apart_m
}

/// Whether two ephemerides are copies of one broadcast: the same orbit, clock, group delays,
/// accuracy and health.
pub(super) fn agree(one: &Ephemeris, other: &Ephemeris) -> bool {
    let validity_s = validity_s(one);
    let times = [-validity_s, 0.0, validity_s].map(|after_s| one.toe() + after_s);
    issue(one) == issue(other)
        && times.iter().all(|time| apart_m(one, other, *time) <= AGREEMENT_M)
        && have_same_properties(one, other)
}

fn have_same_properties(one: &Ephemeris, other: &Ephemeris) -> bool {
    match (one, other) {
        (Ephemeris::Keplerian(one), Ephemeris::Keplerian(other)) => {
            let (a, b) = (delays_s(&one.group_delays), delays_s(&other.group_delays));
            one.health == other.health
                && is_same_accuracy(one.accuracy_m, other.accuracy_m)
                && a.iter().zip(&b).all(|(a, b)| is_same_delay(*a, *b))
        }
        (Ephemeris::Glonass(one), Ephemeris::Glonass(other)) => {
            (one.health, one.channel) == (other.health, other.channel)
                && is_same_accuracy(one.accuracy_m, other.accuracy_m)
                && is_same_delay(one.delta_tau_s, other.delta_tau_s)
        }
        _ => false,
    }
}

fn is_same_delay(one_s: Option<f64>, other_s: Option<f64>) -> bool {
    match (one_s, other_s) {
        (Some(one), Some(other)) => (one - other).abs() <= DELAY_S,
        (one, other) => one == other,
    }
}

/// Files contain the accuracy itself, messages an index of it. A file that does not state it does
/// not contradict one that does, unless this warns against use.
fn is_same_accuracy(one_m: Option<f64>, other_m: Option<f64>) -> bool {
    match (one_m, other_m) {
        (Some(one), Some(other)) => one.max(other) <= ACCURACY_RATIO * one.min(other),
        (Some(stated), None) | (None, Some(stated)) => stated < NO_PREDICTION_M,
        (None, None) => true,
    }
}

/// All delays of one kind of message, in a fixed order.
fn delays_s(delays: &GroupDelays) -> [Option<f64>; 7] {
    match *delays {
        GroupDelays::Gps {
            tgd_s,
            isc_l1ca_s,
            isc_l2c_s,
            isc_l5i_s,
            isc_l5q_s,
            isc_l1cd_s,
            isc_l1cp_s,
        } => [Some(tgd_s), isc_l1ca_s, isc_l2c_s, isc_l5i_s, isc_l5q_s, isc_l1cd_s, isc_l1cp_s],
        GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s } => {
            [Some(bgd_e5a_s), bgd_e5b_s, None, None, None, None, None]
        }
        GroupDelays::BeiDou { tgd1_s, tgd2_s } => {
            [Some(tgd1_s), Some(tgd2_s), None, None, None, None, None]
        }
        GroupDelays::BeiDouCnav { tgd_b1cp_s, tgd_b2ap_s, tgd_b2bi_s, isc_b1cd_s, isc_b2ad_s } => {
            [tgd_b1cp_s, tgd_b2ap_s, tgd_b2bi_s, isc_b1cd_s, isc_b2ad_s, None, None]
        }
    }
}

/// Difference of the satellite's positions, or of its clocks if that is larger (m).
fn apart_m(one: &Ephemeris, other: &Ephemeris, time: GpsTime) -> f64 {
    let (a, b) = (satellite_state(one, time), satellite_state(other, time));
    let (orbits_m, clocks_m) = (a.position.distance_m(b.position), (a.clock_m - b.clock_m).abs());
    if orbits_m.is_nan() || clocks_m.is_nan() { f64::NAN } else { orbits_m.max(clocks_m) }
}

/// Identifies one issue of an ephemeris: satellite, message, toe, toc, issue of data.
pub(super) type Issue = (SatelliteId, NavigationMessage, GpsTime, GpsTime, u32);

pub(super) fn issue(ephemeris: &Ephemeris) -> Issue {
    let (toe, toc) = (ephemeris.toe(), ephemeris.toc());
    (ephemeris.satellite(), message(ephemeris), toe, toc, ephemeris.issue())
}

const fn message(ephemeris: &Ephemeris) -> NavigationMessage {
    match ephemeris {
        Ephemeris::Keplerian(keplerian) => keplerian.message,
        Ephemeris::Glonass(_) => NavigationMessage::Fdma,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_have_an_order() {
        let sources = [&*device("a"), "base ntrip://caster/B", AGREED, "https://archive/brdc.rnx"];
        assert!(sources.windows(2).all(|pair| trust(pair[0]) < trust(pair[1])));
        assert_eq!(trust(UPLOAD), trust(DEVICE_OF_EARLIER_VERSIONS));
    }

    #[test]
    fn an_accuracy_that_is_not_stated_contradicts_no_other_but_a_warning() {
        assert!(is_same_accuracy(None, None) && is_same_accuracy(Some(2.0), Some(2.4)));
        assert!(is_same_accuracy(None, Some(2.0)) && is_same_accuracy(Some(2.0), None));
        assert!(!is_same_accuracy(None, Some(NO_PREDICTION_M)));
        assert!(!is_same_accuracy(Some(2.0), Some(NO_PREDICTION_M)));
    }
}

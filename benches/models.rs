//! Time of the models of one satellite.

use divan::{Bencher, black_box};
use graphfix::gnss::{
    Ecef, Ephemeris, Geodetic, GlonassEphemeris, GpsTime, GroupDelays, KeplerianEphemeris,
    LocalFrame, NavigationMessage,
};
use graphfix::models::troposphere::{Mapping, Troposphere};
use graphfix::models::{geometric_range, look_angles, satellite_state, state_at_transmission};
use nalgebra::Vector3;

fn main() {
    divan::main();
}

fn toe() -> GpsTime {
    GpsTime::from_week_seconds(2244, 388_800.0)
}

fn gps() -> Ephemeris {
    Ephemeris::Keplerian(KeplerianEphemeris {
        satellite: "G05".parse().expect("a satellite"),
        message: NavigationMessage::Lnav,
        toc: toe(),
        toe: toe(),
        transmission_time: None,
        af0_s: 2.5e-4,
        af1: -4.5e-12,
        af2_per_s: 0.0,
        iode: 48,
        iodc: 48,
        sqrt_a: 5153.7,
        a_dot_m_s: 0.0,
        eccentricity: 0.012,
        m0_rad: 0.7,
        delta_n_rad_s: 4.5e-9,
        delta_n_dot_rad_s2: 0.0,
        omega_rad: 0.9,
        omega0_rad: -1.5,
        omega_dot_rad_s: -8.1e-9,
        i0_rad: 0.96,
        idot_rad_s: 2e-10,
        cuc_rad: 2.5e-6,
        cus_rad: 1.5e-6,
        crc_m: 360.0,
        crs_m: 46.0,
        cic_rad: 9e-8,
        cis_rad: -1.1e-7,
        accuracy_m: Some(2.0),
        health: 0,
        fit_interval_h: None,
        group_delays: GroupDelays::Gps {
            tgd_s: -5e-9,
            isc_l1ca_s: None,
            isc_l2c_s: None,
            isc_l5i_s: None,
            isc_l5q_s: None,
            isc_l1cd_s: None,
            isc_l1cp_s: None,
        },
    })
}

fn glonass() -> Ephemeris {
    Ephemeris::Glonass(GlonassEphemeris {
        satellite: "R07".parse().expect("a satellite"),
        toe: toe(),
        transmission_time: None,
        position_m: Vector3::new(8_203_926.0, 17_381_693.0, -16_773_025.0),
        velocity_m_s: Vector3::new(-1_689.2, -1_558.9, -2_441.2),
        acceleration_m_s2: Vector3::new(1e-6, -2e-6, 3e-6),
        clock_bias_s: 2e-5,
        gamma: 9.1e-13,
        delta_tau_s: None,
        channel: 1,
        health: 0,
        accuracy_m: None,
        age_days: 0,
    })
}

#[divan::bench]
fn kepler_state(bencher: Bencher) {
    let ephemeris = gps();
    let time = toe() + 1_234.5;
    bencher.bench(|| satellite_state(black_box(&ephemeris), black_box(time)));
}

#[divan::bench]
fn kepler_state_at_transmission(bencher: Bencher) {
    let ephemeris = gps();
    let time = toe() + 1_234.5;
    bencher.bench(|| state_at_transmission(black_box(&ephemeris), black_box(time), 2.3e7));
}

#[divan::bench(args = [60.0, 450.0, 900.0])]
fn glonass_state(bencher: Bencher, seconds_from_toe: f64) {
    let ephemeris = glonass();
    let time = toe() + seconds_from_toe;
    bencher.bench(|| satellite_state(black_box(&ephemeris), black_box(time)));
}

#[divan::bench]
fn range_and_angles(bencher: Bencher) {
    let receiver = Geodetic::from_degrees(22.3, 114.2, 5.0).to_ecef();
    let satellite = Ecef::new(-10_000_000.0, 20_000_000.0, 14_000_000.0);
    let frame = LocalFrame::at(receiver);
    bencher.bench(|| {
        let satellite = black_box(satellite);
        (geometric_range(satellite, receiver), look_angles(&frame, satellite))
    });
}

#[divan::bench]
fn troposphere_slant_by_niell(bencher: Bencher) {
    let receiver = Geodetic::from_degrees(22.3, 114.2, 5.0);
    let sky = Troposphere::saastamoinen(&receiver, toe(), 0.7, Mapping::Niell);
    let sky = sky.expect("near the ground");
    bencher.bench(|| black_box(&sky).slant_delay_m(black_box(0.6)));
}

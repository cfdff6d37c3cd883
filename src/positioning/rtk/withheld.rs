//! What the phases of an epoch know of its position beyond the weight they are given.

use nalgebra::{Matrix3, Vector3};

use crate::graph::{SharingRow, shared_offset};

use super::arcs::Arcs;
use super::epoch::{RtkEpoch, Scratch, State};
use super::settings::CARRIER_KERNEL;

/// D, by which a position with covariance C and integers held has the covariance C − C·D·C (1/m²).
///
/// A phase keeps a share s of its weight, v = s/σ²: errors last, and what goes before has told the
/// ambiguity the rest. With integers held there is no ambiguity to be told, and of the position,
/// which each epoch has anew, C then says too little. The covariance of a linear estimator whose
/// weights are less than the inverse variances is C·(C⁻¹ − D)·C with D = Σ v(1 − s)(a − ā)(a − ā)ᵀ
/// over the rows of each group, a their slopes and ā those slopes' mean weighted by v.
pub(super) fn withheld_information(
    epoch: &RtkEpoch,
    position: &Vector3<f64>,
    border: &[f64],
    arcs: &Arcs,
    scratch: &mut Scratch,
) -> Matrix3<f64> {
    let mut state = State::zeros();
    state.fixed_rows_mut::<3>(0).copy_from(position);
    epoch.see(&state, scratch);
    let mut withheld = Matrix3::zeros();
    for group in epoch.groups.iter().filter(|group| group.is_carrier) {
        epoch.linearize_group(group, border, scratch);
        let Scratch { rows, numbers, .. } = &mut *scratch;
        arcs.put_labels(border, rows);
        let offset_m = shared_offset(rows, &CARRIER_KERNEL, numbers);
        let weigh = |row: &SharingRow<3>| {
            let weight = CARRIER_KERNEL.weight(row.row.residual + row.by_offset * offset_m);
            let slope = Vector3::from(row.row.jacobian) / row.by_offset;
            (weight * row.share * row.by_offset.powi(2), slope)
        };
        let (mut total, mut mean) = (0.0, Vector3::zeros());
        for (v, slope) in rows.iter().map(weigh) {
            total += v;
            mean += slope * v;
        }
        if total == 0.0 {
            continue;
        }
        mean /= total;
        for row in rows.iter() {
            let (v, slope) = weigh(row);
            let centred = slope - mean;
            withheld += centred * centred.transpose() * (v * (1.0 - row.share));
        }
    }
    withheld
}

#[cfg(test)]
mod tests {
    use super::super::arcs::{Arc, Label};
    use super::super::epoch::{Ambiguity, DifferenceFactor, Group};
    use super::*;
    use crate::gnss::{
        Band, Constellation, Ecef, GpsTime, LocalFrame, ObservationCode, SatelliteId,
    };
    use crate::positioning::factors::Sight;

    const SATELLITES: usize = 6;
    const WAVELENGTH_M: f64 = 0.19;

    /// An epoch whose phases agree with the origin and integers 3k, each with a share of its weight.
    fn epoch(frame: &LocalFrame, share: f64) -> (RtkEpoch, Vec<f64>, Arcs) {
        let (mut epoch, mut arcs) = (RtkEpoch::new(), Arcs::default());
        let code = ObservationCode::parse("1C").unwrap();
        for k in 0..SATELLITES {
            let (azimuth, elevation) = (k as f64, 0.4 + 0.2 * k as f64);
            let level = elevation.cos();
            let line = Vector3::new(level * azimuth.sin(), level * azimuth.cos(), elevation.sin());
            let satellite = Ecef(frame.origin.0 + frame.rotation.transpose() * line * 2.2e7);
            let sight = Sight::new(frame, satellite);
            let (range_m, _) = sight.range(&Vector3::zeros());
            epoch.sights.push(sight);
            epoch.rows.push(DifferenceFactor {
                sight: k,
                range_m: range_m + 3.0 * k as f64 * WAVELENGTH_M,
                inverse_sigma: 100.0,
                share,
                ambiguity: Some(Ambiguity { variable: k, wavelength_m: WAVELENGTH_M }),
                bias: None,
            });
            arcs.list.push(Arc {
                satellite: SatelliteId::new(Constellation::Gps, 1 + k as u8).unwrap(),
                band: Band::L1,
                codes: [code; 2],
                variable: k,
                serial: k as u64,
                frequency_hz: 1_575.42e6,
                last: GpsTime::EPOCH,
                epochs: 9,
                half_cycle: false,
                elevation_rad: elevation,
                label: Some(Label { origin: 1, integer: 3 * k as i64 }),
            });
        }
        epoch.groups.push(Group { begin: 0, end: SATELLITES, is_carrier: true });
        let border = (0..SATELLITES).map(|k| 3.0 * k as f64).collect();
        (epoch, border, arcs)
    }

    /// Phases at a fifth of their weight alone have five times their covariance; with what is
    /// withheld, their own. At full weight nothing is withheld.
    #[test]
    fn phases_alone_have_their_own_covariance() {
        let frame = LocalFrame::at(Ecef(Vector3::new(4.0e6, 1.0e6, 4.85e6)));
        let withheld = |share: f64| {
            let (epoch, border, arcs) = epoch(&frame, share);
            let scratch = &mut Scratch::default();
            withheld_information(&epoch, &Vector3::zeros(), &border, &arcs, scratch)
        };
        // Σ (a − ā)(a − ā)ᵀ/σ², from half of which half is withheld.
        let information = withheld(0.5) * 4.0;
        let own = information.try_inverse().unwrap();
        let fifth = own * 5.0;
        let mended = fifth - fifth * withheld(0.2) * fifth;
        assert!((mended - own).norm() < 1e-9 * own.norm(), "{mended} {own}");
        assert_eq!(withheld(1.0), Matrix3::zeros());
        // σ is 1 cm: so is the horizontal uncertainty, about.
        assert!((0.005..0.02).contains(&own[(0, 0)].sqrt()), "{own}");
    }
}

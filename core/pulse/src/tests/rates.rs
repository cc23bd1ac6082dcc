//! Prescribed and supplied heart rates come back.
#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::Prescription;

#[test]
fn prescribed_rates_from_40_to_200_come_back_within_0_3_bpm() {
    let times = times(20.0, 30.0);
    for bpm in (40..=200).step_by(10) {
        let prescription = Prescription { heart_rate_bpm: f64::from(bpm), ..Prescription::default() };
        let reference = prescription.reference(&times).unwrap();
        let (pulse, _) = fit(&reference, &PhaseOptions::default()).unwrap();
        let read = read_bpm(&pulse.fundamental, 30.0);
        assert!((read - f64::from(bpm)).abs() < 0.3, "{bpm}: read {read}");
    }
}

#[test]
fn supplied_rates_from_40_to_200_come_back_within_0_3_bpm() {
    let times = times(20.0, 30.0);
    for bpm in (40..=200).step_by(20) {
        let ppg = made_up_ppg(24.0, 100.0, |_| f64::from(bpm), 0.02);
        let reference = Reference::from_ppg(&ppg, &times).unwrap();
        assert!((reference.mean_bpm - f64::from(bpm)).abs() < 1.0, "{bpm}: {}", reference.mean_bpm);
        let (pulse, _) = fit(&reference, &PhaseOptions::default()).unwrap();
        let read = read_bpm(&pulse.fundamental, 30.0);
        assert!((read - f64::from(bpm)).abs() < 0.3, "{bpm}: read {read}");
    }
}

//! Laws that hold for any signal: linearity, invariances, and that no input makes a function panic or answer with NaN.

use heartian_signal::beats::{BeatOptions, beat_aligned_phase, detect_beats};
use heartian_signal::hilbert::{analytic_signal, envelope, instantaneous_phase, unwrap};
use heartian_signal::methods::{PosWindow, pos_filtered, pos_trace, pseudo_label};
use heartian_signal::metrics::Evaluation;
use heartian_signal::stats::{macc, pearson};
use heartian_signal::{
    Band, Butterworth, Detrender, Method, Preset, Resolution, Spectrum, bandpass, detrend, estimate,
    peak_heart_rate_bpm, resampled_evenly,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// Numbers that break careless code, among ordinary ones.
fn poison() -> impl Strategy<Value = f64> {
    prop_oneof![
        20 => -300.0..300.0_f64,
        1 => prop::sample::select(vec![
            0.0, -0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN_POSITIVE, 5e-324, 1e99, -1e99, 1e-160,
        ]),
    ]
}

/// Ordinary and extreme finite numbers.
fn extreme() -> impl Strategy<Value = f64> {
    prop_oneof![20 => -300.0..300.0_f64, 1 => prop::sample::select(vec![0.0, 1e99, -1e99, 1e-160, 5e-324])]
}

fn any_rate() -> impl Strategy<Value = f64> {
    prop_oneof![6 => 5.0..200.0_f64, 1 => prop::sample::select(vec![0.0, -30.0, f64::NAN, f64::INFINITY, 1e-9, 1e12])]
}

fn all_finite(values: &[f64]) -> bool {
    values.iter().all(|value| value.is_finite())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn detrending_is_linear_contracts_and_forgets_lines(
        pairs in vec((-9.0..9.0_f64, -9.0..9.0_f64), 1..200), lambda in 0.0..1e4_f64, slope in -9.0..9.0_f64,
    ) {
        let (x, y): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        let line = |index: usize| 100.0 + slope * index as f64;
        let mixed: Vec<f64> = (0..x.len()).map(|i| 2.0 * x[i] - 3.0 * y[i] + line(i)).collect();
        let (dx, dy, dm) = (detrend(&x, lambda)?, detrend(&y, lambda)?, detrend(&mixed, lambda)?);
        for i in 0..x.len() {
            prop_assert!((dm[i] - (2.0 * dx[i] - 3.0 * dy[i])).abs() < 1e-6);
        }
        let norm = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
        prop_assert!(norm(&dx) <= norm(&x) * (1.0 + 1e-9));
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        prop_assert!((dot(&dx, &y) - dot(&x, &dy)).abs() <= 1e-9 * (1.0 + norm(&x) + norm(&y)), "self-adjoint");
    }

    #[test]
    fn filtering_is_linear_and_stable(
        pairs in vec((-9.0..9.0_f64, -9.0..9.0_f64), 22..300), order in 1..=3_usize,
        low in 0.01..0.3_f64, width in 0.02..0.19_f64, rate in 1.0..1000.0_f64,
    ) {
        let band = Band { low_hertz: low * rate, high_hertz: (low + width) * rate };
        let filter = Butterworth::bandpass(order, band, rate)?;
        let (x, y): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        let mixed: Vec<f64> = x.iter().zip(&y).map(|(x, y)| 2.0 * x - 3.0 * y + 50.0).collect();
        let (fx, fy, fm) = (filter.filtfilt(&x)?, filter.filtfilt(&y)?, filter.filtfilt(&mixed)?);
        for i in 0..x.len() {
            prop_assert!((fm[i] - (2.0 * fx[i] - 3.0 * fy[i])).abs() < 1e-6);
        }
    }

    #[test]
    fn a_heart_rate_ignores_unit_offset_and_direction_of_time(
        bpm in 50.0..170.0_f64, scale in 1e-6..1e6_f64, offset in -1e3..1e3_f64, seed in 0..1000_u32,
    ) {
        let noise = |i: u32| (f64::from(i * i % 7919) * 0.731 + f64::from(seed)).sin();
        let signal: Vec<f64> = (0..600)
            .map(|i| (std::f64::consts::TAU * bpm / 60.0 * f64::from(i) / 30.0).sin() + 0.3 * noise(i))
            .collect();
        let other: Vec<f64> = signal.iter().rev().map(|value| scale * (offset - value)).collect();
        let (here, there) = (estimate(&signal, 30.0, Preset::Paper)?, estimate(&other, 30.0, Preset::Paper)?);
        prop_assert!((here.bpm - there.bpm).abs() < 0.12, "{} {}", here.bpm, there.bpm);
        prop_assert!((here.bpm - bpm).abs() < 0.8, "{} for {bpm}", here.bpm);
    }

    #[test]
    fn correlations_stay_in_range_and_see_through_rolling(
        x in vec(-9.0..9.0_f64, 3..100), scale in 0.1..9.0_f64, lag in 0..50_usize,
    ) {
        // The last lag is left out, as in the toolbox; a roll by less than n − 1 is seen.
        let rolled: Vec<f64> = (0..x.len()).map(|i| -scale * x[(i + lag % (x.len() - 1)) % x.len()]).collect();
        if let Ok(found) = macc(&x, &rolled) {
            prop_assert!((found - 1.0).abs() < 1e-9, "{found}");
            prop_assert!((-1.0..=1.0).contains(&pearson(&x, &rolled)?));
        }
    }

    #[test]
    fn no_signal_makes_anything_panic(signal in vec(poison(), 0..150), rate in any_rate()) {
        let usable = !signal.is_empty() && signal.iter().all(|value| value.abs() <= 1e100);
        let answers = [
            detrend(&signal, 100.0),
            bandpass(&signal, rate, Band::PAPER, 1),
            envelope(&signal),
            instantaneous_phase(&signal).map(|phase| unwrap(&phase)),
            Spectrum::of(&signal, rate, Resolution::Toolbox).map(|spectrum| spectrum.power),
            estimate(&signal, rate, Preset::Paper).map(|rate| vec![rate.bpm]),
            peak_heart_rate_bpm(&signal, rate).map(|bpm| vec![bpm]),
            detect_beats(&signal, rate, &BeatOptions::default()).map(|beats| beats.seconds()),
            Evaluation::default().score(&signal, &signal, rate).map(|s| s.iter().map(|w| w.macc).collect()),
            resampled_evenly(&signal, &signal).map(|trace| trace.values),
            beat_aligned_phase(&signal, &signal).map(|phase| phase.phase_radians),
        ];
        for (index, answer) in answers.into_iter().enumerate() {
            if let Ok(values) = answer {
                prop_assert!(index >= 9 || usable, "answer {index} from an unusable signal");
                prop_assert!(all_finite(&values), "answer {index} is not finite: {values:?}");
            }
        }
        prop_assert_eq!(analytic_signal(&signal).is_ok(), usable);
        let mut operated = signal.clone();
        prop_assert_eq!(Detrender::new(signal.len(), 100.0).and_then(|d| d.apply(&mut operated)).is_ok(), !signal.is_empty());
    }

    #[test]
    fn no_colours_make_a_method_panic(
        rgb in vec([poison(), poison(), poison()], 0..120), rate in any_rate(),
    ) {
        for method in Method::ALL {
            if let Ok(trace) = method.trace(&rgb, rate) {
                prop_assert!(all_finite(&trace), "{}", method.name());
            }
        }
        for trace in [pos_trace(&rgb, rate, PosWindow::Global), pos_filtered(&rgb, rate, PosWindow::SLIDING), pseudo_label(&rgb, rate)] {
            prop_assert!(trace.is_err() || trace.is_ok_and(|trace| all_finite(&trace)));
        }
    }

    #[test]
    fn extreme_colours_give_an_answer_or_a_reason(
        rgb in vec([extreme(), extreme(), extreme()].prop_map(|color| color.map(f64::abs)), 60..100),
    ) {
        for method in Method::ALL {
            match method.trace(&rgb, 30.0) {
                Ok(trace) => prop_assert!(all_finite(&trace), "{}", method.name()),
                Err(error) => prop_assert!(!error.to_string().is_empty()),
            }
        }
    }
}

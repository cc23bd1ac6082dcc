//! `signals/`: detrending, filtering, spectrum and correlation.

use heartian_signal::stats;
use heartian_signal::{Band, Butterworth, Resolution, SignalError, Spectrum, local_maxima, peak_heart_rate_bpm};

use super::file::{Bound, Checks, Golden, Outcome};

/// `|a−b| ≤ rtol·|b| + atol_scale·max|b|`, as the manifest says.
fn scaled(golden: &Golden, want: &[f64]) -> Outcome<Bound> {
    let most = want.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    Ok(Bound { absolute: golden.tolerance("/atol_scale")? * most, relative: golden.tolerance("/rtol")? })
}

/// `signals/detrend.npz`.
pub fn detrend(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    for k in 0..golden.count("x") {
        let want = golden.array(&format!("y{k}"))?;
        let got = heartian_signal::detrend(golden.array(&format!("x{k}"))?, golden.scalar(&format!("lambda{k}"))?)?;
        checks.close("y", &got, want, scaled(golden, want)?);
    }
    Ok(())
}

/// `signals/bandpass_filtfilt.npz`.
pub fn bandpass(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    for k in 0..golden.count("x") {
        let [order, low_hertz, high_hertz, rate] = golden.array(&format!("cfg{k}"))? else {
            return Err("cfg has four values".into());
        };
        let band = Band { low_hertz: *low_hertz, high_hertz: *high_hertz };
        let filter = Butterworth::bandpass(*order as usize, band, *rate)?;
        let (b, a) = filter.coefficients();
        let filtered = filter.filtfilt(golden.array(&format!("x{k}"))?)?;
        for (name, got) in [("b", b), ("a", a), ("y", filtered)] {
            let want = golden.array(&format!("{name}{k}"))?;
            checks.close(name, &got, want, scaled(golden, want)?);
        }
    }
    Ok(())
}

/// `signals/hr_snr.npz`.
pub fn heart_rate(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let (exact, decibels) = (Bound::absolute(1e-12), Bound::absolute(1e-6));
    let within = Bound { absolute: golden.tolerance("/atol")?, relative: golden.tolerance("/rtol")? };
    let narrow = Band { low_hertz: 0.75, high_hertz: 2.5 };
    for k in 0..golden.count("x") {
        let x = golden.array(&format!("x{k}"))?;
        let rate = golden.scalar(&format!("fs{k}"))?;
        let spectrum = Spectrum::of(x, rate, Resolution::Toolbox)?;
        let frequencies: Vec<f64> = (0..spectrum.power.len()).map(|bin| spectrum.hertz(bin)).collect();
        checks.close("freq", &frequencies, golden.array(&format!("freq{k}"))?, Bound::absolute(0.0));
        checks.close("pxx", &spectrum.power, golden.array(&format!("pxx{k}"))?, within);
        let rates = [
            ("fft_hr", spectrum.heart_rate_bpm(Band::TOOLBOX)?),
            ("fft_hr_075_25_", spectrum.heart_rate_bpm(narrow)?),
            ("peak_hr", peak_or_nan(x, rate)?),
        ];
        for (name, got) in rates {
            checks.close(name, &[got], golden.array(&format!("{name}{k}"))?, exact);
        }
        let label = golden.scalar(&format!("hr_label{k}"))?;
        let ratios = [
            ("snr_own", spectrum.snr_db(rates[0].1, Band::TOOLBOX)),
            ("snr_label", spectrum.snr_db(label, Band::TOOLBOX)),
            ("snr_label_075_25_", spectrum.snr_db(label, narrow)),
        ];
        for (name, got) in ratios {
            checks.close(name, &[got], golden.array(&format!("{name}{k}"))?, decibels);
        }
        checks.close("peaks", &indices(x), golden.array(&format!("peaks{k}"))?, Bound::absolute(0.0));
    }
    let plateau = golden.array("plateau_x")?;
    checks.close("plateau", &indices(plateau), golden.array("plateau_peaks")?, Bound::absolute(0.0));
    checks.close("plateau_hr", &[peak_or_nan(plateau, 30.0)?], golden.array("plateau_peak_hr_fs30")?, exact);
    Ok(())
}

fn indices(x: &[f64]) -> Vec<f64> {
    local_maxima(x).into_iter().map(|index| index as f64).collect()
}

fn peak_or_nan(x: &[f64], rate: f64) -> Outcome<f64> {
    match peak_heart_rate_bpm(x, rate) {
        Err(SignalError::FewBeats { .. }) => Ok(f64::NAN),
        other => Ok(other?),
    }
}

/// `signals/macc.npz`.
pub fn macc(golden: &Golden, checks: &mut Checks) -> Outcome<()> {
    let bound = Bound { absolute: golden.tolerance("/atol")?, relative: golden.tolerance("/rtol")? };
    for k in 0..golden.count("pred") {
        let got = stats::macc(golden.array(&format!("pred{k}"))?, golden.array(&format!("gt{k}"))?)?;
        checks.close("macc", &[got], golden.array(&format!("macc{k}"))?, bound);
    }
    Ok(())
}

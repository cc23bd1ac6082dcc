//! Detrending, band-pass, spectrum, heart rate, SNR, unsupervised rPPG methods and their metrics.

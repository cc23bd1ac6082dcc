//! The sRGB transfer function (IEC 61966-2-1) and luminance. Linear and encoded values never share a name.

/// Rec. 709 luminance weights of linear RGB.
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Linear light of an sRGB-encoded value; both in [0, 1], values outside are extended by the same formula's ends.
pub fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// sRGB encoding of linear light. Negative values stay on the linear segment, so the function is odd-free but monotone.
pub fn srgb_from_linear(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Derivative of [`srgb_from_linear`].
pub fn srgb_from_linear_derivative(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * linear.powf(1.0 / 2.4 - 1.0) }
}

/// 8-bit code of an encoded value in [0, 1]: rounded, clamped; NaN becomes 0.
pub fn quantise(encoded: f32) -> u8 {
    (encoded * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

/// Luminance of a linear RGB triple.
pub fn luminance(linear: [f32; 3]) -> f32 {
    LUMINANCE.iter().zip(linear).map(|(weight, value)| weight * value).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfer_inverts_and_its_derivative_is_that() {
        for code in 0..=255u8 {
            let encoded = f32::from(code) / 255.0;
            let linear = linear_from_srgb(encoded);
            assert_eq!(quantise(srgb_from_linear(linear)), code);
            let h = 1e-3 * linear.max(1e-2);
            let slope = (f64::from(srgb_from_linear(linear + h)) - f64::from(srgb_from_linear(linear - h)))
                / (2.0 * f64::from(h));
            let exact = f64::from(srgb_from_linear_derivative(linear));
            assert!((slope - exact).abs() <= 0.05 * exact, "{linear}: {slope} {exact}");
        }
        assert_eq!(quantise(f32::NAN), 0);
        assert_eq!(quantise(f32::INFINITY), 255);
    }
}

//! The waveform figure: labelled signals over time on top, their spectra below, the same colour for the same signal.

use heartian_space::{Rgb8Image, Series};
use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{BitMapBackend, Cartesian2d, Color, IntoFont, LineSeries, PathElement, RGBColor, ShapeStyle};

use crate::ReportError;
use crate::canvas::{Area, FONT, draw_on, drawing};

type Chart<'a, 'b> = ChartContext<'a, BitMapBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

const SIZE_PX: (usize, usize) = (1200, 720);
pub(crate) const PALETTE: [RGBColor; 6] = [
    RGBColor(0, 0, 0),
    RGBColor(214, 40, 40),
    RGBColor(0, 119, 182),
    RGBColor(42, 157, 87),
    RGBColor(156, 102, 186),
    RGBColor(231, 142, 36),
];

/// One signal of the figure.
pub struct Curve {
    /// Its name in the legend.
    pub label: String,
    /// The signal over time.
    pub series: Series,
    /// Frequencies in hertz, increasing, and power there in any unit.
    pub spectrum: (Vec<f64>, Vec<f64>),
}

/// Draws the curves, each standardised and shown from its start for `seconds`, above their spectra, each scaled to a
/// peak of one, over `band_hertz`.
///
/// # Errors
/// When there is no curve, or the drawing library refuses.
pub fn waveform_figure(curves: &[Curve], seconds: f64, band_hertz: (f64, f64)) -> Result<Rgb8Image, ReportError> {
    let first = curves.first().ok_or(ReportError::Nothing("signal"))?;
    let start = first.series.times_seconds[0];
    let end = curves.iter().filter_map(|curve| curve.series.times_seconds.last()).fold(start, |a, b| a.max(*b));
    let span = (start, end.min(start + seconds).max(start + 1e-3));
    let mut image = Rgb8Image::filled(SIZE_PX.0, SIZE_PX.1, [255; 3]);
    draw_on(&mut image, |area| {
        let (top, bottom) = area.split_vertically(SIZE_PX.1 as i32 * 55 / 100);
        draw_waves(&top, curves, span)?;
        draw_spectra(&bottom, curves, band_hertz)
    })?;
    Ok(image)
}

fn draw_waves(area: &Area<'_>, curves: &[Curve], (from, to): (f64, f64)) -> Result<(), ReportError> {
    let mut context = axes(area, (from..to, -3.2..3.2), ("time, s", "standardised"))?;
    for (index, curve) in curves.iter().enumerate() {
        let values = standardised(&curve.series.values);
        let points = curve.series.times_seconds.iter().copied().zip(values).filter(|(time, _)| *time <= to);
        draw_line(&mut context, &curve.label, points.collect(), index)?;
    }
    legend(&mut context)
}

fn draw_spectra(area: &Area<'_>, curves: &[Curve], (low, high): (f64, f64)) -> Result<(), ReportError> {
    let mut context = axes(area, (60.0 * low..60.0 * high, 0.0..1.05), ("beats per minute", "power, peak = 1"))?;
    for (index, curve) in curves.iter().enumerate() {
        let (hertz, power) = &curve.spectrum;
        let inside = hertz.iter().zip(power).filter(|(f, _)| (low..=high).contains(*f));
        let points: Vec<(f64, f64)> = inside.map(|(f, p)| (60.0 * f, *p)).collect();
        let peak = points.iter().map(|(_, p)| *p).fold(0.0, f64::max);
        let scale = if peak > 0.0 { 1.0 / peak } else { 0.0 };
        draw_line(&mut context, &curve.label, points.into_iter().map(|(f, p)| (f, p * scale)).collect(), index)?;
    }
    legend(&mut context)
}

fn axes<'a>(
    area: &Area<'a>,
    (x, y): (std::ops::Range<f64>, std::ops::Range<f64>),
    (x_label, y_label): (&str, &str),
) -> Result<Chart<'a, 'a>, ReportError> {
    let mut builder = ChartBuilder::on(area);
    builder.margin(12).x_label_area_size(42).y_label_area_size(56);
    let mut context = builder.build_cartesian_2d(x, y).map_err(drawing)?;
    let mut mesh = context.configure_mesh();
    mesh.x_desc(x_label).y_desc(y_label).light_line_style(RGBColor(244, 244, 244));
    mesh.label_style((FONT, 16).into_font()).axis_desc_style((FONT, 17).into_font());
    mesh.draw().map_err(drawing)?;
    Ok(context)
}

fn draw_line(
    context: &mut Chart<'_, '_>,
    label: &str,
    points: Vec<(f64, f64)>,
    index: usize,
) -> Result<(), ReportError> {
    let color = PALETTE[index % PALETTE.len()];
    let style = ShapeStyle { color: color.to_rgba(), filled: false, stroke_width: if index == 0 { 3 } else { 2 } };
    let finite = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite());
    context
        .draw_series(LineSeries::new(finite, style))
        .map_err(drawing)?
        .label(label)
        .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 22, y)], style));
    Ok(())
}

fn legend<'a>(context: &mut Chart<'a, 'a>) -> Result<(), ReportError> {
    let mut labels = context.configure_series_labels();
    labels.background_style(RGBColor(255, 255, 255).mix(0.85)).border_style(RGBColor(200, 200, 200));
    labels.label_font((FONT, 16)).draw().map_err(drawing)
}

/// Zero mean and unit standard deviation; a constant signal becomes zeros.
fn standardised(values: &[f64]) -> Vec<f64> {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    let scale = if deviation > 0.0 { 1.0 / deviation } else { 0.0 };
    values.iter().map(|v| (v - mean) * scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(label: &str, bpm: f64) -> Curve {
        let times: Vec<f64> = (0..300).map(|k| f64::from(k) / 30.0).collect();
        let values = times.iter().map(|t| (std::f64::consts::TAU * bpm / 60.0 * t).sin()).collect();
        let hertz: Vec<f64> = (0..400).map(|k| f64::from(k) * 0.01).collect();
        let power = hertz.iter().map(|f| (-((f - bpm / 60.0) / 0.05).powi(2)).exp()).collect();
        Curve { label: label.into(), series: Series::new(times, values).expect("valid"), spectrum: (hertz, power) }
    }

    #[test]
    fn curves_leave_ink_of_their_colour() -> Result<(), ReportError> {
        let image = waveform_figure(&[curve("prescribed", 72.0), curve("rendered", 90.0)], 8.0, (0.6, 3.3))?;
        let ink = |color: RGBColor| image.data.chunks_exact(3).filter(|p| **p == [color.0, color.1, color.2]).count();
        assert!(ink(PALETTE[0]) > 500 && ink(PALETTE[1]) > 500);
        assert!(matches!(waveform_figure(&[], 8.0, (0.6, 3.3)), Err(ReportError::Nothing(_))));
        if let Some(folder) = std::env::var_os("HEARTIAN_KEEP_PICTURES") {
            std::fs::write(std::path::Path::new(&folder).join("figure.png"), crate::encode_png(&image)?)
                .expect("writable");
        }
        Ok(())
    }
}

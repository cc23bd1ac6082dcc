//! Milliseconds against size on logarithmic axes, one line a setting; what the setting is good for stands in the legend.

use heartian_space::Rgb8Image;
use plotters::chart::{ChartBuilder, SeriesLabelPosition};
use plotters::coord::combinators::IntoLogRange;
use plotters::prelude::{Circle, Color, IntoFont, LineSeries, PathElement, RGBColor, ShapeStyle};

use crate::ReportError;
use crate::canvas::{FONT, draw_on, drawing};
use crate::figure::PALETTE;

const SIZE_PX: (usize, usize) = (1000, 700);
/// Room around the points, as factors.
const PADDING: f64 = 1.3;

/// One setting at several sizes.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalingLine {
    /// Written in the legend.
    pub label: String,
    /// Size (> 0) and milliseconds (> 0).
    pub points: Vec<(f64, f64)>,
}

/// Draws the lines; `size` says what the horizontal axis counts. Points that no logarithm takes are left out.
///
/// # Errors
/// When no point can be shown, or the drawing library refuses.
pub fn scaling_figure(lines: &[ScalingLine], size: &str) -> Result<Rgb8Image, ReportError> {
    let is_shown = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite() && *x > 0.0 && *y > 0.0;
    let shown = || lines.iter().flat_map(|line| line.points.iter().filter(is_shown));
    if shown().next().is_none() {
        return Err(ReportError::Nothing("measurement"));
    }
    let range = |of: fn(&(f64, f64)) -> f64| {
        let (low, high) = shown().map(of).fold((f64::INFINITY, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
        low / PADDING..high * PADDING
    };
    let (x, y) = (range(|p| p.0), range(|p| p.1));
    let mut image = Rgb8Image::filled(SIZE_PX.0, SIZE_PX.1, [255; 3]);
    draw_on(&mut image, |area| {
        let mut builder = ChartBuilder::on(area);
        builder.margin(14).x_label_area_size(44).y_label_area_size(64);
        let mut chart = builder.build_cartesian_2d(x.log_scale(), y.log_scale()).map_err(drawing)?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc(size).y_desc("ms").light_line_style(RGBColor(246, 246, 246));
        mesh.label_style((FONT, 16).into_font()).axis_desc_style((FONT, 17).into_font());
        mesh.x_labels(4).x_label_formatter(&|size| format!("{size:.0}"));
        mesh.draw().map_err(drawing)?;
        for (index, line) in lines.iter().enumerate() {
            let color = PALETTE[index % PALETTE.len()];
            let points = || line.points.iter().filter(is_shown).copied();
            let style = ShapeStyle { color: color.to_rgba(), filled: false, stroke_width: 2 };
            let series = chart.draw_series(LineSeries::new(points(), style)).map_err(drawing)?;
            series
                .label(line.label.clone())
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
            chart.draw_series(points().map(|point| Circle::new(point, 5, color.filled()))).map_err(drawing)?;
        }
        let mut legend = chart.configure_series_labels();
        legend.position(SeriesLabelPosition::LowerRight).label_font((FONT, 16).into_font());
        legend.background_style(RGBColor(255, 255, 255)).draw().map_err(drawing)
    })?;
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_leave_ink_and_nothing_is_an_error() -> Result<(), ReportError> {
        let line = |points: &[(f64, f64)]| ScalingLine { label: "f32".into(), points: points.to_vec() };
        let image = scaling_figure(&[line(&[(1e3, 1.0), (1e5, 20.0), (f64::NAN, 1.0), (1.0, 0.0)])], "Gaussians")?;
        assert!(image.data.chunks_exact(3).filter(|p| **p == [0, 0, 0]).count() > 100);
        for nothing in [vec![], vec![line(&[])], vec![line(&[(0.0, 1.0), (1.0, f64::INFINITY)])]] {
            assert!(matches!(scaling_figure(&nothing, "Gaussians"), Err(ReportError::Nothing(_))));
        }
        Ok(())
    }
}

//! Seconds against error: one point a setting, both axes logarithmic, one colour a group.

use heartian_space::Rgb8Image;
use plotters::chart::ChartBuilder;
use plotters::coord::combinators::IntoLogRange;
use plotters::prelude::{Circle, Color, EmptyElement, IntoFont, LineSeries, RGBColor, ShapeStyle, Text};

use crate::ReportError;
use crate::canvas::{FONT, draw_on, drawing};
use crate::figure::PALETTE;

const SIZE_PX: (usize, usize) = (1200, 760);
/// How far below a point its words start.
const STAGGER_PX: [i32; 4] = [-7, 10, -24, 27];

/// One setting.
#[derive(Clone, Debug, PartialEq)]
pub struct TradeOff {
    /// Written beside the point.
    pub label: String,
    /// Points of one group share a colour and are joined by a line.
    pub group: String,
    /// Wall time, > 0.
    pub seconds: f64,
    /// What is gained by waiting: any error, > 0.
    pub error: f64,
}

/// Draws the points; `error` says what the vertical axis is.
///
/// # Errors
/// When no point can be shown on logarithmic axes, or the drawing library refuses.
pub fn trade_off_figure(points: &[TradeOff], error: &str) -> Result<Rgb8Image, ReportError> {
    let shown: Vec<&TradeOff> = points.iter().filter(|p| is_shown(p.seconds) && is_shown(p.error)).collect();
    if shown.is_empty() {
        return Err(ReportError::Nothing("setting"));
    }
    let x = padded(shown.iter().map(|p| p.seconds), [1.5, 3.0]);
    let y = padded(shown.iter().map(|p| p.error), [1.6, 1.6]);
    let mut groups: Vec<&str> = Vec::new();
    for point in &shown {
        if !groups.contains(&point.group.as_str()) {
            groups.push(&point.group);
        }
    }
    let mut image = Rgb8Image::filled(SIZE_PX.0, SIZE_PX.1, [255; 3]);
    draw_on(&mut image, |area| {
        let mut builder = ChartBuilder::on(area);
        builder.margin(14).x_label_area_size(44).y_label_area_size(84);
        let mut chart = builder.build_cartesian_2d(x.log_scale(), y.log_scale()).map_err(drawing)?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("seconds").y_desc(error).light_line_style(RGBColor(246, 246, 246));
        mesh.label_style((FONT, 16).into_font()).axis_desc_style((FONT, 17).into_font());
        mesh.x_label_formatter(&|v| format!("{v:.2}")).y_label_formatter(&|v| format!("{v:.0e}"));
        mesh.draw().map_err(drawing)?;
        for (index, group) in groups.iter().enumerate() {
            let color = PALETTE[index % PALETTE.len()];
            let of_group = || shown.iter().filter(|p| p.group == **group);
            let style = ShapeStyle { color: color.mix(0.5), filled: false, stroke_width: 1 };
            chart.draw_series(LineSeries::new(of_group().map(|p| (p.seconds, p.error)), style)).map_err(drawing)?;
            let dots = of_group().map(|p| Circle::new((p.seconds, p.error), 5, color.filled()));
            chart.draw_series(dots).map_err(drawing)?;
            let font = (FONT, 14).into_font().color(&color.to_rgba());
            // Words of neighbouring points at different heights, so that one can be read beside the other.
            let words = of_group().enumerate().map(|(k, p)| {
                let below = STAGGER_PX[(k + index) % STAGGER_PX.len()];
                EmptyElement::at((p.seconds, p.error)) + Text::new(p.label.clone(), (8, below), font.clone())
            });
            chart.draw_series(words).map_err(drawing)?;
        }
        Ok(())
    })?;
    Ok(image)
}

fn is_shown(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

/// From the least to the greatest, with room for points and words.
fn padded(values: impl Iterator<Item = f64>, [below, above]: [f64; 2]) -> std::ops::Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(low, high), value| (low.min(value), high.max(value)));
    low / below..high * above
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_leave_ink_and_what_no_logarithm_takes_is_left_out() -> Result<(), ReportError> {
        let point = |seconds: f64, error: f64| TradeOff { label: "3 epochs".into(), group: "a".into(), seconds, error };
        let image = trade_off_figure(&[point(0.1, 1e-2), point(3.0, 1e-4), point(1.0, 0.0)], "error")?;
        let color = PALETTE[0];
        let ink = image.data.chunks_exact(3).filter(|p| **p == [color.0, color.1, color.2]).count();
        assert!(ink > 100, "{ink}");
        let nothing = trade_off_figure(&[point(f64::NAN, 1.0), point(1.0, -1.0)], "error");
        assert!(matches!(nothing, Err(ReportError::Nothing(_))));
        Ok(())
    }
}

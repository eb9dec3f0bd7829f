//! Plots panel: metrics over time, with the timeline's cursor.

use eframe::egui::{self, Color32, Ui};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoint, PlotPoints, VLine};
use serde::{Deserialize, Serialize};

use crate::view::palette;
use crate::view::session::Session;
use crate::view::time_series::{CycleMetrics, Quantity, TimeSeries};

/// Least height of a plot, points.
const PLOT_HEIGHT_MIN: f32 = 80.0;

/// A plot: its name, unit and curves.
struct PlotSpec {
    name: &'static str,
    unit: &'static str,
    curves: &'static [(&'static str, Quantity, Color32, f32)],
}

/// All plots. The last number of a curve converts its quantity to the plot's unit.
const PLOTS: [PlotSpec; 12] = [
    PlotSpec {
        name: "Error",
        unit: "cm",
        curves: &[(
            "position",
            Quantity::PositionError,
            palette::VERMILION,
            100.0,
        )],
    },
    PlotSpec {
        name: "Heading error",
        unit: "°",
        curves: &[("heading", Quantity::HeadingError, palette::VERMILION, 1.0)],
    },
    PlotSpec {
        name: "Covariance",
        unit: "cm, °",
        curves: &[
            ("std x", Quantity::StdX, palette::ORANGE, 100.0),
            ("std y", Quantity::StdY, palette::SKY, 100.0),
            ("std heading", Quantity::StdHeading, palette::PURPLE, 1.0),
        ],
    },
    PlotSpec {
        name: "Residual",
        unit: "cm",
        curves: &[("residual", Quantity::Residual, palette::ORANGE, 100.0)],
    },
    PlotSpec {
        name: "Line points",
        unit: "points, %",
        curves: &[
            ("points", Quantity::LinePoints, palette::SKY, 1.0),
            ("rejected", Quantity::RejectedCandidates, palette::GREY, 1.0),
            ("inliers", Quantity::InlierShare, palette::GREEN, 100.0),
        ],
    },
    PlotSpec {
        name: "Entropy",
        unit: "bit",
        curves: &[("image", Quantity::Entropy, palette::SKY, 1.0)],
    },
    PlotSpec {
        name: "Brightness",
        unit: "0 to 255",
        curves: &[("brightness", Quantity::Brightness, palette::YELLOW, 1.0)],
    },
    PlotSpec {
        name: "Exposure and gain",
        unit: "camera units",
        curves: &[
            ("exposure", Quantity::ExposureTime, palette::ORANGE, 1.0),
            ("gain", Quantity::Gain, palette::SKY, 1.0),
        ],
    },
    PlotSpec {
        name: "Stage times",
        unit: "ms",
        curves: &[
            ("vision", Quantity::VisionTime, palette::ORANGE, 1.0),
            (
                "localization",
                Quantity::LocalizationTime,
                palette::SKY,
                1.0,
            ),
            ("cycle period", Quantity::CyclePeriod, palette::GREY, 1.0),
        ],
    },
    PlotSpec {
        name: "Queue drops",
        unit: "cycles",
        curves: &[("dropped", Quantity::Dropped, palette::VERMILION, 1.0)],
    },
    PlotSpec {
        name: "Wheel speeds",
        unit: "m/s",
        curves: &[
            ("wheel 1", Quantity::Wheel0, palette::ORANGE, 1.0),
            ("wheel 2", Quantity::Wheel1, palette::SKY, 1.0),
            ("wheel 3", Quantity::Wheel2, palette::GREEN, 1.0),
            ("wheel 4", Quantity::Wheel3, palette::PURPLE, 1.0),
        ],
    },
    PlotSpec {
        name: "IMU",
        unit: "m/s², °/s / 10",
        curves: &[
            ("x", Quantity::AccelerationX, palette::ORANGE, 1.0),
            ("y", Quantity::AccelerationY, palette::SKY, 1.0),
            ("yaw rate", Quantity::YawRate, palette::PURPLE, 0.1),
        ],
    },
];

/// State of the panel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct PlotsPanel {
    /// Names of the shown plots.
    pub(crate) shown: Vec<String>,
    /// Time range around the cursor, seconds; 0 shows the whole run.
    pub(crate) window_s: f64,
}

impl Default for PlotsPanel {
    fn default() -> Self {
        PlotsPanel {
            shown: ["Error", "Covariance", "Line points", "Stage times"]
                .map(str::to_owned)
                .to_vec(),
            window_s: 0.0,
        }
    }
}

impl PlotsPanel {
    /// Draws the panel; a click seeks to its time.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Curves", |ui| {
                for spec in &PLOTS {
                    let mut shown = self.shown.iter().any(|name| name == spec.name);
                    if ui.checkbox(&mut shown, spec.name).changed() {
                        self.shown.retain(|name| name != spec.name);
                        if shown {
                            self.shown.push(spec.name.to_owned());
                        }
                    }
                }
            });
            for (name, window) in [("All", 0.0), ("60 s", 60.0), ("10 s", 10.0)] {
                ui.selectable_value(&mut self.window_s, window, name);
            }
            if let Some(error) = session.series.mean_error() {
                ui.label(format!("mean error {:.1} cm", 100.0 * error));
            }
            if let Some(recompute) = &session.recompute
                && let Some(error) = recompute.series.mean_error()
            {
                let text = format!("recomputed {:.1} cm", 100.0 * error);
                ui.colored_label(palette::PURPLE, text);
            }
        });
        let Some(span) = session.span() else {
            ui.weak("No run yet.");
            return;
        };
        let span = self.visible_range(span, session.playback.time);
        let shown: Vec<&PlotSpec> = PLOTS
            .iter()
            .filter(|spec| self.shown.iter().any(|name| name == spec.name))
            .collect();
        let rows = shown.len().max(1) as f32;
        let height = (ui.available_height() / rows - 24.0).max(PLOT_HEIGHT_MIN);
        let mut clicked = None;
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                for spec in shown {
                    clicked = draw_plot(ui, spec, session, span, height).or(clicked);
                }
            });
        if let Some(time) = clicked {
            session.seek(time);
        }
    }

    /// The visible time range, seconds.
    fn visible_range(&self, (start, end): (f64, f64), at: f64) -> (f64, f64) {
        if self.window_s <= 0.0 || end - start <= self.window_s {
            return (start, end.max(start + 0.1));
        }
        let from = (at - self.window_s / 2.0).clamp(start, end - self.window_s);
        (from, from + self.window_s)
    }
}

/// Draws a plot; returns the clicked time.
fn draw_plot(
    ui: &mut Ui,
    spec: &PlotSpec,
    session: &Session,
    (from, to): (f64, f64),
    height: f32,
) -> Option<f64> {
    let at = session.playback.time;
    let cursor = ui.visuals().strong_text_color();
    let recomputed = session
        .recompute
        .as_ref()
        .map(|recompute| &recompute.series);
    // More points than screen columns would overlap.
    let points_max = (ui.available_width() * ui.pixels_per_point()).max(PLOT_HEIGHT_MIN) as usize;
    ui.small(format!("{} ({})", spec.name, spec.unit));
    let plot = Plot::new(spec.name)
        .height(height)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .allow_double_click_reset(false)
        .default_x_bounds(from, to)
        .legend(Legend::default().position(Corner::LeftTop));
    let drawn = plot.show(ui, |plot| {
        plot.set_plot_bounds_x(from..=to);
        plot.set_auto_bounds([false, true]);
        for &(name, quantity, colour, scale) in spec.curves {
            let points = decimate_min_max(&session.series, (from, to), quantity, scale, points_max);
            if points.is_empty() {
                continue;
            }
            plot.line(
                Line::new(name, PlotPoints::Owned(points))
                    .color(colour)
                    .width(1.4),
            );
            if let Some(recomputed) = recomputed {
                let points = decimate_min_max(recomputed, (from, to), quantity, scale, points_max);
                let line = Line::new(format!("{name}, recomputed"), PlotPoints::Owned(points));
                plot.line(
                    line.color(colour)
                        .width(1.0)
                        .style(egui_plot::LineStyle::dashed_loose()),
                );
            }
        }
        plot.vline(
            VLine::new("", at)
                .color(cursor)
                .width(1.0)
                .allow_hover(false),
        );
        plot.pointer_coordinate().map(|point| point.x)
    });
    let pressed = drawn.response.clicked() || drawn.response.dragged();
    drawn
        .inner
        .filter(|_| pressed)
        .map(|time| time.clamp(from, to))
}

/// The curve's points, at most about `points_max`: minimum and maximum of equal chunks of samples.
fn decimate_min_max(
    series: &TimeSeries,
    (from, to): (f64, f64),
    quantity: Quantity,
    scale: f32,
    points_max: usize,
) -> Vec<PlotPoint> {
    let samples = series.between(from, to);
    let value = |sample: &CycleMetrics| sample.value(quantity) * scale;
    let finite = samples.iter().filter(|sample| value(sample).is_finite());
    if samples.len() <= points_max {
        return finite
            .map(|sample| PlotPoint::new(sample.time, value(sample)))
            .collect();
    }
    let share = samples.len().div_ceil(points_max / 2);
    let mut points = Vec::with_capacity(points_max);
    for chunk in samples.chunks(share) {
        let finite = chunk.iter().filter(|sample| value(sample).is_finite());
        let least = finite.clone().min_by(|a, b| value(a).total_cmp(&value(b)));
        let most = finite.max_by(|a, b| value(a).total_cmp(&value(b)));
        if let (Some(least), Some(most)) = (least, most) {
            let mut pair = [least, most];
            pair.sort_by(|a, b| a.time.total_cmp(&b.time));
            points.extend(pair.map(|sample| PlotPoint::new(sample.time, value(sample))));
        }
    }
    points
}

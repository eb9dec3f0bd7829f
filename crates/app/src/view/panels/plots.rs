//! How did it go over time? Curves of the whole run, tied to the timeline by one cursor.

use eframe::egui::{self, Color32, Ui};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoint, PlotPoints, VLine};
use serde::{Deserialize, Serialize};

use crate::view::palette;
use crate::view::session::Session;
use crate::view::time_series::{CycleMetrics, Quantity, TimeSeries};

/// Least height of one plot, points.
const PLOT_HEIGHT_MIN: f32 = 80.0;

/// One plot: its name, its unit and its curves.
struct PlotSpec {
    name: &'static str,
    unit: &'static str,
    curves: &'static [(&'static str, Quantity, Color32, f32)],
}

/// All that can be plotted; the last number brings SI into the unit.
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
            ("refused", Quantity::RejectedCandidates, palette::GREY, 1.0),
            ("inliers", Quantity::InlierShare, palette::GREEN, 100.0),
        ],
    },
    PlotSpec {
        name: "Entropy",
        unit: "bit",
        curves: &[("image", Quantity::Entropy, palette::SKY, 1.0)],
    },
    PlotSpec {
        name: "Exposure",
        unit: "of 255",
        curves: &[("brightness", Quantity::Brightness, palette::YELLOW, 1.0)],
    },
    PlotSpec {
        name: "Camera",
        unit: "its own",
        curves: &[
            ("exposure", Quantity::ExposureTime, palette::ORANGE, 1.0),
            ("gain", Quantity::Gain, palette::SKY, 1.0),
        ],
    },
    PlotSpec {
        name: "Stage times",
        unit: "ms",
        curves: &[
            ("see", Quantity::VisionTime, palette::ORANGE, 1.0),
            ("localize", Quantity::LocalizationTime, palette::SKY, 1.0),
            ("between frames", Quantity::CyclePeriod, palette::GREY, 1.0),
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
            ("turn", Quantity::YawRate, palette::PURPLE, 0.1),
        ],
    },
];

/// The panel's memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct PlotsPanel {
    /// Names of the plots that are shown.
    pub(crate) shown: Vec<String>,
    /// Seconds about the cursor; 0 is the whole run.
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
    /// Draws the panel; a click moves the timeline.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Curves", |ui| {
                for group in &PLOTS {
                    let mut shown = self.shown.iter().any(|name| name == group.name);
                    if ui.checkbox(&mut shown, group.name).changed() {
                        self.shown.retain(|name| name != group.name);
                        if shown {
                            self.shown.push(group.name.to_owned());
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
            .filter(|group| self.shown.iter().any(|name| name == group.name))
            .collect();
        let rows = shown.len().max(1) as f32;
        let height = (ui.available_height() / rows - 24.0).max(PLOT_HEIGHT_MIN);
        let mut clicked = None;
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                for group in shown {
                    clicked = draw_plot(ui, group, session, span, height).or(clicked);
                }
            });
        if let Some(time) = clicked {
            session.seek(time);
        }
    }

    /// The part of the run that is shown.
    fn visible_range(&self, (start, end): (f64, f64), at: f64) -> (f64, f64) {
        if self.window_s <= 0.0 || end - start <= self.window_s {
            return (start, end.max(start + 0.1));
        }
        let from = (at - self.window_s / 2.0).clamp(start, end - self.window_s);
        (from, from + self.window_s)
    }
}

/// One plot; the time that was clicked at.
fn draw_plot(
    ui: &mut Ui,
    group: &PlotSpec,
    session: &Session,
    (from, to): (f64, f64),
    height: f32,
) -> Option<f64> {
    let at = session.playback.time;
    let cursor = ui.visuals().strong_text_color();
    let again = session
        .recompute
        .as_ref()
        .map(|recompute| &recompute.series);
    // More of them than the screen has columns would be drawn over one another.
    let points_max = (ui.available_width() * ui.pixels_per_point()).max(PLOT_HEIGHT_MIN) as usize;
    ui.small(format!("{} ({})", group.name, group.unit));
    let plot = Plot::new(group.name)
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
        for &(name, quantity, colour, scale) in group.curves {
            let points = decimate_min_max(&session.series, (from, to), quantity, scale, points_max);
            if points.is_empty() {
                continue;
            }
            plot.line(
                Line::new(name, PlotPoints::Owned(points))
                    .color(colour)
                    .width(1.4),
            );
            if let Some(again) = again {
                let points = decimate_min_max(again, (from, to), quantity, scale, points_max);
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

/// The curve's points, at most so many: of more samples each share's least and most.
fn decimate_min_max(
    series: &TimeSeries,
    (from, to): (f64, f64),
    quantity: Quantity,
    scale: f32,
    points_max: usize,
) -> Vec<PlotPoint> {
    let samples = series.between(from, to);
    let value = |sample: &CycleMetrics| sample.value(quantity) * scale;
    let known = samples.iter().filter(|sample| value(sample).is_finite());
    if samples.len() <= points_max {
        return known
            .map(|sample| PlotPoint::new(sample.time, value(sample)))
            .collect();
    }
    let share = samples.len().div_ceil(points_max / 2);
    let mut points = Vec::with_capacity(points_max);
    for chunk in samples.chunks(share) {
        let known = chunk.iter().filter(|sample| value(sample).is_finite());
        let least = known.clone().min_by(|a, b| value(a).total_cmp(&value(b)));
        let most = known.max_by(|a, b| value(a).total_cmp(&value(b)));
        if let (Some(least), Some(most)) = (least, most) {
            let mut pair = [least, most];
            pair.sort_by(|a, b| a.time.total_cmp(&b.time));
            points.extend(pair.map(|sample| PlotPoint::new(sample.time, value(sample))));
        }
    }
    points
}

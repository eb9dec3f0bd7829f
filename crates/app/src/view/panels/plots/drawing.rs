//! How is one plot drawn, and what does the pointer ask for?

use eframe::egui::{self, Color32, Ui, Vec2};
use egui_plot::{
    AxisHints, Bar, BarChart, HLine, Line, LineStyle, Plot, PlotPoints, PlotUi, Points, Span, VLine,
};

use super::axes::{axis_value, below, marks_below, value_marks};
use super::config::{PlotConfig, PlotKind};
use super::drawn_line::DrawnLine;
use super::mode_bands::ModeBands;
use super::numbers::{self, short};
use super::plotted_curve::{PlottedCurve, scale};
use super::thinned::ThinnedPlot;
use crate::view::curves::Curve;
use crate::view::palette;
use crate::view::session::Session;

/// Least height of a plot, points.
pub(super) const PLOT_HEIGHT_MIN: f32 = 80.0;
/// Width of the value axis, points: equal in all plots, so that equal times lie above one another.
const VALUE_AXIS_WIDTH: f32 = 52.0;
/// Least distance of the value axis' marks, points: low plots need denser ones than the default.
const VALUE_MARK_SPACING: f32 = 17.0;
/// Distance at which labels of the value axis appear, and at which they are opaque, points.
const VALUE_LABEL_SPACING: std::ops::RangeInclusive<f32> = 8.0..=14.0;
/// Least height of a plot with a title beside its value axis, points.
const TITLED_HEIGHT_MIN: f32 = 130.0;
/// Scrolled points per zoom factor of e.
const SCROLL_POINTS_PER_E_FOLD: f32 = 300.0;
/// Width of a curve, points.
const CURVE_WIDTH: f32 = 1.4;
/// Shortest visible time, seconds.
const RANGE_MIN: f64 = 0.05;

/// What the user asks for with the pointer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Request {
    /// Show the cycle of a time.
    Seek(f64),
    /// Show a time range.
    Show((f64, f64)),
    /// Show the range that the panel's buttons select.
    ShowAll,
    /// Measure times from here.
    MeasureFrom(f64),
}

/// What all plots of the panel share.
pub(super) struct PlotArea {
    /// Visible time, seconds.
    pub(super) range: (f64, f64),
    /// Time of the whole run, seconds.
    pub(super) span: (f64, f64),
    pub(super) height: f32,
    pub(super) measured_from: Option<f64>,
    /// Where the robot was not tracking.
    pub(super) modes: ModeBands,
    pub(super) request: Option<Request>,
    /// Time under the pointer, seconds.
    pub(super) hovered: Option<f64>,
}

type Curves<'a> = &'a [PlottedCurve<'a>];

impl PlotArea {
    /// Draws a plot and takes its input.
    pub(super) fn draw(
        &mut self,
        ui: &mut Ui,
        (plot, thinned): (&PlotConfig, &mut ThinnedPlot),
        curves: Curves<'_>,
        session: &Session,
    ) {
        match plot.kind {
            PlotKind::Curve => self.draw_over_time(ui, (plot, thinned), curves, session),
            PlotKind::Against => self.draw_against(ui, curves, session),
            PlotKind::Histogram => self.draw_histogram(ui, curves),
            PlotKind::Spectrum => self.draw_spectrum(ui, plot.logarithmic, curves),
            PlotKind::Numbers => self.draw_numbers(ui, curves, session),
        }
    }

    /// Text of the measured time.
    pub(super) fn measurement(&self, hovered: Option<f64>) -> Option<String> {
        let (from, to) = self.measured_from.zip(hovered)?;
        Some(format!("{:+.3} s", to - from))
    }

    fn plot<'a>(&self, name: &str) -> Plot<'a> {
        self.plot_with_values(name, |value| axis_value(value, false))
    }

    /// A plot with its own texts of the value axis.
    fn plot_with_values<'a>(&self, name: &str, text: impl Fn(f64) -> String + 'a) -> Plot<'a> {
        let values = AxisHints::new_y()
            .min_thickness(VALUE_AXIS_WIDTH)
            .label_spacing(VALUE_LABEL_SPACING)
            .formatter(move |mark, _| text(mark.value));
        Plot::new(name.to_owned())
            .custom_y_axes(vec![values])
            .custom_x_axes(vec![below("")])
            .height(self.height)
            // Filling the background costs a software renderer more than the curves.
            .show_background(false)
            .allow_zoom(false)
            .allow_drag(false)
            .allow_scroll(false)
            .allow_boxed_zoom(false)
            .allow_double_click_reset(false)
            .y_grid_spacer(value_marks)
            .x_grid_spacer(marks_below)
            .grid_spacing(VALUE_MARK_SPACING..=160.0)
    }

    fn draw_over_time(
        &mut self,
        ui: &mut Ui,
        (config, thinned): (&PlotConfig, &mut ThinnedPlot),
        curves: Curves<'_>,
        session: &Session,
    ) {
        let (from, to) = self.range;
        let logarithmic = config.logarithmic;
        // More points than screen columns would overlap.
        let points_max =
            (ui.available_width() * ui.pixels_per_point()).max(PLOT_HEIGHT_MIN) as usize;
        thinned.update(
            config,
            curves,
            (self.range, session.damage.parts()),
            points_max,
        );
        let [low, high] = thinned.limits;
        let cursor = ui.visuals().strong_text_color();
        let drawn = self
            .plot_with_values("over time", move |value| axis_value(value, logarithmic))
            .show(ui, |plot| {
                plot.set_plot_bounds_x(from..=to);
                plot.set_plot_bounds_y(low..=high);
                draw_modes(plot, &self.modes);
                for threshold in &thinned.thresholds {
                    let line = HLine::new("threshold", *threshold).color(palette::VERMILION);
                    plot.hline(line.style(LineStyle::dashed_dense()).width(1.0));
                }
                for (one, (points, others)) in curves.iter().zip(&thinned.curves) {
                    let own = Line::new(one.name, PlotPoints::Borrowed(points));
                    let own = own.color(one.colour);
                    plot.add(DrawnLine::new(own, points, CURVE_WIDTH));
                    for ((run, _), points) in one.others.iter().zip(others) {
                        let name = format!("{}, {run}", one.name);
                        let line = Line::new(name, PlotPoints::Borrowed(points));
                        let line = line.color(one.colour).width(1.0);
                        plot.line(line.style(LineStyle::dashed_loose()));
                    }
                }
                draw_time(plot, session.playback.time, cursor);
                for time in [session.hovered_time, self.measured_from]
                    .into_iter()
                    .flatten()
                {
                    draw_time(plot, time, palette::YELLOW);
                }
                plot.pointer_coordinate().map(|point| point.x)
            });
        if thinned.is_clipped {
            ui.painter().text(
                drawn.response.rect.right_top() + Vec2::new(-4.0, 2.0),
                egui::Align2::RIGHT_TOP,
                "values outside",
                egui::FontId::proportional(11.0),
                palette::ORANGE,
            );
        }
        self.take_input(ui, &drawn.response, drawn.inner);
    }

    /// Click, drag, wheel and double click over a plot over time. `at`: time under the pointer.
    fn take_input(&mut self, ui: &Ui, response: &egui::Response, at: Option<f64>) {
        let (from, to) = self.range;
        if response.hovered() {
            self.hovered = at.or(self.hovered);
        }
        let Some(time) = at else {
            return;
        };
        let (shifted, commanded) =
            ui.input(|input| (input.modifiers.shift, input.modifiers.command));
        if response.double_clicked() {
            self.request = Some(Request::ShowAll);
        } else if response.drag_started() && shifted {
            self.request = Some(Request::MeasureFrom(time));
        } else if response.dragged() && !shifted {
            let seconds_per_point = (to - from) / f64::from(response.rect.width().max(1.0));
            let moved = f64::from(response.drag_delta().x) * seconds_per_point;
            if moved != 0.0 {
                self.request = Some(Request::Show((from - moved, to - moved)));
            }
        } else if response.clicked() || response.hovered() && commanded {
            self.request = Some(Request::Seek(time));
        }
        let scrolled = ui.input(|input| input.smooth_scroll_delta().y);
        if response.hovered() && scrolled != 0.0 {
            let factor = f64::from((-scrolled / SCROLL_POINTS_PER_E_FOLD).exp());
            let longest = 2.0 * (self.span.1 - self.span.0).max(RANGE_MIN);
            let factor = factor.clamp(RANGE_MIN / (to - from), (longest / (to - from)).max(1.0));
            self.request = Some(Request::Show((
                time + (from - time) * factor,
                time + (to - time) * factor,
            )));
        }
    }

    fn draw_against(&self, ui: &mut Ui, curves: Curves<'_>, session: &Session) {
        let [across, up, ..] = curves else {
            ui.weak("Add a second curve: it is drawn over the first one.");
            return;
        };
        let (from, to) = self.range;
        // Where the two have samples at different times, the first one's last value counts.
        let points: Vec<[f64; 2]> = up
            .curve
            .finite(from, to)
            .map(|[time, value]| [across.curve.at(time), value])
            .filter(|point| point[0].is_finite())
            .collect();
        let time = session.playback.time;
        let now = [across.curve.at(time), up.curve.at(time)];
        self.plot("against")
            .custom_x_axes(vec![below(&axis_title(across))])
            .y_axis_label(axis_title(up))
            .height(self.height.max(TITLED_HEIGHT_MIN))
            .show(ui, |plot| {
                let dots = Points::new(up.name, PlotPoints::from(points)).radius(1.2);
                plot.points(dots.color(up.colour));
                if now.iter().all(|value| value.is_finite()) {
                    plot.points(
                        Points::new("shown", PlotPoints::from(vec![now]))
                            .radius(4.0)
                            .color(palette::VERMILION),
                    );
                }
            });
    }

    fn draw_histogram(&self, ui: &mut Ui, curves: Curves<'_>) {
        let (from, to) = self.range;
        let charts = curves.iter().map(|one| {
            let values: Vec<f64> = one.curve.finite(from, to).map(|point| point[1]).collect();
            let (width, bins) = numbers::histogram(&values);
            let bars = bins
                .iter()
                .map(|[at, count]| Bar::new(*at, *count).width(width));
            BarChart::new(one.name, bars.collect()).color(one.colour.gamma_multiply(0.7))
        });
        let charts: Vec<BarChart> = charts.collect();
        let title = curves.first().map_or("", |one| one.unit);
        self.plot("histogram")
            .custom_x_axes(vec![below(title)])
            .y_axis_label("samples")
            .height(self.height.max(TITLED_HEIGHT_MIN))
            .show(ui, |plot| {
                for chart in charts {
                    plot.bar_chart(chart);
                }
            });
    }

    fn draw_spectrum(&self, ui: &mut Ui, logarithmic: bool, curves: Curves<'_>) {
        let (from, to) = self.range;
        let all = |curve: Curve<'_>| {
            let points: Vec<[f64; 2]> = curve.finite(from, to).collect();
            let mut spectrum = numbers::spectrum(&points);
            for point in &mut spectrum {
                point[1] = scale(point[1], logarithmic);
            }
            spectrum
        };
        let lines: Vec<_> = curves
            .iter()
            .map(|one| line(one.name, &all(one.curve), one.colour, 1.4))
            .collect();
        self.plot_with_values("spectrum", move |value| axis_value(value, logarithmic))
            .custom_x_axes(vec![below("Hz")])
            .show(ui, |plot| {
                for line in lines {
                    plot.line(line);
                }
            });
    }

    fn draw_numbers(&self, ui: &mut Ui, curves: Curves<'_>, session: &Session) {
        let (from, to) = self.range;
        egui::Grid::new("numbers").striped(true).show(ui, |ui| {
            for title in [
                "Curve", "Shown", "Mean", "Median", "99 %", "Least", "Most", "Samples",
            ] {
                ui.strong(title);
            }
            ui.end_row();
            for one in curves {
                let mut values: Vec<f64> =
                    one.curve.finite(from, to).map(|point| point[1]).collect();
                values.sort_by(f64::total_cmp);
                let count = values.len();
                let rank = |part: f64| {
                    let place = (part * count as f64).ceil() as usize;
                    values
                        .get(place.saturating_sub(1))
                        .copied()
                        .unwrap_or(f64::NAN)
                };
                let mean = values.iter().sum::<f64>() / count as f64;
                let shown = one.curve.at(session.playback.time);
                ui.colored_label(one.colour, axis_title(one));
                if let Some(text) = one.curve.text(shown) {
                    ui.monospace(text);
                } else {
                    for value in [shown, mean, rank(0.5), rank(0.99), rank(0.0), rank(1.0)] {
                        ui.monospace(short(value));
                    }
                    ui.monospace(count.to_string());
                }
                ui.end_row();
            }
        });
    }
}

fn axis_title(curve: &PlottedCurve<'_>) -> String {
    match curve.unit {
        "" => curve.name.to_owned(),
        unit => format!("{} ({unit})", curve.name),
    }
}

fn line<'a>(name: &str, points: &[[f64; 2]], colour: Color32, width: f32) -> Line<'a> {
    Line::new(name, PlotPoints::from(points.to_vec()))
        .color(colour)
        .width(width)
}

fn draw_time(plot: &mut PlotUi<'_>, time: f64, colour: Color32) {
    plot.vline(
        VLine::new("", time)
            .color(colour)
            .width(1.0)
            .allow_hover(false),
    );
}

/// Bands behind the curves where the robot was not tracking.
fn draw_modes(plot: &mut PlotUi<'_>, bands: &ModeBands) {
    for (from, to, mode) in bands.all() {
        let fill = palette::mode_colour(*mode).gamma_multiply(0.25);
        plot.span(Span::new("", *from..=*to).fill(fill));
    }
}

//! Timeline panel: playback, marks, and the modes and errors of the whole run.

use eframe::egui::{self, Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, Ui, Vec2};
use localize::estimate::Mode;

use pipeline::findings::Finding;

use crate::view::accessibility::AccessibleLabel;
use crate::view::palette;
use crate::view::panels::findings::colour;
use crate::view::session::Session;
use crate::view::source::Source;
use crate::view::time_series::TimeSeries;

/// Height of the timeline bar, points.
const BAR_HEIGHT: f32 = 34.0;
/// Height and least width of a finding's stripe, points.
const FINDING_HEIGHT: f32 = 5.0;
const FINDING_WIDTH_MIN: f32 = 3.0;
/// Findings this close to the pointer are named, points …
const HOVER_DISTANCE: f64 = 4.0;
/// … and at most this many.
const HOVER_FINDINGS: usize = 6;
/// Selectable playback speeds.
const SPEEDS: [f64; 8] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 50.0];

/// State of the panel.
#[derive(Default)]
pub(crate) struct TimelinePanel {
    /// Text of the next mark.
    mark_text: String,
}

impl TimelinePanel {
    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.buttons(ui, session);
        bar(ui, session);
        if let Some(error) = &session.last_error {
            ui.colored_label(palette::VERMILION, error);
        }
        show_recompute_summary(ui, session);
        show_other_runs(ui, session);
        egui::ScrollArea::vertical()
            .auto_shrink(false)
            .show(ui, |ui| {
                for line in &session.warnings {
                    ui.colored_label(palette::ORANGE, line);
                }
                marks(ui, session);
            });
    }

    fn buttons(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            let live = matches!(session.source, Source::Live(_));
            let playing = session.playback.playing;
            if ui
                .button("|<")
                .on_hover_text("Go to the start (Home)")
                .clicked()
                && let Some((start, _)) = session.source.span()
            {
                session.seek(start);
            }
            if ui
                .button("<")
                .on_hover_text("Previous cycle (Left)")
                .clicked()
            {
                session.step(-1);
            }
            let name = if playing { "Pause" } else { "Play" };
            if ui.button(name).on_hover_text("Space").clicked() {
                session.toggle_playback();
            }
            if ui.button(">").on_hover_text("Next cycle (Right)").clicked() {
                session.step(1);
            }
            let to_end = if live { "Now" } else { ">|" };
            if ui
                .button(to_end)
                .on_hover_text("Go to the end (End)")
                .clicked()
            {
                if live {
                    session.playback.playing = true;
                } else if let Some((_, end)) = session.source.span() {
                    session.seek(end);
                }
            }
            speed(ui, session);
            if let (Some((start, end)), at) = (session.span(), session.playback.time) {
                ui.monospace(format!("{at:.3} s  ({start:.1} to {end:.1} s)"));
            }
            ui.add(
                egui::TextEdit::singleline(&mut self.mark_text)
                    .hint_text("mark")
                    .desired_width(90.0),
            )
            .with_accessible_label("text of the mark");
            if ui.button("Mark").on_hover_text("M").clicked() {
                session.add_mark(&std::mem::take(&mut self.mark_text));
            }
        });
    }
}

fn speed(ui: &mut Ui, session: &mut Session) {
    let before = session.playback.speed;
    let owned = session.source.simulation().is_some();
    let external = matches!(session.source, Source::Live(_)) && !owned;
    // The view cannot change the speed of a run that it does not own.
    ui.add_enabled_ui(!external, |ui| {
        egui::ComboBox::from_id_salt("speed")
            .width(60.0)
            .selected_text(format!("{before} x"))
            .show_ui(ui, |ui| {
                for speed in SPEEDS {
                    let text = format!("{speed} x");
                    ui.selectable_value(&mut session.playback.speed, speed, text);
                }
            })
            .response
            .with_accessible_label("speed");
    });
    if session.playback.speed != before {
        session.set_speed(session.playback.speed);
    }
}

/// Draws the timeline bar: modes, errors, marks and the shown time.
fn bar(ui: &mut Ui, session: &mut Session) {
    let size = Vec2::new(ui.available_width().max(1.0), BAR_HEIGHT);
    let (response, painter) = ui.allocate_painter(size, Sense::click_and_drag());
    let rect = response.rect;
    painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
    let Some((start, end)) = session.span() else {
        return;
    };
    let length = (end - start).max(1e-3);
    let place = |time: f64| rect.left() + ((time - start) / length) as f32 * rect.width();
    modes(&painter, rect, &session.series, &place);
    findings(&painter, rect, session.findings.all(), &place);
    for mark in &session.marks {
        let at = place(mark.time);
        painter.vline(at, rect.y_range(), Stroke::new(2.0, palette::YELLOW));
        painter.text(
            Pos2::new(at + 3.0, rect.top()),
            Align2::LEFT_TOP,
            &mark.text,
            FontId::proportional(11.0),
            palette::YELLOW,
        );
    }
    if let Some(time) = session.hovered_time {
        painter.vline(
            place(time),
            rect.y_range(),
            Stroke::new(1.0, palette::YELLOW),
        );
    }
    let at = place(session.playback.time);
    let cursor = ui.visuals().strong_text_color();
    painter.vline(at, rect.y_range(), Stroke::new(2.0, cursor));
    if let Some(pointer) = response.interact_pointer_pos() {
        let part = f64::from((pointer.x - rect.left()) / rect.width()).clamp(0.0, 1.0);
        session.seek(start + part * length);
    } else if let Some(pointer) = response.hover_pos() {
        let part = f64::from((pointer.x - rect.left()) / rect.width());
        let (time, tolerance) = (
            start + part * length,
            length * HOVER_DISTANCE / f64::from(rect.width()),
        );
        let near = session.findings.all().iter().filter(|finding| {
            (finding.start - tolerance..=finding.stop + tolerance).contains(&time)
        });
        let lines = near.take(HOVER_FINDINGS).map(Finding::sentence);
        let text: Vec<String> = std::iter::once(format!("{time:.2} s"))
            .chain(lines)
            .collect();
        response.on_hover_text(text.join("\n"));
    }
}

/// Draws each finding as a stripe at the top, from its start to its stop.
fn findings(painter: &egui::Painter, rect: Rect, found: &[Finding], place: &impl Fn(f64) -> f32) {
    for finding in found {
        let (left, right) = (place(finding.start), place(finding.stop));
        let stripe = Rect::from_x_y_ranges(
            left..=right.max(left + FINDING_WIDTH_MIN),
            rect.top()..=rect.top() + FINDING_HEIGHT,
        );
        painter.rect_filled(stripe, 0.0, colour(finding.kind.severity()));
    }
}

/// Draws the mode in the lower third, and the position error above it (full height: 0.5 m).
fn modes(painter: &egui::Painter, rect: Rect, series: &TimeSeries, place: &impl Fn(f64) -> f32) {
    let samples = series.samples();
    let columns = rect.width().max(1.0) as usize;
    let share = samples.len().div_ceil(columns).max(1);
    let split = rect.bottom() - rect.height() / 3.0;
    let chunks = samples.chunks(share);
    // Neighbours of one mode are one rectangle: it has no seams, and is drawn at once.
    let mut band: Option<(Rect, Color32)> = None;
    for (chunk, next) in chunks.clone().zip(chunks.skip(1).map(Some).chain([None])) {
        let (Some(first), Some(last)) = (chunk.first(), chunk.last()) else {
            continue;
        };
        let worst = chunk.iter().map(|sample| sample.mode);
        let worst = worst.max_by_key(|mode| match mode {
            Mode::Tracking => 0,
            Mode::Global => 1,
            Mode::Lost => 2,
        });
        let until = next.and_then(|next| next.first()).unwrap_or(last).time;
        let (left, right) = (place(first.time), place(until).max(place(first.time) + 1.0));
        let colour = palette::mode_colour(worst.unwrap_or(Mode::Lost));
        match &mut band {
            Some((rect, of)) if *of == colour => rect.max.x = right,
            _ => {
                let low = Rect::from_x_y_ranges(left..=right, split..=rect.bottom());
                if let Some((low, colour)) = band.replace((low, colour)) {
                    painter.rect_filled(low, 0.0, colour);
                }
            }
        }
        let error = chunk
            .iter()
            .map(|s| s.value(crate::view::time_series::Quantity::PositionError))
            .filter(|error| error.is_finite())
            .fold(0.0, f32::max);
        if error > 0.0 {
            let height = (error / 0.5).min(1.0) * (split - rect.top());
            let high = Rect::from_x_y_ranges(left..=right, split - height..=split);
            painter.rect_filled(high, 0.0, palette::VERMILION.gamma_multiply(0.8));
        }
    }
    if let Some((low, colour)) = band {
        painter.rect_filled(low, 0.0, colour);
    }
}

/// Shows how the recomputed run compares with the recorded one.
fn show_recompute_summary(ui: &mut Ui, session: &mut Session) {
    let Some(recompute) = &session.recompute else {
        return;
    };
    let mut discard = false;
    ui.horizontal_wrapped(|ui| {
        let cm = |error: Option<f32>| {
            error.map_or("unknown".to_owned(), |e| format!("{:.2} cm", 100.0 * e))
        };
        let state = if recompute.done { "" } else { "recomputing: " };
        ui.colored_label(
            palette::PURPLE,
            format!(
                "{state}{} cycles, {} poses differ; mean error recorded {}, recomputed {}{}",
                recompute.cycles,
                recompute.changed_poses,
                cm(session.series.mean_error()),
                cm(recompute.series.mean_error()),
                if recompute.vision_recomputed {
                    ""
                } else {
                    " (from the recorded line points: the log has no lossless images)"
                }
            ),
        );
        if let Some(error) = &recompute.error {
            ui.colored_label(palette::VERMILION, error);
        }
        discard = ui.button("Discard").clicked();
    });
    if discard {
        session.recompute = None;
    }
}

/// Lists the other runs with their place on the timeline.
fn show_other_runs(ui: &mut Ui, session: &mut Session) {
    let mut remove = None;
    for (number, other) in session.others.iter_mut().enumerate() {
        ui.horizontal_wrapped(|ui| {
            ui.colored_label(palette::run_colour(number), &other.name);
            if let Some((start, end)) = other.span() {
                ui.monospace(format!("{start:.1} to {end:.1} s"));
            }
            let mut offset = other.offset();
            let drag = egui::DragValue::new(&mut offset)
                .speed(0.01)
                .max_decimals(3)
                .prefix("moved by ")
                .suffix(" s");
            if ui.add(drag).changed() {
                other.set_offset(offset);
            }
            if let Some(error) = other.series.mean_error() {
                ui.label(format!("mean error {:.1} cm", 100.0 * error));
            }
            if ui.small_button("Close").clicked() {
                remove = Some(number);
            }
        });
    }
    if let Some(number) = remove {
        session.others.remove(number);
    }
}

fn marks(ui: &mut Ui, session: &mut Session) {
    let (mut seek_to, mut remove) = (None, None);
    for (number, mark) in session.marks.iter().enumerate() {
        ui.horizontal(|ui| {
            if ui.link(format!("{:.3} s", mark.time)).clicked() {
                seek_to = Some(mark.time);
            }
            ui.label(&mark.text);
            if ui.small_button("Remove").clicked() {
                remove = Some(number);
            }
        });
    }
    if let Some(time) = seek_to {
        session.seek(time);
    }
    if let Some(number) = remove {
        session.marks.remove(number);
    }
    if session.marks.is_empty() {
        ui.colored_label(Color32::GRAY, "No marks.");
    }
}

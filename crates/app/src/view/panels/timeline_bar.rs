//! The bar of the timeline: modes, errors, findings, marks, and the shown time. Wheel and keys zoom it.

use std::ops::RangeInclusive;

use eframe::egui::{Align2, FontId, Pos2, Rect, Response, Sense, Stroke, Ui, Vec2};
use localize::estimate::Mode;
use pipeline::findings::Finding;

use super::findings::colour;
use crate::view::palette;
use crate::view::panel_command::PanelCommand;
use crate::view::pen::Pen;
use crate::view::session::Session;
use crate::view::time_series::{Quantity, TimeSeries};

/// Height of the bar, points.
const BAR_HEIGHT: f32 = 34.0;
/// Height and least width of a finding's stripe, points.
const FINDING_HEIGHT: f32 = 5.0;
const FINDING_WIDTH_MIN: f32 = 3.0;
/// Height of the line that shows which part of the run is visible, points.
const PART_HEIGHT: f32 = 3.0;
/// Findings this close to the pointer are named, points …
const HOVER_DISTANCE: f64 = 4.0;
/// … and at most this many.
const HOVER_FINDINGS: usize = 6;
/// Scrolled points per zoom factor of e.
const SCROLL_POINTS_PER_E_FOLD: f32 = 300.0;
/// Shortest visible time, seconds.
const RANGE_MIN: f64 = 0.2;
/// Share of the visible time that a key moves by.
const PAN_SHARE: f64 = 0.1;
/// Position error of the full height, metres.
const ERROR_MAX: f32 = 0.5;

/// State of the bar.
#[derive(Default)]
pub(super) struct TimelineBar {
    /// Visible time, seconds; None shows the whole run.
    pub(super) range: Option<(f64, f64)>,
    columns: Columns,
}

/// Modes and errors over the visible time, by column of the screen: computed again only when something has changed.
#[derive(Default)]
struct Columns {
    key: Option<Key>,
    /// Intervals of one mode.
    modes: Vec<(f64, f64, Mode)>,
    /// Intervals with their largest error, metres.
    errors: Vec<(f64, f64, f32)>,
}

#[derive(PartialEq)]
struct Key {
    range: (f64, f64),
    columns: usize,
    /// Number of samples, their thinning, and the last one's time.
    samples: (usize, usize, f64),
}

impl TimelineBar {
    /// Draws the bar; pressing it seeks.
    pub(super) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        let size = Vec2::new(ui.available_width().max(1.0), BAR_HEIGHT);
        let (response, painter) = ui.allocate_painter(size, Sense::click_and_drag());
        let rect = response.rect;
        let pen = Pen::new(painter.with_clip_rect(rect.intersect(painter.clip_rect())));
        pen.rect(rect, ui.visuals().extreme_bg_color);
        let Some(span) = session.span() else {
            return;
        };
        self.follow(span, session);
        self.take_wheel(ui, &response, span);
        let (start, end) = self.visible(span);
        let length = end - start;
        let place = |time: f64| rect.left() + ((time - start) / length) as f32 * rect.width();
        let columns = rect.width().max(1.0) as usize;
        self.columns.update(&session.series, (start, end), columns);
        if session.holds_poses {
            self.columns.draw(&pen, rect, &place);
        }
        for (from, to) in session.damage.parts() {
            let gap = Rect::from_x_y_ranges(place(*from)..=place(*to), rect.y_range());
            pen.rect(gap, ui.visuals().extreme_bg_color);
        }
        draw_findings(&pen, rect, session.findings.all(), &place);
        if let Some(time) = session.hovered_time {
            draw_line(&pen, place(time), rect, (1.0, palette::YELLOW));
        }
        for mark in &session.marks {
            let at = place(mark.time);
            draw_line(&pen, at, rect, (2.0, palette::YELLOW));
            let font = FontId::proportional(11.0);
            let corner = Pos2::new(at + 3.0, rect.top());
            pen.text(corner, Align2::LEFT_TOP, &mark.text, font, palette::YELLOW);
        }
        let cursor = ui.visuals().strong_text_color();
        draw_line(&pen, place(session.playback.time), rect, (2.0, cursor));
        if self.range.is_some() {
            let share = |time: f64| ((time - span.0) / (span.1 - span.0)) as f32;
            let across =
                rect.left() + share(start) * rect.width()..=rect.left() + share(end) * rect.width();
            let part = Rect::from_x_y_ranges(across, bottom(rect));
            pen.rect(part, cursor);
        }
        drop(pen);
        if response.double_clicked() {
            self.range = None;
        } else if let Some(pointer) = response.interact_pointer_pos() {
            let share = f64::from((pointer.x - rect.left()) / rect.width());
            session.seek(start + share.clamp(0.0, 1.0) * length);
        } else if let Some(pointer) = response.hover_pos() {
            let share = f64::from((pointer.x - rect.left()) / rect.width());
            let tolerance = length * HOVER_DISTANCE / f64::from(rect.width());
            response.on_hover_text(hover_text(session, start + share * length, tolerance));
        }
    }

    /// The visible time, seconds.
    fn visible(&self, (start, end): (f64, f64)) -> (f64, f64) {
        let (from, to) = self.range.unwrap_or((start, end));
        (from, to.max(from + 1e-3))
    }

    /// Keeps the shown time in sight while the run plays.
    fn follow(&mut self, span: (f64, f64), session: &Session) {
        let now = session.playback.time;
        if let Some((from, to)) = self.range.filter(|_| session.playback.playing)
            && !(from..=to).contains(&now)
        {
            self.set_range(now - 0.1 * (to - from), to - from, span);
        }
    }

    fn take_wheel(&mut self, ui: &Ui, response: &Response, span: (f64, f64)) {
        let Some(pointer) = response.hover_pos() else {
            return;
        };
        let scrolled = ui.input(|input| input.smooth_scroll_delta());
        if scrolled == Vec2::ZERO {
            return;
        }
        let (from, to) = self.visible(span);
        let per_point = (to - from) / f64::from(response.rect.width().max(1.0));
        let at = from + f64::from(pointer.x - response.rect.left()) * per_point;
        let factor = f64::from((-scrolled.y / SCROLL_POINTS_PER_E_FOLD).exp());
        let moved = f64::from(scrolled.x) * per_point;
        self.set_range(
            at + (from - at) * factor - moved,
            factor * (to - from),
            span,
        );
    }

    /// Does what keys ask for.
    pub(super) fn apply(&mut self, command: PanelCommand, session: &Session) {
        let Some(span) = session.span() else {
            return;
        };
        let (from, to) = self.visible(span);
        match command {
            PanelCommand::Pan([steps, _]) => {
                let moved = PAN_SHARE * f64::from(steps) * (to - from);
                self.set_range(from + moved, to - from, span);
            }
            PanelCommand::Zoom(factor) => {
                let now = session.playback.time.clamp(from, to);
                let factor = 1.0 / f64::from(factor);
                self.set_range(now + (from - now) * factor, factor * (to - from), span);
            }
            PanelCommand::ShowAll => self.range = None,
        }
    }

    /// Shows a part of the run.
    fn set_range(&mut self, from: f64, length: f64, (start, end): (f64, f64)) {
        let length = length.max(RANGE_MIN);
        let from = from.min(end - length).max(start);
        self.range = (length < end - start).then_some((from, from + length));
    }
}

impl Columns {
    fn update(&mut self, series: &TimeSeries, range: (f64, f64), columns: usize) {
        let samples = series.between(range.0, range.1);
        let end = samples.last().map_or(0.0, |sample| sample.time);
        let key = Key {
            range,
            columns,
            samples: (series.samples().len(), series.stride(), end),
        };
        if self.key.as_ref() == Some(&key) {
            return;
        }
        self.key = Some(key);
        self.modes.clear();
        self.errors.clear();
        let share = samples.len().div_ceil(columns).max(1);
        let chunks = samples.chunks(share);
        for (chunk, next) in chunks.clone().zip(chunks.skip(1).map(Some).chain([None])) {
            let (Some(first), Some(last)) = (chunk.first(), chunk.last()) else {
                continue;
            };
            let until = next.and_then(|next| next.first()).unwrap_or(last).time;
            let worst = chunk.iter().map(|sample| sample.mode);
            let worst = worst.max_by_key(|mode| match mode {
                Mode::Tracking => 0,
                Mode::Global => 1,
                Mode::Lost => 2,
            });
            let worst = worst.unwrap_or(Mode::Lost);
            // Neighbours of one mode are one rectangle.
            match self.modes.last_mut() {
                Some((_, end, mode)) if *mode == worst => *end = until,
                _ => self.modes.push((first.time, until, worst)),
            }
            let errors = chunk.iter().map(|s| s.value(Quantity::PositionError));
            let error = errors.filter(|error| error.is_finite()).fold(0.0, f32::max);
            if error > 0.0 {
                self.errors.push((first.time, until, error));
            }
        }
    }

    /// Draws the modes in the lower third, and the position errors above them.
    fn draw(&self, pen: &Pen, rect: Rect, place: &impl Fn(f64) -> f32) {
        let split = rect.bottom() - rect.height() / 3.0;
        let across = |from: f64, to: f64| place(from)..=place(to).max(place(from) + 1.0);
        for (from, to, mode) in &self.modes {
            let area = Rect::from_x_y_ranges(across(*from, *to), split..=rect.bottom());
            pen.rect(area, palette::mode_colour(*mode));
        }
        let colour = palette::VERMILION.gamma_multiply(0.8);
        for (from, to, error) in &self.errors {
            let height = (error / ERROR_MAX).min(1.0) * (split - rect.top());
            let area = Rect::from_x_y_ranges(across(*from, *to), split - height..=split);
            pen.rect(area, colour);
        }
    }
}

/// Height of the line that shows the visible part.
fn bottom(rect: Rect) -> RangeInclusive<f32> {
    rect.bottom() - PART_HEIGHT..=rect.bottom()
}

/// The time under the pointer, and the findings there.
fn hover_text(session: &Session, time: f64, tolerance: f64) -> String {
    let near =
        session.findings.all().iter().filter(|finding| {
            (finding.start - tolerance..=finding.stop + tolerance).contains(&time)
        });
    let lines = near.take(HOVER_FINDINGS).map(Finding::sentence);
    let damaged = session.damage.covers(time);
    let damaged = damaged.then(|| "cannot be read: the log is damaged here".to_owned());
    let text: Vec<String> = std::iter::once(format!("{time:.2} s"))
        .chain(damaged)
        .chain(lines)
        .collect();
    text.join("\n")
}

/// Draws a line across the bar.
fn draw_line(pen: &Pen, x: f32, rect: Rect, stroke: impl Into<Stroke>) {
    let ends = [Pos2::new(x, rect.top()), Pos2::new(x, rect.bottom())];
    pen.segment(ends, stroke);
}

/// Draws each finding as a stripe at the top, from its start to its stop.
fn draw_findings(pen: &Pen, rect: Rect, found: &[Finding], place: &impl Fn(f64) -> f32) {
    for finding in found {
        let (left, right) = (place(finding.start), place(finding.stop));
        let stripe = Rect::from_x_y_ranges(
            left..=right.max(left + FINDING_WIDTH_MIN),
            rect.top()..=rect.top() + FINDING_HEIGHT,
        );
        pen.rect(stripe, colour(finding.kind.severity()));
    }
}

//! Findings panel: the odd moments of the run with their likely causes. A click shows the moment.

use eframe::egui::{self, Button, RichText, Ui};
use pipeline::findings::{Finding, Severity};

use crate::view::palette;
use crate::view::session::Session;
use crate::view::source::Source;

/// The severities in the order of the panel, with their names.
const SEVERITIES: [(Severity, &str); 3] = [
    (Severity::Bad, "bad"),
    (Severity::Warning, "warnings"),
    (Severity::Note, "notes"),
];
/// A finding is the shown one if its worst image is at most this far away, seconds.
const SHOWN_TOLERANCE: f64 = 2e-6;

/// State of the panel.
#[derive(Default)]
pub(crate) struct FindingsPanel {
    /// Severities that are hidden, in the order of [`SEVERITIES`].
    hidden: [bool; 3],
}

impl FindingsPanel {
    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.buttons(ui, session);
        let reading = matches!(session.source, Source::Log(_)) && !session.findings.complete;
        if reading {
            ui.weak("The log is still being read.");
        }
        let all = session.findings.all();
        if all.is_empty() {
            if !reading {
                ui.weak("No findings.");
            }
            return;
        }
        let shown_time = session.shown_time();
        let is_shown = |finding: &Finding| {
            shown_time.is_some_and(|time| (time - finding.worst).abs() < SHOWN_TOLERANCE)
        };
        let details: Vec<&Finding> = all.iter().filter(|finding| is_shown(finding)).collect();
        for finding in details {
            ui.colored_label(colour(finding.kind.severity()), finding.sentence());
        }
        let visible: Vec<&Finding> = all
            .iter()
            .filter(|finding| self.is_visible(finding.kind.severity()))
            .collect();
        let mut seek_to = None;
        let height = ui.spacing().interact_size.y;
        egui::ScrollArea::vertical().auto_shrink(false).show_rows(
            ui,
            height,
            visible.len(),
            |ui, rows| {
                for finding in &visible[rows] {
                    let text = RichText::new(row_text(finding))
                        .monospace()
                        .color(colour(finding.kind.severity()));
                    let row = Button::selectable(is_shown(finding), text).truncate();
                    let sentence = finding.sentence();
                    if ui.add(row).on_hover_text(sentence).clicked() {
                        seek_to = Some(finding.worst);
                    }
                }
            },
        );
        if let Some(time) = seek_to {
            session.seek_stamp(time);
        }
    }

    fn buttons(&mut self, ui: &mut Ui, session: &mut Session) {
        ui.horizontal_wrapped(|ui| {
            for (name, keys, ahead) in [
                ("Previous moment", "Shift+N", false),
                ("Next moment", "N", true),
            ] {
                if ui.button(name).on_hover_text(keys).clicked() {
                    session.next_finding(ahead);
                }
            }
            for ((severity, name), hidden) in SEVERITIES.iter().zip(&mut self.hidden) {
                let all = session.findings.all().iter();
                let count = all.filter(|finding| finding.kind.severity() == *severity);
                let count = count.count();
                let name = if count == 1 {
                    name.trim_end_matches('s')
                } else {
                    name
                };
                let text = RichText::new(format!("{count} {name}"));
                let button = Button::selectable(!*hidden, text.color(colour(*severity)));
                if ui.add(button).on_hover_text("Show or hide these").clicked() {
                    *hidden = !*hidden;
                }
            }
        });
    }

    fn is_visible(&self, severity: Severity) -> bool {
        let mut rows = SEVERITIES.iter().zip(self.hidden);
        rows.any(|((of_row, _), hidden)| *of_row == severity && !hidden)
    }
}

/// A finding's line in the list.
fn row_text(finding: &Finding) -> String {
    format!("{:9.2} s  {}", finding.worst, finding.sentence())
}

/// Colour of a severity.
pub(crate) fn colour(severity: Severity) -> egui::Color32 {
    match severity {
        Severity::Bad => palette::VERMILION,
        Severity::Warning => palette::ORANGE,
        Severity::Note => palette::SKY,
    }
}

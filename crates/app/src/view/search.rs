//! Finds by typing: marks, odd moments, lines of the log, parameters, panels and everything that has a key.

use eframe::egui::{self, Key, Modifiers, RichText, Ui};

use super::accessibility::AccessibleLabel;
use super::panels::{PANES, Pane};
use super::session::Session;
use super::shortcut_table::{Action, SHORTCUTS};

/// Results that are listed.
const LISTED_MAX: usize = 200;
/// Field of the log that holds its lines.
const LOG_LINES: &str = "/log.message";
/// Width of the box, points.
const WIDTH: f32 = 620.0;

/// Where a result leads.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Target {
    /// A moment of the run, seconds.
    Moment(f64),
    /// A parameter, by its name.
    Setting(String),
    /// A panel.
    Panel(Pane),
    /// What a key does.
    Action(Action),
}

/// A line of the list.
#[derive(Debug, Clone, PartialEq)]
struct Found {
    kind: &'static str,
    text: String,
    target: Target,
}

/// The open search.
#[derive(Default)]
pub(crate) struct SearchBox {
    is_open: bool,
    text: String,
    selected: usize,
    found: Vec<Found>,
    /// More are found than listed.
    is_cut: bool,
    /// What `found` was found in.
    key: Option<SearchKey>,
}

/// What the results depend on: the text, and the numbers of marks, findings and lines of the log.
type SearchKey = (String, usize, usize, usize);

impl SearchBox {
    /// Opens the box with what was typed last.
    pub(crate) fn open(&mut self) {
        self.is_open = true;
        self.selected = 0;
        self.key = None;
    }

    fn update(&mut self, session: &mut Session) {
        session.curves.request(LOG_LINES);
        let lines = session.curve(LOG_LINES).map_or(0, |curve| curve.len());
        let counts = (session.marks.len(), session.findings.all().len(), lines);
        let key = (self.text.clone(), counts.0, counts.1, counts.2);
        if self.key.as_ref() == Some(&key) {
            return;
        }
        if self
            .key
            .as_ref()
            .is_none_or(|(text, ..)| *text != self.text)
        {
            self.selected = 0;
        }
        self.key = Some(key);
        let mut found: Vec<Found> = matching(&self.text, session).take(LISTED_MAX + 1).collect();
        self.is_cut = found.len() > LISTED_MAX;
        found.truncate(LISTED_MAX);
        self.found = found;
    }

    /// Draws the box if it is open; returns where the chosen result leads.
    pub(crate) fn show(&mut self, ctx: &egui::Context, session: &mut Session) -> Option<Target> {
        if !self.is_open {
            return None;
        }
        self.update(session);
        let mut chosen = None;
        let step = |key| ctx.input_mut(|input| input.consume_key(Modifiers::NONE, key));
        // Before the field, which would move its cursor.
        if step(Key::ArrowDown) {
            self.selected += 1;
        }
        if step(Key::ArrowUp) {
            self.selected = self.selected.saturating_sub(1);
        }
        self.selected = self.selected.min(self.found.len().saturating_sub(1));
        let mut open = true;
        egui::Window::new("Search")
            .open(&mut open)
            .collapsible(false)
            .resizable(false)
            .anchor(egui::Align2::CENTER_TOP, [0.0, 60.0])
            .show(ctx, |ui| {
                ui.set_width(WIDTH.min(ctx.content_rect().width() - 60.0));
                let field = egui::TextEdit::singleline(&mut self.text)
                    .hint_text("marks, moments, log lines, parameters, panels, actions")
                    .desired_width(f32::INFINITY);
                let field = ui.add(field).with_accessible_label("search for");
                if field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter)) {
                    chosen = self.found.get(self.selected).cloned();
                }
                field.request_focus();
                chosen = self.list(ui).or(chosen.take());
            });
        let escaped = ctx.input(|input| input.key_pressed(Key::Escape));
        if !open || escaped || chosen.is_some() {
            self.is_open = false;
        }
        chosen.map(|found| found.target)
    }

    fn list(&self, ui: &mut Ui) -> Option<Found> {
        let mut chosen = None;
        egui::ScrollArea::vertical()
            .max_height(360.0)
            .auto_shrink([false, true])
            .show(ui, |ui| {
                for (number, found) in self.found.iter().enumerate() {
                    let is_selected = number == self.selected;
                    let text =
                        RichText::new(format!("{:<9} {}", found.kind, found.text)).monospace();
                    let row = ui.add(egui::Button::selectable(is_selected, text).truncate());
                    if is_selected {
                        row.scroll_to_me(None);
                    }
                    if row.clicked() {
                        chosen = Some(found.clone());
                    }
                }
                if self.found.is_empty() && !self.text.trim().is_empty() {
                    ui.weak("Nothing found.");
                }
                if self.is_cut {
                    ui.weak(format!("More than {LISTED_MAX}: type another word."));
                }
            });
        chosen
    }
}

/// Everything that contains each of the words, or nothing for no word.
fn matching<'a>(words: &str, session: &'a Session) -> impl Iterator<Item = Found> + 'a {
    let words: Vec<String> = words.split_whitespace().map(str::to_lowercase).collect();
    let all = marks(session)
        .chain(actions())
        .chain(panels())
        .chain(settings(session))
        .chain(findings(session))
        .chain(log_lines(session));
    all.filter(move |found| {
        let text = format!("{} {}", found.kind, found.text).to_lowercase();
        !words.is_empty() && words.iter().all(|word| text.contains(word.as_str()))
    })
}

fn actions() -> impl Iterator<Item = Found> {
    let rows = SHORTCUTS.iter().flat_map(|(_, rows)| *rows);
    rows.flat_map(|row| {
        // The first key stands for a row, which names the others as well.
        row.bindings.first().map(|(_, _, action)| Found {
            kind: "action",
            text: format!("{}  ({})", row.does, row.keys()),
            target: Target::Action(*action),
        })
    })
}

fn panels() -> impl Iterator<Item = Found> {
    PANES.into_iter().map(|pane| Found {
        kind: "panel",
        text: pane.title().to_owned(),
        target: Target::Panel(pane),
    })
}

fn settings(session: &Session) -> impl Iterator<Item = Found> {
    session.settings.all().iter().map(|setting| Found {
        kind: "parameter",
        text: format!("{}  {}", setting.name(), setting.help),
        target: Target::Setting(setting.name()),
    })
}

fn moment(kind: &'static str, time: f64, text: &str) -> Found {
    Found {
        kind,
        text: format!("{time:9.3} s  {text}"),
        target: Target::Moment(time),
    }
}

fn marks(session: &Session) -> impl Iterator<Item = Found> {
    let marks = session.marks.iter();
    marks.map(|mark| moment("mark", mark.time, &mark.text))
}

fn findings(session: &Session) -> impl Iterator<Item = Found> {
    let findings = session.findings.all().iter();
    findings.map(|found| moment("moment", found.worst, &found.sentence()))
}

fn log_lines(session: &Session) -> impl Iterator<Item = Found> {
    let curve = session.curve(LOG_LINES);
    curve.into_iter().flat_map(|curve| {
        (0..curve.len()).filter_map(move |index| {
            let [time, value] = curve.point(index);
            Some(moment("log", time, curve.text(value)?))
        })
    })
}

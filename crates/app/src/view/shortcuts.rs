//! Keyboard shortcuts: from pressed keys to actions, and the window that lists them.

use eframe::egui::{self, Key, Modifiers, Ui};

use super::layout::LAYOUTS;
use super::shell::{View, command_shortcut};

/// Step of Shift with an arrow key, seconds.
const SEEK_STEP: f64 = 1.0;

/// Rows of the window that `?` opens: keys and their effect.
const SHORTCUTS: [(&str, &str); 17] = [
    ("Space", "play or pause"),
    ("Left, Right", "previous or next cycle"),
    ("Shift+Left, Shift+Right", "one second back or forward"),
    ("Home, End", "to the start or end (live source: now)"),
    ("M", "add a mark at the current time"),
    ("[ and ]", "slower or faster"),
    ("1 to 6", "Watch, Eyes, Place, Simulate, Calibrate, Health"),
    ("B", "camera: bird's-eye view"),
    ("C", "camera: classes"),
    ("L", "camera: field lines"),
    ("G", "camera: ground grid"),
    ("T", "light or dark theme"),
    (
        "Ctrl +, Ctrl -, Ctrl 0",
        "larger, smaller or normal interface scale",
    ),
    ("Ctrl+S", "save a screenshot in the working directory"),
    ("Ctrl+R", "save a report in the working directory"),
    ("Ctrl+Q", "close the window"),
    ("? or F1", "show this list"),
];

/// Applies the pressed shortcuts. A focused text field takes all keys but the Ctrl shortcuts.
pub(crate) fn handle_shortcuts(ui: &mut Ui, view: &mut View) {
    let ctx = ui.ctx().clone();
    let command = |key| ctx.input_mut(|input| input.consume_shortcut(&command_shortcut(key)));
    if command(Key::S) {
        view.save_screenshot(&ctx);
    }
    if command(Key::R) {
        view.save_report(&ctx);
    }
    if command(Key::Q) {
        ctx.send_viewport_cmd(egui::ViewportCommand::Close);
    }
    if ctx.egui_wants_keyboard_input() {
        return;
    }
    let plain = |key| ctx.input_mut(|input| input.consume_key(Modifiers::NONE, key));
    let shifted = |key| ctx.input_mut(|input| input.consume_key(Modifiers::SHIFT, key));
    // The question mark needs Shift on some keyboards only, so any modifiers are accepted.
    let asked = ctx.input(|input| input.key_pressed(Key::Questionmark));
    if asked || plain(Key::F1) {
        view.help_open = !view.help_open;
    }
    handle_playback_keys(view, &plain, &shifted);
    let shows = &mut view.panels.camera.layers;
    for (key, shown) in [
        (Key::C, &mut shows.classes),
        (Key::L, &mut shows.field_lines),
        (Key::G, &mut shows.grid),
    ] {
        *shown ^= plain(key);
    }
    view.panels.camera.birds_eye ^= plain(Key::B);
    if plain(Key::T) {
        let dark = ctx.theme() == egui::Theme::Dark;
        ctx.set_theme(if dark {
            egui::Theme::Light
        } else {
            egui::Theme::Dark
        });
    }
    let numbers = [
        Key::Num1,
        Key::Num2,
        Key::Num3,
        Key::Num4,
        Key::Num5,
        Key::Num6,
    ];
    for (key, (preset, _)) in numbers.into_iter().zip(LAYOUTS) {
        if plain(key) {
            view.set_layout(preset);
        }
    }
}

fn handle_playback_keys(
    view: &mut View,
    plain: &impl Fn(Key) -> bool,
    shifted: &impl Fn(Key) -> bool,
) {
    let session = &mut view.session;
    if plain(Key::Space) {
        session.toggle_playback();
    }
    for (key, by) in [(Key::ArrowLeft, -1), (Key::ArrowRight, 1)] {
        if shifted(key) {
            session.seek(session.playback.time + by as f64 * SEEK_STEP);
        } else if plain(key) {
            session.step(by);
        }
    }
    if let Some((start, end)) = session.source.span() {
        if plain(Key::Home) {
            session.seek(start);
        }
        if plain(Key::End) {
            session.seek(end);
            session.playback.playing = matches!(session.source, super::source::Source::Live(_));
        }
    }
    if plain(Key::M) {
        session.add_mark("");
    }
    for (key, factor) in [(Key::OpenBracket, 0.5), (Key::CloseBracket, 2.0)] {
        if plain(key) {
            session.set_speed(session.playback.speed * factor);
        }
    }
}

/// Draws the window that lists the shortcuts.
pub(crate) fn show_shortcut_list(ctx: &egui::Context, open: &mut bool) {
    egui::Window::new("Shortcuts")
        .open(open)
        .resizable(false)
        .collapsible(false)
        .show(ctx, |ui| {
            egui::Grid::new("keys").striped(true).show(ui, |ui| {
                for (key, does) in SHORTCUTS {
                    ui.monospace(key);
                    ui.label(does);
                    ui.end_row();
                }
            });
        });
}

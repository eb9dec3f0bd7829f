//! Which key does what? One table for the keys and for the window that lists them.

use eframe::egui::{self, Key, Modifiers, Ui};

use super::layout::LAYOUTS;
use super::shell::{View, command_shortcut};

/// Seconds that Shift with an arrow leaps.
const SEEK_STEP: f64 = 1.0;

/// What is listed under `?`.
const SHORTCUTS: [(&str, &str); 17] = [
    ("Space", "play or pause"),
    ("Left, Right", "a cycle back, on"),
    ("Shift+Left, Shift+Right", "a second back, on"),
    (
        "Home, End",
        "to the start, to the end (of a live source: now)",
    ),
    ("M", "mark this moment"),
    ("[ and ]", "slower, faster"),
    ("1 to 6", "Watch, Eyes, Place, Simulate, Calibrate, Health"),
    ("B", "camera: bird's-eye view"),
    ("C", "camera: classes"),
    ("L", "camera: field lines"),
    ("G", "camera: ground grid"),
    ("T", "light or dark"),
    ("Ctrl +, Ctrl -, Ctrl 0", "larger, smaller, usual size"),
    ("Ctrl+S", "screenshot into the working folder"),
    ("Ctrl+R", "report into the working folder"),
    ("Ctrl+Q", "close the window"),
    ("? or F1", "this list"),
];

/// Does what the pressed keys say; while a text is typed, none.
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
    // A question mark needs Shift on some keyboards and none on others.
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

/// The window that lists the keys.
pub(crate) fn show_shortcut_list(ctx: &egui::Context, open: &mut bool) {
    egui::Window::new("Keys")
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

//! Keyboard shortcuts: from pressed keys to actions, and the window that lists them.

use eframe::egui::{self, Key, KeyboardShortcut, Modifiers};

use super::layout::{LAYOUTS, PanelLayout};

/// Step of Shift with an arrow key, seconds.
const SEEK_STEP: f64 = 1.0;

/// Rows of the window that `?` opens: keys and their effect.
const SHORTCUTS: [(&str, &str); 22] = [
    ("Space", "play or pause"),
    ("Left, Right", "previous or next cycle"),
    ("Shift+Left, Shift+Right", "one second back or forward"),
    ("Home, End", "to the start or end (live source: now)"),
    ("M", "add a mark at the current time"),
    ("N, Shift+N", "to the next or previous odd moment"),
    ("O, Shift+O", "select the next or previous object"),
    ("PageUp, PageDown", "plots: shorter or longer time"),
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
    (
        "Ctrl+O, Ctrl+Shift+O",
        "open a run, or another one beside it",
    ),
    ("Ctrl+Z, Ctrl+Y", "undo or redo an edit"),
    ("Ctrl+S", "save a screenshot"),
    ("Ctrl+R", "save a report"),
    ("Ctrl+Q", "close the window"),
    ("? or F1", "show this list"),
];

/// What a shortcut asks of the view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Action {
    /// Save a screenshot.
    SaveScreenshot,
    /// Save a report.
    SaveReport,
    /// Open a run.
    Open,
    /// Open another run beside the shown one.
    OpenBeside,
    /// Undo the last edit.
    Undo,
    /// Redo the edit that was undone last.
    Redo,
    /// Close the window.
    Quit,
    /// Open or close the list of shortcuts.
    ToggleHelp,
    /// Toggle between playing and pause.
    TogglePlayback,
    /// Seek by this many seconds.
    SeekBy(f64),
    /// Step by this many cycles.
    Step(i64),
    /// Go to the first shown time.
    SeekToStart,
    /// Go to the last shown time.
    SeekToEnd,
    /// Go to the next odd moment (true) or to the previous one.
    SeekFinding(bool),
    /// Select the next object (true) or the previous one.
    SelectNext(bool),
    /// Multiply the time that the plots show.
    ScalePlottedTime(f64),
    /// Mark the shown time.
    AddMark,
    /// Multiply the playback speed.
    ScaleSpeed(f64),
    /// Toggle the camera layer of colour classes.
    ToggleClasses,
    /// Toggle the camera layer of field lines.
    ToggleFieldLines,
    /// Toggle the camera layer of the ground grid.
    ToggleGrid,
    /// Toggle the bird's-eye view.
    ToggleBirdsEye,
    /// Switch between the dark and the light theme.
    ToggleTheme,
    /// Arrange the panels.
    SetLayout(PanelLayout),
}

/// The actions of the pressed shortcuts. A focused text field takes all keys but the Ctrl shortcuts.
pub(crate) fn pressed_actions(ctx: &egui::Context) -> Vec<Action> {
    let command = |key| ctx.input_mut(|input| input.consume_shortcut(&command_shortcut(key)));
    let mut actions = Vec::new();
    let shifted_command = |key| {
        let modifiers = Modifiers::COMMAND | Modifiers::SHIFT;
        let shortcut = KeyboardShortcut::new(modifiers, key);
        ctx.input_mut(|input| input.consume_shortcut(&shortcut))
    };
    // With Shift before without, which would match too.
    for (key, action) in [(Key::O, Action::OpenBeside), (Key::Z, Action::Redo)] {
        if shifted_command(key) {
            actions.push(action);
        }
    }
    for (key, action) in [
        (Key::O, Action::Open),
        (Key::S, Action::SaveScreenshot),
        (Key::R, Action::SaveReport),
        (Key::Q, Action::Quit),
    ] {
        if command(key) {
            actions.push(action);
        }
    }
    if ctx.egui_wants_keyboard_input() {
        return actions;
    }
    // A text field has an undo of its own.
    for (key, action) in [(Key::Z, Action::Undo), (Key::Y, Action::Redo)] {
        if command(key) {
            actions.push(action);
        }
    }
    // The question mark needs Shift on some keyboards only, so any modifiers are accepted.
    let question_mark = ctx.input(|input| input.key_pressed(Key::Questionmark));
    let plain = |key| ctx.input_mut(|input| input.consume_key(Modifiers::NONE, key));
    if question_mark || plain(Key::F1) {
        actions.push(Action::ToggleHelp);
    }
    if plain(Key::Space) {
        actions.push(Action::TogglePlayback);
    }
    // With Shift before without: `consume_key` ignores an additional Shift.
    let shifted = |key| ctx.input_mut(|input| input.consume_key(Modifiers::SHIFT, key));
    for (key, seconds, cycles) in [
        (Key::ArrowLeft, -SEEK_STEP, -1),
        (Key::ArrowRight, SEEK_STEP, 1),
    ] {
        if shifted(key) {
            actions.push(Action::SeekBy(seconds));
        } else if plain(key) {
            actions.push(Action::Step(cycles));
        }
    }
    for (key, action) in [
        (Key::N, Action::SeekFinding as fn(bool) -> Action),
        (Key::O, Action::SelectNext),
    ] {
        if shifted(key) {
            actions.push(action(false));
        } else if plain(key) {
            actions.push(action(true));
        }
    }
    for (key, action) in [
        (Key::Home, Action::SeekToStart),
        (Key::End, Action::SeekToEnd),
        (Key::PageUp, Action::ScalePlottedTime(0.5)),
        (Key::PageDown, Action::ScalePlottedTime(2.0)),
        (Key::M, Action::AddMark),
        (Key::OpenBracket, Action::ScaleSpeed(0.5)),
        (Key::CloseBracket, Action::ScaleSpeed(2.0)),
        (Key::C, Action::ToggleClasses),
        (Key::L, Action::ToggleFieldLines),
        (Key::G, Action::ToggleGrid),
        (Key::B, Action::ToggleBirdsEye),
        (Key::T, Action::ToggleTheme),
    ] {
        if plain(key) {
            actions.push(action);
        }
    }
    let numbers = [
        Key::Num1,
        Key::Num2,
        Key::Num3,
        Key::Num4,
        Key::Num5,
        Key::Num6,
    ];
    for (key, (layout, _)) in numbers.into_iter().zip(LAYOUTS) {
        if plain(key) {
            actions.push(Action::SetLayout(layout));
        }
    }
    actions
}

/// A key combined with Ctrl (Command on macOS).
const fn command_shortcut(key: Key) -> KeyboardShortcut {
    KeyboardShortcut::new(Modifiers::COMMAND, key)
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

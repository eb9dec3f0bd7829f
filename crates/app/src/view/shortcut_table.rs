//! The table of keys and what they do.

use eframe::egui::{Key, Modifiers};

use super::layout::{LAYOUTS, PanelLayout};

/// Step of Shift with an arrow key, seconds.
const SEEK_STEP: f64 = 1.0;
const NONE: Modifiers = Modifiers::NONE;
const SHIFT: Modifiers = Modifiers::SHIFT;
const ALT: Modifiers = Modifiers::ALT;
const COMMAND: Modifiers = Modifiers::COMMAND;
const COMMAND_SHIFT: Modifiers = Modifiers::COMMAND.plus(Modifiers::SHIFT);

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
    /// Search in the run, the settings and the actions.
    Search,
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
    /// Go to the next mark (true) or to the previous one.
    SeekMark(bool),
    /// Select the next object (true) or the previous one.
    SelectNext(bool),
    /// Make the next panel (true) or the previous one the current one.
    NextPanel(bool),
    /// Move what the current panel shows: right and down, in steps.
    Pan([f32; 2]),
    /// Enlarge what the current panel shows by a factor.
    Zoom(f32),
    /// Show all in the current panel.
    ShowAll,
    /// Close the current panel.
    ClosePanel,
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
    /// Move the pointer by the arrow keys, or stop doing so.
    TogglePointer,
    /// Switch between the dark and the light theme.
    ToggleTheme,
    /// Arrange the panels.
    SetLayout(PanelLayout),
}

/// A key and what it does.
pub(crate) type Binding = (Modifiers, Key, Action);

/// A row of the table.
pub(crate) struct Shortcut {
    /// Its keys; empty for those of the window library.
    pub(crate) bindings: &'static [Binding],
    /// Keys of the window library.
    library: &'static str,
    /// What the keys do.
    pub(crate) does: &'static str,
}

const fn row(bindings: &'static [Binding], does: &'static str) -> Shortcut {
    Shortcut {
        bindings,
        library: "",
        does,
    }
}

const fn library(library: &'static str, does: &'static str) -> Shortcut {
    Shortcut {
        bindings: &[],
        library,
        does,
    }
}

/// All shortcuts, by subject.
pub(crate) const SHORTCUTS: [(&str, &[Shortcut]); 5] = [
    (
        "Time",
        &[
            row(
                &[(NONE, Key::Space, Action::TogglePlayback)],
                "play or pause",
            ),
            row(
                &[
                    (NONE, Key::ArrowLeft, Action::Step(-1)),
                    (NONE, Key::ArrowRight, Action::Step(1)),
                ],
                "previous or next cycle",
            ),
            row(
                &[
                    (SHIFT, Key::ArrowLeft, Action::SeekBy(-SEEK_STEP)),
                    (SHIFT, Key::ArrowRight, Action::SeekBy(SEEK_STEP)),
                ],
                "one second back or forward",
            ),
            row(
                &[
                    (NONE, Key::Home, Action::SeekToStart),
                    (NONE, Key::End, Action::SeekToEnd),
                ],
                "to the start or end (live source: now)",
            ),
            row(
                &[
                    (NONE, Key::N, Action::SeekFinding(true)),
                    (SHIFT, Key::N, Action::SeekFinding(false)),
                ],
                "to the next or previous odd moment",
            ),
            row(
                &[(NONE, Key::M, Action::AddMark)],
                "add a mark at the shown time",
            ),
            row(
                &[
                    (NONE, Key::J, Action::SeekMark(true)),
                    (SHIFT, Key::J, Action::SeekMark(false)),
                ],
                "to the next or previous mark",
            ),
            row(
                &[
                    (NONE, Key::OpenBracket, Action::ScaleSpeed(0.5)),
                    (NONE, Key::CloseBracket, Action::ScaleSpeed(2.0)),
                ],
                "slower or faster",
            ),
        ],
    ),
    (
        "The current panel (outlined)",
        &[
            row(
                &[
                    (NONE, Key::F6, Action::NextPanel(true)),
                    (SHIFT, Key::F6, Action::NextPanel(false)),
                ],
                "next or previous panel",
            ),
            row(
                &[
                    (ALT, Key::ArrowLeft, Action::Pan([-1.0, 0.0])),
                    (ALT, Key::ArrowRight, Action::Pan([1.0, 0.0])),
                    (ALT, Key::ArrowUp, Action::Pan([0.0, -1.0])),
                    (ALT, Key::ArrowDown, Action::Pan([0.0, 1.0])),
                ],
                "move what it shows (a list: scroll; Scene: turn)",
            ),
            row(
                &[
                    (NONE, Key::Plus, Action::Zoom(1.25)),
                    (NONE, Key::Minus, Action::Zoom(0.8)),
                    (NONE, Key::Num0, Action::ShowAll),
                ],
                "enlarge, reduce, show all",
            ),
            row(&[(COMMAND, Key::W, Action::ClosePanel)], "close it"),
        ],
    ),
    (
        "Panels",
        &[
            row(
                &[
                    (NONE, Key::O, Action::SelectNext(true)),
                    (SHIFT, Key::O, Action::SelectNext(false)),
                ],
                "select the next or previous object",
            ),
            row(
                &[
                    (NONE, Key::PageUp, Action::ScalePlottedTime(0.5)),
                    (NONE, Key::PageDown, Action::ScalePlottedTime(2.0)),
                ],
                "plots: shorter or longer time",
            ),
            row(
                &[(NONE, Key::B, Action::ToggleBirdsEye)],
                "camera: bird's-eye view",
            ),
            row(&[(NONE, Key::C, Action::ToggleClasses)], "camera: classes"),
            row(
                &[(NONE, Key::L, Action::ToggleFieldLines)],
                "camera: field lines",
            ),
            row(&[(NONE, Key::G, Action::ToggleGrid)], "camera: ground grid"),
            row(
                &[
                    (NONE, Key::Num1, Action::SetLayout(LAYOUTS[0].0)),
                    (NONE, Key::Num2, Action::SetLayout(LAYOUTS[1].0)),
                    (NONE, Key::Num3, Action::SetLayout(LAYOUTS[2].0)),
                    (NONE, Key::Num4, Action::SetLayout(LAYOUTS[3].0)),
                    (NONE, Key::Num5, Action::SetLayout(LAYOUTS[4].0)),
                    (NONE, Key::Num6, Action::SetLayout(LAYOUTS[5].0)),
                ],
                "Watch, Eyes, Place, Simulate, Calibrate, Health",
            ),
        ],
    ),
    (
        "Files and edits",
        &[
            row(&[(COMMAND, Key::F, Action::Search)], "search"),
            row(
                &[
                    (COMMAND, Key::O, Action::Open),
                    (COMMAND_SHIFT, Key::O, Action::OpenBeside),
                ],
                "open a run, or another one beside it",
            ),
            row(
                &[
                    (COMMAND, Key::Z, Action::Undo),
                    (COMMAND, Key::Y, Action::Redo),
                ],
                "undo or redo an edit",
            ),
            row(&[(COMMAND_SHIFT, Key::Z, Action::Redo)], "redo"),
            row(
                &[(COMMAND, Key::S, Action::SaveScreenshot)],
                "save a screenshot",
            ),
            row(&[(COMMAND, Key::R, Action::SaveReport)], "save a report"),
            row(&[(COMMAND, Key::Q, Action::Quit)], "close the window"),
        ],
    ),
    (
        "Window",
        &[
            library("Tab, Shift+Tab", "next or previous button or field"),
            library("Space, Enter", "press it"),
            library("Escape", "leave it: the other keys act again"),
            row(
                &[(NONE, Key::P, Action::TogglePointer)],
                "move the pointer by keys: paint, drag, measure, point",
            ),
            row(
                &[(NONE, Key::T, Action::ToggleTheme)],
                "light or dark theme",
            ),
            library(
                "Ctrl +, Ctrl -, Ctrl 0",
                "larger, smaller or normal interface",
            ),
            row(
                &[
                    (NONE, Key::Questionmark, Action::ToggleHelp),
                    (NONE, Key::F1, Action::ToggleHelp),
                ],
                "show this list",
            ),
        ],
    ),
];

impl Shortcut {
    /// Its keys, as the list names them.
    pub(crate) fn keys(&self) -> String {
        if self.bindings.is_empty() {
            return self.library.to_owned();
        }
        let keys = self
            .bindings
            .iter()
            .map(|(modifiers, key, _)| key_name(*modifiers, *key));
        keys.collect::<Vec<_>>().join(", ")
    }
}

/// Name of a key with its modifiers.
pub(crate) fn key_name(modifiers: Modifiers, key: Key) -> String {
    let key = match key {
        Key::ArrowLeft => "Left",
        Key::ArrowRight => "Right",
        Key::ArrowUp => "Up",
        Key::ArrowDown => "Down",
        Key::Plus | Key::Minus | Key::OpenBracket | Key::CloseBracket | Key::Questionmark => {
            key.symbol_or_name()
        }
        _ => key.name(),
    };
    let mut name = String::new();
    for (held, modifier) in [
        (modifiers.command, "Ctrl+"),
        (modifiers.alt, "Alt+"),
        (modifiers.shift, "Shift+"),
    ] {
        if held {
            name += modifier;
        }
    }
    name + key
}

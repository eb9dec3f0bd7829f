//! Keyboard shortcuts: one table binds keys to actions, and the window that `?` opens lists it.

use eframe::egui::{self, Event, Key, Modifiers};

use super::shortcut_table::{Action, Binding, SHORTCUTS};

/// True if keyboards differ in whether the key needs Shift.
fn may_need_shift(key: Key) -> bool {
    matches!(
        key,
        Key::Plus | Key::Minus | Key::OpenBracket | Key::CloseBracket | Key::Questionmark
    )
}

fn matches((modifiers, bound, _): &Binding, key: Key, mut held: Modifiers) -> bool {
    held.shift &= !may_need_shift(key);
    // On keyboards where Plus needs Shift, the key may arrive as Equals.
    let key = if key == Key::Equals { Key::Plus } else { key };
    key == *bound && held.matches_exact(*modifiers)
}

/// True if the binding holds while a button or a field has the focus.
fn acts_while_focused((modifiers, key, action): &Binding, typing: bool) -> bool {
    // A text field has an undo of its own, and Ctrl+W deletes a word.
    let edits = typing && matches!(action, Action::Undo | Action::Redo | Action::ClosePanel);
    (modifiers.command && !edits) || (modifiers.alt && !typing) || matches!(key, Key::F1 | Key::F6)
}

/// The actions of the pressed shortcuts, whose keys are taken from the input.
pub(crate) fn pressed_actions(ctx: &egui::Context) -> Vec<Action> {
    let (focused, typing) = (ctx.egui_wants_keyboard_input(), ctx.text_edit_focused());
    let bindings = SHORTCUTS.iter().flat_map(|(_, rows)| *rows);
    let bindings: Vec<&Binding> = bindings
        .flat_map(|row| row.bindings)
        .filter(|binding| !focused || acts_while_focused(binding, typing))
        .collect();
    let mut actions = Vec::new();
    ctx.input_mut(|input| {
        input.events.retain(|event| {
            let Event::Key {
                key,
                pressed: true,
                modifiers,
                ..
            } = event
            else {
                return true;
            };
            let bound = bindings
                .iter()
                .find(|binding| matches(binding, *key, *modifiers));
            actions.extend(bound.map(|(_, _, action)| *action));
            bound.is_none()
        });
    });
    actions
}

/// Draws the window that lists the shortcuts.
pub(crate) fn show_shortcut_list(ctx: &egui::Context, open: &mut bool) {
    if *open && ctx.input(|input| input.key_pressed(Key::Escape)) {
        *open = false;
    }
    egui::Window::new("Shortcuts")
        .open(open)
        .collapsible(false)
        .show(ctx, |ui| {
            egui::ScrollArea::vertical().show(ui, |ui| {
                for (subject, rows) in &SHORTCUTS {
                    ui.strong(*subject);
                    egui::Grid::new(subject).striped(true).show(ui, |ui| {
                        for row in *rows {
                            ui.monospace(row.keys());
                            ui.label(row.does);
                            ui.end_row();
                        }
                    });
                }
                ui.weak(
                    "While a button or a field has the focus, only keys with Ctrl, Alt and F act. In a text field Ctrl+W, Ctrl+Y and Ctrl+Z edit the text.",
                );
            });
        });
}

#[cfg(test)]
mod tests {
    use super::super::shortcut_table::key_name;
    use super::*;

    #[test]
    fn no_two_shortcuts_share_a_key() {
        let rows = SHORTCUTS.iter().flat_map(|(_, rows)| *rows);
        let mut names: Vec<String> = rows
            .flat_map(|row| row.bindings)
            .map(|(modifiers, key, _)| key_name(*modifiers, *key))
            .collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
    }
}

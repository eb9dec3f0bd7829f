//! Moves the pointer by keys: whatever is dragged, painted, measured or pointed at needs no mouse.

use eframe::egui::{
    self, Align2, Color32, Event, FontId, Key, Modifiers, MouseWheelSource, MouseWheelUnit,
    PointerButton, Pos2, RawInput, Rect, Stroke, TouchPhase, Vec2,
};

use super::pen::Pen;

/// Steps of an arrow key, points: with Ctrl, alone, and with Shift.
const STEPS: [f32; 3] = [1.0, 8.0, 48.0];
/// Scrolled lines of a key.
const LINES: f32 = 1.0;
/// What the keys do.
const HINT: &str = "Arrows move (Shift far, Ctrl near), Enter clicks, D holds the button, + and - scroll, Escape ends";

/// The pointer, while keys move it.
#[derive(Default)]
pub(crate) struct KeyboardPointer {
    at: Option<Pos2>,
    /// The button is held.
    held: bool,
}

impl KeyboardPointer {
    /// Begins at a place, or ends.
    pub(crate) fn toggle(&mut self, start: Pos2) {
        self.at = match self.at {
            Some(_) => None,
            None => Some(start),
        };
    }

    /// Turns keys into movements of the pointer, clicks and scrolling. A text field that is being typed in keeps them.
    pub(crate) fn translate(&mut self, ctx: &egui::Context, input: &mut RawInput) {
        let Some(at) = self.at else {
            return;
        };
        if ctx.text_edit_focused() {
            return;
        }
        let area = input.screen_rect.unwrap_or(Rect::EVERYTHING);
        let mut at = at.clamp(area.min, area.max);
        let mut events = Vec::new();
        let mut ends = false;
        for event in std::mem::take(&mut input.events) {
            match event {
                Event::Key {
                    key,
                    pressed,
                    modifiers,
                    ..
                } if !modifiers.alt => match (key, pressed) {
                    (Key::Escape, true) => ends = true,
                    (Key::Enter, _) => self.press(pressed, at, modifiers, &mut events),
                    (Key::D, true) => self.press(!self.held, at, modifiers, &mut events),
                    (Key::Plus | Key::Equals | Key::Minus, true) => {
                        let lines = if key == Key::Minus { -LINES } else { LINES };
                        events.push(Event::MouseWheel {
                            unit: MouseWheelUnit::Line,
                            delta: Vec2::new(0.0, lines),
                            modifiers: Modifiers::NONE,
                            phase: TouchPhase::Move,
                            source: MouseWheelSource::Unknown,
                        });
                    }
                    (_, true) if direction(key) != Vec2::ZERO => {
                        let step = STEPS
                            [1 + usize::from(modifiers.shift) - usize::from(modifiers.command)];
                        at = (at + step * direction(key)).clamp(area.min, area.max);
                        events.push(Event::PointerMoved(at));
                    }
                    (Key::D | Key::Plus | Key::Equals | Key::Minus, false) => {}
                    _ => events.push(event),
                },
                // The mouse moves it too.
                Event::PointerMoved(place) => {
                    at = place;
                    events.push(event);
                }
                _ => events.push(event),
            }
        }
        if ends {
            if self.held {
                self.press(false, at, Modifiers::NONE, &mut events);
            }
            self.at = None;
        } else {
            self.at = Some(at);
        }
        input.events = events;
    }

    fn press(&mut self, pressed: bool, pos: Pos2, modifiers: Modifiers, events: &mut Vec<Event>) {
        // A key that is held repeats.
        if pressed == self.held {
            return;
        }
        self.held = pressed;
        events.push(Event::PointerMoved(pos));
        events.push(Event::PointerButton {
            pos,
            button: PointerButton::Primary,
            pressed,
            modifiers,
        });
    }

    /// Shows where it is, and its keys.
    pub(crate) fn draw(&self, ctx: &egui::Context) {
        let Some(at) = self.at else {
            return;
        };
        let layer = egui::LayerId::new(egui::Order::Debug, egui::Id::unique("keyboard pointer"));
        let pen = Pen::new(ctx.layer_painter(layer));
        for (width, colour) in [(4.0, Color32::BLACK), (1.6, Color32::WHITE)] {
            let stroke = Stroke::new(width, colour);
            pen.plus(at, 12.0, stroke);
            if self.held {
                pen.circle(at, 6.0, stroke);
            }
        }
        let place = ctx.content_rect().center_bottom() - Vec2::new(0.0, 6.0);
        let galley = pen.layout(HINT.to_owned(), FontId::proportional(13.0), Color32::WHITE);
        let area = Align2::CENTER_BOTTOM.anchor_size(place, galley.size());
        pen.rect(area.expand(4.0), Color32::from_black_alpha(200));
        pen.painter().galley(area.min, galley, Color32::WHITE);
    }
}

/// Direction of an arrow key.
fn direction(key: Key) -> Vec2 {
    match key {
        Key::ArrowLeft => Vec2::LEFT,
        Key::ArrowRight => Vec2::RIGHT,
        Key::ArrowUp => Vec2::UP,
        Key::ArrowDown => Vec2::DOWN,
        _ => Vec2::ZERO,
    }
}

//! Labels beside things: each moves aside where another one is, and all lie over everything else.

use std::cell::RefCell;
use std::sync::Arc;

use eframe::egui::{Align2, Color32, FontId, Galley, Pos2, Rect, Vec2};

use super::pen::Pen;

/// Size of the text, points.
const FONT_SIZE: f32 = 12.0;
/// Places that a label tries on either side.
const SHIFTS: i8 = 5;
/// Room between two labels, points.
const GAP: f32 = 3.0;

/// The labels of a picture, collected until they are drawn.
#[derive(Default)]
pub(crate) struct Labels {
    placed: RefCell<Vec<(Rect, Option<Arc<Galley>>)>>,
}

impl Labels {
    /// Keeps an area free of labels.
    pub(crate) fn keep_free(&self, area: Rect) {
        self.placed.borrow_mut().push((area, None));
    }

    /// Adds the label of a thing: `offset` from it, aligned by `anchor`. Things out of sight have none.
    pub(crate) fn add(
        &self,
        pen: &Pen,
        (at, offset): (Pos2, Vec2),
        anchor: Align2,
        text: String,
        colour: Color32,
    ) {
        let visible = pen.clip_rect();
        if !visible.contains(at) {
            return;
        }
        let galley = pen.layout(text, FontId::proportional(FONT_SIZE), colour);
        let wanted = anchor.anchor_size(at + offset, galley.size());
        let wanted = moved_into(wanted, visible);
        let mut placed = self.placed.borrow_mut();
        let step = wanted.size() + Vec2::splat(GAP);
        // Above its place if that is free, else below, else farther away, else at its right or left.
        let shifts = [0.0, 1.0, -1.0].into_iter().flat_map(|right| {
            let rows = (0..SHIFTS).flat_map(|times| [-times, times + 1]);
            rows.map(move |down| step * Vec2::new(right, f32::from(down)))
        });
        let rect = shifts
            .map(|shift| moved_into(wanted.translate(shift), visible))
            .find(|rect| !placed.iter().any(|(other, _)| other.intersects(*rect)))
            .unwrap_or(wanted);
        placed.push((rect, Some(galley)));
    }

    /// Draws the labels.
    pub(crate) fn draw(&self, pen: &Pen) {
        let labels = self.placed.take();
        let labels = labels
            .into_iter()
            .filter_map(|(rect, galley)| Some((rect, galley?)));
        let labels: Vec<(Rect, Arc<Galley>)> = labels.collect();
        for (rect, _) in &labels {
            pen.rect(rect.expand(1.0), Color32::from_black_alpha(150));
        }
        let painter = pen.painter();
        for (rect, galley) in labels {
            painter.galley(rect.min, galley, Color32::WHITE);
        }
    }
}

/// The rectangle, moved by as little as necessary into an area.
fn moved_into(rect: Rect, area: Rect) -> Rect {
    let right = (area.left() - rect.left()).max(0.0) + (area.right() - rect.right()).min(0.0);
    let down = (area.top() - rect.top()).max(0.0) + (area.bottom() - rect.bottom()).min(0.0);
    rect.translate(Vec2::new(right, down))
}

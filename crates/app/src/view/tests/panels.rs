//! The picture of each panel, as shapes: no text may lie on another one or be cut off.

use eframe::egui::epaint::{ClippedShape, Shape};
use eframe::egui::{Rect, Vec2};

use super::*;
use crate::view::layout::build_single;
use crate::view::panels::PANES;

/// Sizes of the window: a laptop, and a part of its screen.
const SIZES: [[f32; 2]; 2] = [[1280.0, 800.0], [640.0, 480.0]];
/// Overlap of two texts that counts, points in each direction: glyphs leave some room around.
const OVERLAP_MIN: f32 = 3.0;

fn collect_texts(shape: &Shape, clip: Rect, texts: &mut Vec<(String, Rect)>) {
    match shape {
        Shape::Vec(shapes) => shapes
            .iter()
            .for_each(|shape| collect_texts(shape, clip, texts)),
        Shape::Text(text) => {
            // A wrapped text begins anywhere in its first row.
            for row in &text.galley.rows {
                let rect = row.rect_without_leading_space();
                let visible = rect.translate(text.pos.to_vec2()).intersect(clip);
                if !row.text().trim().is_empty() && visible.is_positive() {
                    texts.push((row.text(), visible));
                }
            }
        }
        _ => {}
    }
}

/// The visible texts of a picture with their places.
pub(super) fn texts(shapes: &[ClippedShape]) -> Vec<(String, Rect)> {
    let mut texts = Vec::new();
    for clipped in shapes {
        collect_texts(&clipped.shape, clipped.clip_rect, &mut texts);
    }
    texts
}

#[test]
fn no_text_of_a_panel_lies_on_another_one() {
    let mut faults = Vec::new();
    for pane in PANES {
        for size in SIZES {
            let mut view = View::new(Session::open(log()).expect("a session"), PanelLayout::Watch);
            view.session.playback.playing = false;
            view.tree = build_single(pane);
            let mut harness = Harness::builder()
                .with_size(Vec2::from(size))
                .allow_missing_glyphs()
                .build_ui_state(|ui, view: &mut View| view.ui(ui), view);
            harness.run_steps(4);
            let all = texts(&harness.output().shapes);
            assert!(all.len() > 5, "{pane:?} draws texts");
            for (number, (first, one)) in all.iter().enumerate() {
                for (second, other) in &all[number + 1..] {
                    let shared = one.intersect(*other).size();
                    if shared.x > OVERLAP_MIN && shared.y > OVERLAP_MIN {
                        faults.push(format!("{pane:?} at {size:?}: {first:?} on {second:?}"));
                    }
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_layout_is_drawn_with_and_without_a_log() {
    for (preset, _) in crate::view::layout::LAYOUTS {
        let mut with = open_demo_log(preset);
        with.run_steps(2);
        let mut without = harness(Session::default(), preset);
        without.run_steps(2);
    }
}

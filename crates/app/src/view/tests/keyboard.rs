//! Every action has a key: moving between panels, moving and enlarging what they show, the pointer, the search.

use eframe::egui::{Event, Pos2, RawInput, Rect, Vec2};

use super::*;
use crate::view::brush::Tool;
use crate::view::layout::panels_in_order;
use crate::view::panels::{Pane, PanelId};
use crate::view::shortcut_table::SHORTCUTS;

fn press(harness: &mut Harness<'_, View>, modifiers: Modifiers, key: Key) {
    harness.key_press_modifiers(modifiers, key);
    harness.run_steps(2);
}

/// Goes to a panel by keys alone.
fn go_to(harness: &mut Harness<'_, View>, pane: Pane) {
    for _ in 0..20 {
        if harness.state().current.id == Some(PanelId::from(pane)) {
            return;
        }
        press(harness, Modifiers::NONE, Key::F6);
    }
    panic!("{pane:?} is not reached");
}

#[test]
fn f6_reaches_every_panel_and_its_tab_comes_to_the_front() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    let order = panels_in_order(&harness.state().tree);
    let mut reached = Vec::new();
    for _ in &order {
        press(&mut harness, Modifiers::NONE, Key::F6);
        reached.extend(harness.state().current.id);
    }
    assert_eq!(reached, order);
    press(&mut harness, Modifiers::SHIFT, Key::F6);
    let before_last = order.len() - 2;
    assert_eq!(harness.state().current.id, Some(order[before_last]));
    go_to(&mut harness, Pane::Findings);
    harness.get_by_label("Next moment");
    press(&mut harness, Modifiers::COMMAND, Key::W);
    assert!(harness.query_by_label("Next moment").is_none());
}

/// The shapes of the last frame, as text.
fn picture(harness: &Harness<'_, View>) -> String {
    let shapes = &harness.output().shapes;
    shapes
        .iter()
        .map(|shape| format!("{:?}", shape.shape))
        .collect()
}

#[test]
fn every_picture_is_moved_enlarged_and_reset_by_keys() {
    for pane in [
        Pane::Camera,
        Pane::Field,
        Pane::Plots,
        Pane::Timeline,
        Pane::Scene,
    ] {
        let mut view = View::new(Session::open(log()).expect("a session"), PanelLayout::Watch);
        view.session.playback.playing = false;
        view.tree = crate::view::layout::build_single(pane);
        let mut harness = Harness::builder()
            .with_size([900.0, 600.0])
            .allow_missing_glyphs()
            .build_ui_state(|ui, view: &mut View| view.ui(ui), view);
        step_until(&mut harness, "the whole log", |view| {
            view.session.findings.complete
        });
        harness.state_mut().session.seek(0.5);
        go_to(&mut harness, pane);
        let shown = |harness: &Harness<'_, View>| {
            let view = harness.state();
            let panels = &view.panels;
            format!(
                "{:?} {:?} {:?} {:?} {:?}",
                panels.camera.pan_zoom(),
                panels.field.pan_zoom(),
                panels.plots.range(),
                panels.timeline.range(),
                panels.scene.camera()
            )
        };
        let whole = shown(&harness);
        press(&mut harness, Modifiers::NONE, Key::Plus);
        let enlarged = shown(&harness);
        assert_ne!(whole, enlarged, "{pane:?}");
        press(&mut harness, Modifiers::ALT, Key::ArrowRight);
        let moved = shown(&harness);
        assert_ne!(enlarged, moved, "{pane:?}");
        press(&mut harness, Modifiers::ALT, Key::ArrowLeft);
        press(&mut harness, Modifiers::NONE, Key::Minus);
        press(&mut harness, Modifiers::NONE, Key::Num0);
        assert_eq!(whole, shown(&harness), "{pane:?}");
        assert_eq!(harness.state().session.shown_time(), Some(0.5));
    }
}

#[test]
fn lists_scroll_by_keys() {
    let mut harness = open_demo_log(PanelLayout::Vision);
    go_to(&mut harness, Pane::Parameters);
    let before = picture(&harness);
    for _ in 0..5 {
        press(&mut harness, Modifiers::ALT, Key::ArrowDown);
    }
    harness.run_steps(10);
    assert_ne!(texts(&before), texts(&picture(&harness)));
}

/// The texts of a picture.
fn texts(picture: &str) -> Vec<&str> {
    let parts = picture.split("text: \"").skip(1);
    let texts = parts.filter_map(|part| part.split('"').next());
    texts.filter(|text| !text.contains("frames/s")).collect()
}

#[test]
fn list_of_shortcuts_holds_every_binding() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    press(&mut harness, Modifiers::NONE, Key::F1);
    for (subject, rows) in &SHORTCUTS {
        harness.get_by_label(subject);
        for row in *rows {
            assert!(!row.keys().is_empty());
            assert!(harness.query_all_by_label(&row.keys()).count() > 0);
            assert!(harness.query_all_by_label(row.does).count() > 0);
        }
    }
    press(&mut harness, Modifiers::NONE, Key::Escape);
    assert!(!harness.state().help_open);
}

#[test]
fn marks_are_visited_by_keys() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    for time in [0.2, 0.6] {
        harness.state_mut().session.seek(time);
        press(&mut harness, Modifiers::NONE, Key::M);
    }
    press(&mut harness, Modifiers::NONE, Key::Home);
    let time = |harness: &Harness<'_, View>| harness.state().session.playback.time;
    press(&mut harness, Modifiers::NONE, Key::J);
    assert_eq!(time(&harness), 0.2);
    press(&mut harness, Modifiers::NONE, Key::J);
    press(&mut harness, Modifiers::NONE, Key::J);
    assert_eq!(time(&harness), 0.6);
    press(&mut harness, Modifiers::SHIFT, Key::J);
    assert_eq!(time(&harness), 0.2);
}

/// Sends a key through the pointer, as the window does before each frame.
fn point(harness: &mut Harness<'_, View>, modifiers: Modifiers, key: Key, presses: &[bool]) {
    for &pressed in presses {
        let event = Event::Key {
            key,
            physical_key: None,
            pressed,
            repeat: false,
            modifiers,
        };
        let mut input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, Vec2::new(1280.0, 800.0))),
            events: vec![event],
            ..RawInput::default()
        };
        let ctx = harness.ctx.clone();
        harness.state_mut().pointer.translate(&ctx, &mut input);
        for event in input.events {
            harness.event(event);
        }
        harness.run_steps(1);
    }
}

#[test]
fn keyboard_pointer_paints_clicks_and_drags() {
    let mut harness = open_demo_log(PanelLayout::Calibrate);
    harness.state_mut().session.calibration.brush.tool = Tool::Pan;
    press(&mut harness, Modifiers::NONE, Key::P);
    let camera = harness.state().panels.camera.pan_zoom();
    let places = |harness: &Harness<'_, View>| harness.state().panels.camera.pan_zoom();
    // From the middle of the window into the camera panel.
    for _ in 0..5 {
        point(
            &mut harness,
            Modifiers::SHIFT,
            Key::ArrowLeft,
            &[true, false],
        );
    }
    // Nothing moves while the button is up.
    assert_eq!(places(&harness), camera);
    point(&mut harness, Modifiers::NONE, Key::D, &[true, false]);
    for _ in 0..3 {
        point(&mut harness, Modifiers::NONE, Key::ArrowUp, &[true, false]);
    }
    point(&mut harness, Modifiers::NONE, Key::D, &[true, false]);
    let dragged = places(&harness);
    assert!(dragged.centre.y > camera.centre.y, "{dragged:?}");
    for _ in 0..10 {
        point(&mut harness, Modifiers::NONE, Key::Plus, &[true, false]);
    }
    harness.run_steps(10);
    assert!(places(&harness).zoom > 1.2, "{:?}", places(&harness));
    let tool = Tool::Mask;
    harness.state_mut().session.calibration.brush.tool = tool;
    point(
        &mut harness,
        Modifiers::NONE,
        Key::Enter,
        &[true, true, false],
    );
    harness.run_steps(2);
    let mask = harness
        .state()
        .session
        .mask
        .clone()
        .expect("a painted mask");
    assert!(mask.iter().any(|seen| !seen));
    point(&mut harness, Modifiers::NONE, Key::Escape, &[true]);
    // The arrow keys step again.
    let before = harness.state().session.shown_time();
    point(
        &mut harness,
        Modifiers::NONE,
        Key::ArrowRight,
        &[true, false],
    );
    harness.run_steps(2);
    assert!(harness.state().session.shown_time() > before);
}

fn search_for(harness: &mut Harness<'_, View>, text: &str) {
    press(harness, Modifiers::COMMAND, Key::F);
    press(harness, Modifiers::COMMAND, Key::A);
    harness.get_by_label("search for").type_text(text);
    harness.run_steps(3);
}

#[test]
fn search_leads_to_marks_log_lines_parameters_and_panels() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    harness.state_mut().session.seek(0.4);
    harness
        .state_mut()
        .session
        .add_mark("ball lost by robot two");
    press(&mut harness, Modifiers::NONE, Key::Home);
    search_for(&mut harness, "ROBOT ball");
    press(&mut harness, Modifiers::NONE, Key::Enter);
    assert_eq!(harness.state().session.shown_time(), Some(0.4));
    assert!(harness.query_by_label("search for").is_none());

    // A line that the run itself has logged: it begins to track.
    press(&mut harness, Modifiers::NONE, Key::End);
    press(&mut harness, Modifiers::COMMAND, Key::F);
    step_until(&mut harness, "the lines of the log", |view| {
        view.session
            .curve("/log.message")
            .is_some_and(|curve| curve.len() > 0)
    });
    press(&mut harness, Modifiers::NONE, Key::Escape);
    let curve = harness
        .state()
        .session
        .curve("/log.message")
        .expect("lines");
    let [time, value] = curve.point(curve.len() - 1);
    let line = curve.text(value).expect("a text").to_owned();
    search_for(&mut harness, &format!("log {line}"));
    press(&mut harness, Modifiers::NONE, Key::Enter);
    let shown = harness.state().session.shown_time().expect("a time");
    assert!((shown - time).abs() < 0.05, "{shown} for {time}: {line}");

    search_for(&mut harness, "parameter scan range_max");
    press(&mut harness, Modifiers::NONE, Key::Enter);
    harness.get_by_label("range_max");
    assert!(harness.query_by_label("spiral_turns").is_none());

    search_for(&mut harness, "panel health");
    press(&mut harness, Modifiers::NONE, Key::Enter);
    let health = Some(PanelId::from(Pane::Health));
    assert_eq!(harness.state().current.id, health);

    // The second result, by the arrow key: an action.
    search_for(&mut harness, "camera:");
    press(&mut harness, Modifiers::NONE, Key::ArrowDown);
    press(&mut harness, Modifiers::NONE, Key::Enter);
    let layers = harness.state().panels.camera.layers;
    assert!(layers.classes && !harness.state().panels.camera.birds_eye);

    search_for(&mut harness, "no such words anywhere");
    harness.get_by_label("Nothing found.");
}

#[test]
fn ctrl_w_edits_a_text_field_instead_of_closing_the_panel() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    go_to(&mut harness, Pane::Timeline);
    let field = "text of the mark";
    harness.get_by_label(field).click();
    harness.run_steps(2);
    harness.get_by_label(field).type_text("ball lost");
    harness.run_steps(2);
    // As the window sends it: with Ctrl itself.
    let control = Modifiers::COMMAND | Modifiers::CTRL;
    press(&mut harness, control, Key::W);
    assert_eq!(
        harness.get_by_label(field).value().as_deref(),
        Some("ball ")
    );
    // Out of the field, the same key closes the panel.
    press(&mut harness, Modifiers::NONE, Key::Escape);
    press(&mut harness, control, Key::W);
    assert!(harness.query_by_label(field).is_none());
}

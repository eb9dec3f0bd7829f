//! Layout files, several panels of a kind, undo and redo, dialogs.

use super::*;
use crate::view::layout::open_panels;
use crate::view::layout_file::SavedLayout;
use crate::view::panels::{Pane, PanelId};

#[test]
fn layout_file_restores_panels_and_what_they_show() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("layout.json");
    let mut harness = open_demo_log(PanelLayout::Localization);
    let view = harness.state_mut();
    crate::view::layout::open_pane(&mut view.tree, Pane::Plots);
    view.panels.camera.birds_eye = true;
    harness.run_steps(3);
    // A copy has a state of its own.
    let titles = harness.query_all_by_label("Plots 2").count();
    assert_eq!(titles, 1);
    let view = harness.state();
    let saved = SavedLayout::of(view.layout, &view.tree, &view.panels);
    saved.save(&path).expect("written");
    let mut other = open_demo_log(PanelLayout::Health);
    let loaded = SavedLayout::load(&path).expect("a layout");
    other.state_mut().restore_layout(loaded);
    other.run_steps(3);
    let (first, second) = (harness.state(), other.state());
    assert_eq!(open_panels(&first.tree), open_panels(&second.tree));
    let copy = PanelId {
        pane: Pane::Plots,
        copy: 1,
    };
    assert!(open_panels(&second.tree).contains(&copy));
    assert!(second.panels.camera.birds_eye);
}

#[test]
fn damaged_layout_file_is_refused_with_its_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("layout.json");
    for text in ["", "{}", "[1, 2]", "not a layout"] {
        std::fs::write(&path, text).expect("written");
        let error = SavedLayout::load(&path).err().expect("an error");
        let text = format!("{error:#}");
        assert!(text.contains("layout.json"), "{text}");
    }
}

#[test]
fn edits_are_undone_and_redone() {
    let mut harness = open_demo_log(PanelLayout::Vision);
    let range = |harness: &Harness<'_, View>| {
        let settings = &harness.state().session.settings;
        settings.config().vision.scan.range_max
    };
    let mut config = PipelineConfig::default();
    config.vision.scan.range_max = 7.0;
    harness.state_mut().session.apply_config(config);
    harness.run_steps(2);
    harness.key_press(Key::M);
    harness.run_steps(2);
    harness.key_press(Key::Num1);
    harness.run_steps(2);
    let undo = |harness: &mut Harness<'_, View>, key| {
        harness.key_press_modifiers(Modifiers::COMMAND, key);
        harness.run_steps(2);
    };
    undo(&mut harness, Key::Z);
    assert_eq!(harness.state().layout, PanelLayout::Vision);
    assert_eq!(harness.state().session.marks.len(), 1);
    undo(&mut harness, Key::Z);
    assert_eq!(
        (harness.state().session.marks.len(), range(&harness)),
        (0, 7.0)
    );
    undo(&mut harness, Key::Z);
    assert_eq!(range(&harness), 9.0);
    undo(&mut harness, Key::Z);
    assert_eq!(range(&harness), 9.0, "nothing more to undo");
    undo(&mut harness, Key::Y);
    undo(&mut harness, Key::Y);
    assert_eq!(
        (harness.state().session.marks.len(), range(&harness)),
        (1, 7.0)
    );
}

#[test]
fn dialog_is_answered_by_the_keyboard() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("copy.mcap");
    std::fs::copy(log(), &path).expect("copied");
    let mut harness = harness(Session::default(), PanelLayout::Watch);
    harness.run_steps(2);
    harness.key_press_modifiers(Modifiers::COMMAND, Key::O);
    harness.run_steps(2);
    harness
        .get_by_label("path")
        .type_text(&path.display().to_string());
    harness.run_steps(2);
    harness.key_press(Key::Enter);
    harness.run_steps(3);
    let view = harness.state();
    assert_eq!((&view.problem, &view.session.last_error), (&None, &None));
    assert!(
        view.session.title.ends_with("copy.mcap"),
        "{}",
        view.session.title
    );
    assert_eq!(view.recent_files, [path]);
    harness.key_press_modifiers(Modifiers::COMMAND, Key::S);
    harness.run_steps(2);
    harness.get_by_label("path");
    harness.key_press(Key::Escape);
    harness.run_steps(2);
    assert!(harness.query_by_label("path").is_none());
}

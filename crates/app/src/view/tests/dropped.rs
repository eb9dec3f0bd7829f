//! Files dropped on the window.

use std::sync::Arc;

use eframe::egui::{DroppedFile, Event};

use super::*;
use crate::view::layout::open_panels;
use crate::view::layout_file::SavedLayout;

#[derive(Debug)]
struct File(PathBuf);

impl DroppedFile for File {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        std::fs::read(&self.0).map_err(|error| error.to_string())
    }
}

fn drop_files(harness: &mut Harness<'_, View>, paths: &[&Path], modifiers: Modifiers) {
    harness.event(Event::ModifiersChanged(modifiers));
    let input = harness.input_mut();
    for path in paths {
        let file = File(path.to_path_buf());
        input.dropped_files.push(Arc::new(file));
    }
    harness.run_steps(1);
    harness.event(Event::ModifiersChanged(Modifiers::NONE));
    harness.run_steps(2);
}

#[test]
fn dropped_log_is_opened_and_further_ones_beside_it() {
    let mut harness = harness(Session::default(), PanelLayout::Watch);
    drop_files(&mut harness, &[log(), log()], Modifiers::NONE);
    let session = &harness.state().session;
    assert_eq!(session.log_path().as_deref(), Some(log()));
    assert_eq!(session.others.len(), 1);
    drop_files(&mut harness, &[log()], Modifiers::SHIFT);
    assert_eq!(harness.state().session.others.len(), 2);
    // Without Shift it is another run, alone.
    drop_files(&mut harness, &[log()], Modifiers::NONE);
    assert!(harness.state().session.others.is_empty());
    assert_eq!(harness.state().problem, None);
}

#[test]
fn dropped_recording_folder_is_opened_with_its_poses() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
    let mut harness = harness(Session::default(), PanelLayout::Watch);
    drop_files(&mut harness, &[&folder], Modifiers::NONE);
    let view = harness.state();
    assert_eq!(view.problem, None);
    let shown = view.session.shown.as_ref().expect("a cycle");
    assert!(shown.cycle.estimate.pose.is_some());
}

#[test]
fn dropped_layout_is_shown_and_the_run_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("layout.json");
    let mut harness = open_demo_log(PanelLayout::Health);
    let view = harness.state();
    let saved = SavedLayout::of(view.layout, &view.tree, &view.panels);
    saved.save(&path).expect("written");
    let expected = open_panels(&view.tree);
    let view = harness.state_mut();
    view.set_layout(PanelLayout::Vision);
    assert_ne!(open_panels(&view.tree), expected);
    drop_files(&mut harness, &[&path], Modifiers::NONE);
    let view = harness.state();
    assert_eq!(open_panels(&view.tree), expected);
    assert_eq!(view.session.log_path().as_deref(), Some(log()));
}

#[test]
fn other_dropped_files_are_refused_in_one_message_that_stays_while_the_log_plays() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (notes, bare, damaged) = (path("notes.txt"), path("notes"), path("cut.json"));
    for path in [&notes, &bare, &damaged] {
        std::fs::write(path, "text").expect("written");
    }
    let empty = path("empty");
    std::fs::create_dir(&empty).expect("a folder");
    for path in [&notes, &bare, &damaged, &empty, &path("gone.mcap")] {
        let mut harness = open_demo_log(PanelLayout::Watch);
        harness.state_mut().session.playback.playing = true;
        drop_files(&mut harness, &[path], Modifiers::NONE);
        harness.run_steps(3);
        let view = harness.state();
        // The run goes on.
        assert_eq!(view.session.log_path().as_deref(), Some(log()));
        let problem = view.problem.clone().expect("a message");
        let name = path.file_name().expect("a name").to_string_lossy();
        assert!(problem.contains(&*name), "{problem}");
        assert!(!problem.contains('\n'), "{problem}");
        harness.get_by_label(&problem);
        // The next success ends it.
        drop_files(&mut harness, &[log()], Modifiers::NONE);
        assert_eq!(harness.state().problem, None);
    }
}

#[test]
fn each_refused_file_of_several_is_named() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    let paths = [Path::new("/gone/one.txt"), Path::new("/gone/two.pdf")];
    drop_files(&mut harness, &paths, Modifiers::NONE);
    let problem = harness.state().problem.clone().expect("a message");
    assert!(
        problem.contains("one.txt") && problem.contains("two.pdf"),
        "{problem}"
    );
    assert!(problem.contains("expected a log (.mcap)"), "{problem}");
}

//! Logs with damaged or missing parts: what the view shows of them, and what it says.

use std::collections::BTreeMap;
use std::path::Path;

use egui_kittest::kittest::Queryable;

use super::{harness, log, step_until};
use crate::view::layout::PanelLayout;
use crate::view::session::{NO_ESTIMATE, Session};

/// Writes the log with a wrong byte in the chunk that `choose` picks by their number.
fn write_damaged(path: &Path, choose: impl Fn(usize) -> usize) {
    let mut bytes = std::fs::read(log()).expect("a log");
    let summary = mcap::Summary::read(&bytes).expect("readable");
    let mut chunks = summary.expect("a summary").chunk_indexes;
    chunks.sort_by_key(|chunk| chunk.chunk_start_offset);
    let chunk = &chunks[choose(chunks.len())];
    let damaged = chunk.chunk_start_offset + chunk.chunk_length / 2;
    bytes[damaged as usize] ^= 0xff;
    std::fs::write(path, &bytes).expect("written");
}

#[test]
fn log_with_a_damaged_start_opens_at_its_first_readable_cycle() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("damaged.mcap");
    // The one before it holds the field and the first image.
    write_damaged(&path, |_| 1);
    let session = Session::open(&path).expect("a session");
    assert!(session.shown_time().is_some_and(|time| time > 0.0));
    assert_eq!(Some(session.playback.time), session.shown_time());
    let error = session.last_error.expect("the damage");
    assert!(error.contains("`mirrorball recover` saves"), "{error}");
}

#[test]
fn damaged_part_of_a_log_is_named_once_the_log_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("damaged.mcap");
    write_damaged(&path, |count| count / 2);
    let session = Session::open(&path).expect("a session");
    assert_eq!(session.last_error, None);
    let mut harness = harness(session, PanelLayout::Watch);
    step_until(&mut harness, "the log", |view| view.session.is_read());
    harness.run_steps(2);
    let damage = &harness.state().session.damage;
    assert_eq!(damage.parts().len(), 1);
    harness.get_by_label(&damage.notice().expect("a notice"));
}

#[test]
fn log_without_cycles_and_poses_shows_no_mode() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("images.mcap");
    let file = std::fs::File::create(&path).expect("a file");
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).expect("a writer");
    let bytes = std::fs::read(log()).expect("a log");
    let messages = mcap::MessageStream::new(&bytes).expect("messages");
    let messages = messages.map(|message| message.expect("a message"));
    for message in messages.filter(|message| message.channel.topic == "/camera/image") {
        let id = writer
            .add_channel(0, &message.channel.topic, "protobuf", &BTreeMap::new())
            .expect("a channel");
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer
            .write_to_known_channel(&header, &message.data)
            .expect("written");
    }
    writer.finish().expect("closed");
    let session = Session::open(&path).expect("a session");
    assert!(session.shown.is_some() && !session.holds_poses);
    let mut harness = harness(session, PanelLayout::Watch);
    step_until(&mut harness, "the log", |view| view.session.is_read());
    harness.run_steps(2);
    assert!(harness.query_all_by_label(NO_ESTIMATE).count() > 0);
    assert!(harness.query_all_by_label("lost").count() == 0);
    assert_eq!(harness.state().session.findings.all().len(), 0);
}

//! Tests of the index: it yields the same cycles as sequential reading, also for truncated files and other versions.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};

use crate::log::{EncodedImage, LogCompleteness, LogConfig, LogIndex, LoggedCycle};
use crate::testing::{random_cycle, read, record};

/// All cycles, chunk by chunk.
fn all(index: &LogIndex) -> Vec<LoggedCycle> {
    let parts = 0..index.chunks().len();
    parts
        .flat_map(|part| index.load(part).expect("a chunk"))
        .collect()
}

fn image(logged: &LoggedCycle) -> &EncodedImage {
    logged.image.as_ref().expect("an image")
}

#[test]
fn indexed_chunks_equal_sequential_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    record(&path, 200, &LogConfig::default());
    let index = LogIndex::open(&path).expect("an index");
    assert_eq!(index.end(), LogCompleteness::Complete);
    assert!(index.chunks().len() > 3, "{} chunks", index.chunks().len());
    let (jumped, walked) = (all(&index), read(&path));
    assert_eq!(jumped.len(), walked.len());
    for (a, b) in jumped.iter().zip(&walked) {
        assert_eq!((a.index, a.cycle.stamp), (b.index, b.cycle.stamp));
        assert_eq!(image(a), image(b), "cycle {}", a.index);
    }
    let wanted = random_cycle(150).stamp;
    let part = index.chunk_at(wanted);
    let near = [part.saturating_sub(1), part].map(|part| index.load(part).expect("a chunk"));
    let found = near.iter().flatten().any(|l| l.cycle.stamp == wanted);
    assert!(found, "cycle 150 is in chunk {part} or before it");
}

#[test]
fn truncated_log_is_indexed_to_its_last_complete_chunk() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, cut) = (folder.path().join("a.mcap"), folder.path().join("cut.mcap"));
    record(&path, 200, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("bytes");
    std::fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).expect("cut");
    let index = LogIndex::open(&cut).expect("an index");
    assert_eq!(index.end(), LogCompleteness::Truncated);
    assert_eq!(all(&index).len(), read(&cut).len());
    assert!(index.warnings().iter().any(|line| line.contains("is cut")));
}

/// Rewrites a log as another version might: in another format, with cycles that cannot be decoded, and without some topics.
fn rewrite_as_newer_version(from: &Path, to: &Path, without: &[&str]) {
    let bytes = std::fs::read(from).expect("bytes");
    let file = std::fs::File::create(to).expect("a file");
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).expect("a writer");
    let metadata = [("format", "99"), ("version", "9.9.9"), ("source", "later")];
    writer
        .write_metadata(&Metadata {
            name: "mirrorball".to_owned(),
            metadata: BTreeMap::from(metadata.map(|(k, v)| (k.to_owned(), v.to_owned()))),
        })
        .expect("written");
    for message in mcap::MessageStream::new(&bytes).expect("messages") {
        let message = message.expect("a message");
        let topic = message.channel.topic.clone();
        if without.contains(&&*topic) {
            continue;
        }
        let id = writer
            .add_channel(0, &topic, "protobuf", &BTreeMap::new())
            .expect("a channel");
        let header = MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        let data: &[u8] = if topic == "/cycle" {
            b"\xff\xff"
        } else {
            &message.data
        };
        writer
            .write_to_known_channel(&header, data)
            .expect("written");
    }
    writer.finish().expect("closed");
}

#[test]
fn newer_log_format_still_shows_images_poses_and_line_points() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, later) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&path, 20, &LogConfig::default());
    rewrite_as_newer_version(&path, &later, &[]);
    let index = LogIndex::open(&later).expect("an index");
    let warnings = index.warnings().join("\n");
    assert!(
        warnings.contains("9.9.9") && warnings.contains("log format 99"),
        "{warnings}"
    );
    assert!(warnings.contains("no robot.toml"), "{warnings}");
    let cycles = all(&index);
    let first = |logged: &&LoggedCycle| logged.cycle.stamp == random_cycle(1).stamp;
    let found = cycles.iter().find(first).expect("cycle 1");
    let expected = random_cycle(1);
    let (pose, known) = (found.cycle.estimate.pose, expected.estimate.pose);
    let (pose, known) = (pose.expect("a pose"), known.expect("a pose"));
    assert_eq!((pose.x, pose.y), (known.x, known.y));
    assert!((pose.theta - known.theta).abs() < 1e-5);
    assert_eq!(found.cycle.line_points.len(), expected.line_points.len());
    assert!(found.image.is_some() && index.holds_poses());
}

#[test]
fn log_without_cycles_and_poses_says_that_images_alone_are_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, later) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&path, 20, &LogConfig::default());
    rewrite_as_newer_version(&path, &later, &["/cycle", "/pose"]);
    let index = LogIndex::open(&later).expect("an index");
    let line = "no topic /cycle: images alone are shown";
    assert!(index.warnings().iter().any(|warning| warning == line));
    assert!(!index.holds_poses() && all(&index).len() >= 20);
}

#[test]
fn non_mcap_file_is_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("no.mcap");
    std::fs::write(&path, b"no log").expect("written");
    let error = LogIndex::open(&path).map(|_| ()).expect_err("refused");
    assert!(format!("{error:#}").contains("is no MCAP file"));
}

//! Tests of logs that other programs have written again: order of records, repetitions, sizes of chunks.

use std::path::Path;

use mcap::{Attachment, WriteOptions};

use crate::log::columns::TopicReader;
use crate::log::{Header, LogConfig, LogIndex, LogReader, recover};
use crate::testing::{read, read_error, record};

/// Writes a log again: its messages, each `times` times in a row, and then its metadata and attachments.
fn rewrite(from: &Path, to: &Path, options: WriteOptions, times: usize) {
    let bytes = std::fs::read(from).expect("a log");
    let summary = mcap::Summary::read(&bytes)
        .expect("readable")
        .expect("a summary");
    let file = std::io::BufWriter::new(std::fs::File::create(to).expect("a file"));
    let mut writer = options.create(file).expect("a writer");
    for message in mcap::MessageStream::new(&bytes).expect("messages") {
        let message = message.expect("a message");
        for _ in 0..times {
            writer.write(&message).expect("written");
        }
    }
    for index in &summary.metadata_indexes {
        let metadata = mcap::read::metadata(&bytes, index).expect("metadata");
        writer.write_metadata(&metadata).expect("written");
    }
    for index in &summary.attachment_indexes {
        let Attachment { name, data, .. } =
            mcap::read::attachment(&bytes, index).expect("an attachment");
        writer
            .attach(&Attachment {
                log_time: 0,
                create_time: 0,
                name,
                media_type: String::new(),
                data,
            })
            .expect("written");
    }
    writer.finish().expect("finished");
}

#[test]
fn metadata_and_files_may_stand_behind_the_messages() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, other, whole] = ["a.mcap", "b.mcap", "c.mcap"].map(|name| folder.path().join(name));
    record(&path, 20, &LogConfig::default());
    let header = LogReader::open(&path).expect("a log").header().clone();
    for use_chunks in [true, false] {
        let options = WriteOptions::new().use_chunks(use_chunks);
        rewrite(&path, &other, options, 1);
        assert_eq!(*LogReader::open(&other).expect("a log").header(), header);
        assert_eq!(read(&other).len(), 20);
        recover(&other, &whole).expect("recovered");
        assert_eq!(read(&whole).len(), 20);
        let index = LogIndex::open(&whole).expect("an index");
        assert_eq!(*index.header(), header);
        let topics = TopicReader::open(&whole).expect("topics");
        assert_eq!(topics.files().expect("files"), header.files);
    }
}

#[test]
fn message_that_stands_twice_is_one_cycle() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, twice] = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    record(&path, 20, &LogConfig::default());
    rewrite(&path, &twice, WriteOptions::new(), 2);
    let indices = read(&twice).into_iter().map(|logged| logged.index);
    assert!(indices.eq(0..20));
    let index = LogIndex::open(&twice).expect("an index");
    assert_eq!(index.load(0).expect("cycles").len(), 20);
}

#[test]
fn control_characters_of_the_metadata_are_escaped() {
    let mut header = Header::new("test", None);
    header.version = "9\u{1b}[31m".to_owned();
    let read = Header::from_metadata(&header.metadata(), Path::new("a.mcap")).expect("a header");
    assert_eq!(read.version, "9\\u{1b}[31m");
}

#[test]
fn chunk_above_the_limit_is_no_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, large, whole] = ["a.mcap", "b.mcap", "c.mcap"].map(|name| folder.path().join(name));
    record(&path, 3, &LogConfig::default());
    // One chunk of everything, without compression.
    let options = WriteOptions::new().compression(None).chunk_size(None);
    let bytes = std::fs::metadata(&path).expect("a log").len();
    let times = 1 + (65 << 20) / bytes as usize;
    rewrite(&path, &large, options, times);
    let message = read_error(&large);
    assert!(!message.contains("damaged") && !message.contains("recover"));
    assert!(message.contains("67108864 bytes"), "{message}");
    assert!(message.contains("smaller chunks"), "{message}");
    let recovered = recover(&large, &whole).expect("recovered");
    assert!(recovered.lost[0].contains("more than this program reads"));
}

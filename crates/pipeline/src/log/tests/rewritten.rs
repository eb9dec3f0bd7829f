//! Tests of logs that other programs have written again: order of records, repetitions, sizes of chunks.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use mcap::{Attachment, Message, WriteOptions};

use crate::log::columns::TopicReader;
use crate::log::{Header, LogConfig, LogIndex, LogReader, export, recover};
use crate::testing::{read, read_error, record};

/// Writes a log again: its messages, each `times` times in a row, and then its metadata and attachments.
fn rewrite(from: &Path, to: &Path, options: WriteOptions, times: usize) {
    rewrite_in_order(from, to, options, |messages| {
        let repeated = |message| std::iter::repeat_n(message, times);
        messages.into_iter().flat_map(repeated).collect()
    });
}

/// Writes a log again: its messages as `order` has them, and then its metadata and attachments.
fn rewrite_in_order(
    from: &Path,
    to: &Path,
    options: WriteOptions,
    order: impl FnOnce(Vec<Message>) -> Vec<Message>,
) {
    let bytes = std::fs::read(from).expect("a log");
    let summary = mcap::Summary::read(&bytes)
        .expect("readable")
        .expect("a summary");
    let file = std::io::BufWriter::new(std::fs::File::create(to).expect("a file"));
    let mut writer = options.create(file).expect("a writer");
    let messages = mcap::MessageStream::new(&bytes).expect("messages");
    for message in order(messages.collect::<Result<_, _>>().expect("messages")) {
        writer.write(&message).expect("written");
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

/// The tables and images of a recording folder.
fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let parts = [folder.to_owned(), folder.join("frames")];
    let entries = parts
        .iter()
        .flat_map(|part| part.read_dir().expect("a folder"));
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let files = paths.filter(|path| path.is_file());
    let inside = |path: &Path| path.strip_prefix(folder).expect("inside").to_owned();
    files
        .map(|path| (inside(&path), std::fs::read(path).expect("a file")))
        .collect()
}

#[test]
fn log_in_any_order_is_exported_as_the_log_in_its_own() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, other] = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    record(&path, 20, &LogConfig::default());
    let exported = |log: &Path, name: &str| {
        let out = folder.path().join(name);
        let summary = export(LogReader::open(log).expect("a log"), &out).expect("exported");
        (summary, content(&out))
    };
    let expected = exported(&path, "in order");
    assert_eq!(expected.0.frames, 20);
    type Order = fn(Vec<Message>) -> Vec<Message>;
    let orders: [(&str, Order); 3] = [
        ("backwards", |mut messages| {
            messages.reverse();
            messages
        }),
        ("topic by topic", |mut messages| {
            messages.sort_by_key(|message| message.channel.topic.clone());
            messages
        }),
        ("shuffled", |messages| {
            let count = messages.len();
            let places = (0..count).map(|place| (place * 7919 + 5) % count);
            assert_eq!(places.clone().collect::<BTreeSet<_>>().len(), count);
            places.map(|place| messages[place].clone()).collect()
        }),
    ];
    for (name, order) in orders {
        let options = WriteOptions::new().chunk_size(Some(20_000));
        rewrite_in_order(&path, &other, options, order);
        assert!(exported(&other, name) == expected, "{name}");
    }
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

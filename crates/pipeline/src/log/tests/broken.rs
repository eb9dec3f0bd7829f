//! Tests of killed, truncated and damaged logs, and of files that are not logs.

use std::path::Path;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::feed::Pace;
use crate::log::{
    Header, ImageCompression, LogCompleteness, LogConfig, LogIndex, LogReader, Recorder,
    UnpackedSetup, recover,
};
use crate::testing::{field, random_cycle, read, read_error, record};

#[test]
fn truncated_log_reads_to_its_last_complete_chunk_and_is_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, cut, whole) = (
        folder.path().join("a.mcap"),
        folder.path().join("cut.mcap"),
        folder.path().join("b.mcap"),
    );
    record(&path, 300, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("bytes");
    std::fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).expect("cut");
    let before = read(&cut);
    assert!(before.len() > 100 && before.len() < 300, "{}", before.len());
    let recovered = recover(&cut, &whole).expect("recovered");
    assert!(!recovered.was_whole && recovered.lost.is_empty());
    assert!(recovered.until >= before.last().map(|logged| logged.cycle.stamp));
    let mut log = LogReader::open(&whole).expect("a log");
    assert_eq!(
        log.header(),
        LogReader::open(&path).expect("a log").header()
    );
    assert_eq!(
        log.by_ref()
            .map(|logged| logged.expect("a cycle").index)
            .last(),
        before.last().map(|logged| logged.index)
    );
    assert_eq!(log.end(), Some(LogCompleteness::Complete));
    let bytes = std::fs::read(&whole).expect("bytes");
    let summary = mcap::Summary::read(&bytes)
        .expect("readable")
        .expect("a summary");
    assert_eq!(
        summary.stats.expect("statistics").message_count,
        recovered.messages
    );
    assert!(format!("{:#}", recover(&cut, &cut).expect_err("refused")).contains("into itself"));
}

#[test]
fn joined_logs_are_named_and_the_first_one_is_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, joined, first] =
        ["a.mcap", "joined.mcap", "b.mcap"].map(|name| folder.path().join(name));
    record(&path, 30, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("a log");
    std::fs::write(&joined, [&bytes[..], &bytes[..]].concat()).expect("written");
    let recovered = recover(&joined, &first).expect("recovered");
    assert!(!recovered.was_whole);
    assert!(
        recovered.lost[0].contains("joined logs"),
        "{:?}",
        recovered.lost
    );
    assert_eq!(read(&first).len(), 30);
    let log = LogReader::open(&joined).expect("a log");
    let error = log.filter_map(Result::err).next().expect("an error");
    assert!(format!("{error:#}").contains("joined logs"), "{error:#}");
}

#[test]
fn log_whose_index_is_cut_is_not_complete_and_recovered_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, cut, whole] = ["a.mcap", "cut.mcap", "b.mcap"].map(|name| folder.path().join(name));
    record(&path, 30, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("bytes");
    for missing in [1, 8, 30, 200] {
        std::fs::write(&cut, &bytes[..bytes.len() - missing]).expect("cut");
        let recovered = recover(&cut, &whole).expect("recovered");
        assert!(
            !recovered.was_whole && recovered.lost.is_empty(),
            "{missing}"
        );
        assert_eq!(read(&whole).len(), 30, "{missing}");
    }
    assert!(recover(&path, &whole).expect("recovered").was_whole);
}

#[test]
fn damaged_log_reports_the_offset_and_recover_skips_the_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, whole) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&path, 300, &LogConfig::default());
    let mut bytes = std::fs::read(&path).expect("bytes");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 16].fill(0x55);
    std::fs::write(&path, &bytes).expect("damaged");
    let message = read_error(&path);
    assert!(
        message.contains("is damaged at byte") && message.contains("mirrorball recover"),
        "{message}"
    );
    // The stamp as it was written: 0.3, not 0.30000000000000004.
    let (_, rest) = message.split_once("after the cycle at ").expect("a stamp");
    let (stamp, _) = rest.split_once(" s").expect("a stamp");
    let decimals = stamp.split_once('.').expect("decimals").1.len();
    assert!((3..=9).contains(&decimals), "{message}");
    let recovered = recover(&path, &whole).expect("recovered");
    assert_eq!(recovered.lost.len(), 1);
    let indices: Vec<u64> = read(&whole).iter().map(|logged| logged.index).collect();
    assert!(
        indices.len() > 200 && indices.last() == Some(&299),
        "{} cycles",
        indices.len()
    );
}

/// Start of the first chunk of a log, bytes.
fn first_chunk(bytes: &[u8]) -> usize {
    let summary = mcap::Summary::read(bytes).expect("readable");
    let chunks = summary.expect("a summary").chunk_indexes;
    let starts = chunks.iter().map(|chunk| chunk.chunk_start_offset);
    starts.min().expect("a chunk") as usize
}

#[test]
fn loss_of_the_first_chunk_loses_no_other_messages() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, whole] = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    record(&path, 300, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("a log");
    let chunk = first_chunk(&bytes);
    // A byte of the chunk's content, and lengths that are huge or wrong by 64 KiB.
    for (at, bit) in [(chunk + 200, 1), (chunk + 8, 0x40), (chunk + 3, 1)] {
        let mut damaged = bytes.clone();
        damaged[at] ^= bit;
        std::fs::write(&path, &damaged).expect("damaged");
        let recovered = recover(&path, &whole).expect("recovered");
        assert!(
            (1..=2).contains(&recovered.lost.len()),
            "{:?}",
            recovered.lost
        );
        let indices: Vec<u64> = read(&whole).iter().map(|logged| logged.index).collect();
        assert!(indices.len() > 200 && indices.last() == Some(&299), "{at}");
    }
}

#[test]
fn damaged_summary_is_not_used() {
    let folder = tempfile::tempdir().expect("a folder");
    let [path, whole] = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    record(&path, 300, &LogConfig::default());
    let mut bytes = std::fs::read(&path).expect("a log");
    let chunk = first_chunk(&bytes);
    bytes[chunk + 200] ^= 1;
    let topic = b"/pose";
    let last = bytes.windows(topic.len()).rposition(|part| part == topic);
    bytes[last.expect("a channel of the summary") + 1] ^= 1;
    std::fs::write(&path, &bytes).expect("damaged");
    let recovered = recover(&path, &whole).expect("recovered");
    assert_eq!(recovered.messages, 0);
    assert!(recovered.lost[1].contains("whose channel was in a lost part"));
}

#[test]
fn log_that_ends_within_a_file_of_its_set_up_is_called_truncated() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    record(&path, 3, &LogConfig::default());
    let bytes = std::fs::read(&path).expect("bytes");
    let name = b"robot.toml";
    let file = bytes
        .windows(name.len())
        .position(|window| window == name)
        .expect("an attachment");
    std::fs::write(&path, &bytes[..file + name.len() + 5]).expect("cut");
    let error = LogReader::open(&path).err().expect("cut");
    assert!(
        error
            .to_string()
            .contains("is truncated within the files of its set-up"),
        "{error:#}"
    );
}

#[test]
fn lost_file_of_the_set_up_is_named_with_what_needs_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, whole) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&path, 3, &LogConfig::default());
    let mut bytes = std::fs::read(&path).expect("bytes");
    let summary = mcap::Summary::read(&bytes).expect("readable").expect("one");
    let files = &mut summary.attachment_indexes.iter();
    let field = files.find(|file| file.name == "field.toml");
    let field = field.expect("an attachment");
    bytes[(field.offset + field.length) as usize - 20] ^= 1;
    std::fs::write(&path, &bytes).expect("damaged");
    let recovered = recover(&path, &whole).expect("recovered");
    assert!(!recovered.was_whole);
    let [damage, file] = &recovered.lost[..] else {
        panic!("{:?}", recovered.lost)
    };
    assert!(damage.contains("CRC"), "{damage}");
    assert!(
        file.starts_with("field.toml, a file of the set-up: replay"),
        "{file}"
    );
    let log = LogReader::open(&whole).expect("a log");
    let error = UnpackedSetup::load(log.header()).err().expect("no field");
    assert_eq!(
        error.to_string(),
        "the log has lost field.toml, which its robot.toml names as field"
    );
    assert_eq!(read(&whole).len(), 3);
}

#[test]
fn no_truncation_or_damage_panics() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    record(
        &path,
        3,
        &LogConfig {
            images: ImageCompression::None,
            ..LogConfig::default()
        },
    );
    let bytes = std::fs::read(&path).expect("bytes");
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for round in 0..400 {
        let mut broken = bytes.clone();
        if round % 2 == 0 {
            broken.truncate(rng.random_range(0..bytes.len()));
        }
        for _ in 0..round % 5 {
            if !broken.is_empty() {
                let at = rng.random_range(0..broken.len());
                broken[at] = rng.random();
            }
        }
        std::fs::write(&path, &broken).expect("written");
        if let Ok(log) = LogReader::open(&path) {
            log.for_each(drop);
        }
        let _ = recover(&path, &folder.path().join("b.mcap"));
    }
}

#[test]
fn foreign_file_and_unknown_log_format_are_rejected_with_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, "no log at all").expect("written");
    assert!(read_error(&path).ends_with("a.mcap is no MCAP file"));
    assert!(read_error(&folder.path().join("b.mcap")).contains("cannot read"));
    let mut foreign =
        mcap::Writer::new(std::fs::File::create(&path).expect("a file")).expect("a writer");
    foreign.finish().expect("finished");
    assert!(read_error(&path).contains("no log of mirrorball"));
    let mut other =
        mcap::Writer::new(std::fs::File::create(&path).expect("a file")).expect("a writer");
    let values = [("format", "99"), ("version", "7.1.0")]
        .map(|(key, value)| (key.to_owned(), value.to_owned()));
    other
        .write_metadata(&mcap::records::Metadata {
            name: "mirrorball".to_owned(),
            metadata: values.into(),
        })
        .expect("metadata");
    other.finish().expect("finished");
    let message = read_error(&path);
    assert!(
        message.contains("written by mirrorball 7.1.0 in log format 99"),
        "{message}"
    );
}

#[test]
fn write_failure_reports_the_io_error() {
    if !Path::new("/dev/full").exists() {
        return;
    }
    let created = Recorder::create(
        Path::new("/dev/full"),
        &Header::new("test", None),
        &field(),
        Pace::Live,
        &LogConfig::default(),
    );
    let message = format!("{:#}", created.map(|_| ()).expect_err("refused"));
    assert!(
        message.contains("cannot write /dev/full") && message.contains("No space left"),
        "{message}"
    );
}

/// Environment variable with the path of the log that the killed process writes.
const KILLED_LOG: &str = "MIRRORBALL_KILLED_LOG";

fn record_until_killed(path: &Path) {
    let config = LogConfig {
        flush_period: 0.1,
        ..LogConfig::default()
    };
    let header = Header::new("test", None);
    let mut recorder =
        Recorder::create(path, &header, &field(), Pace::Live, &config).expect("a recorder");
    // Bounded, so that the process ends even if it is not killed.
    for number in 0..4000 {
        recorder
            .record_cycle(Arc::new(random_cycle(number)))
            .expect("taken");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}

#[test]
fn a_log_whose_writer_is_killed_can_be_read() {
    // The process to be killed runs this test, too.
    if let Some(path) = std::env::var_os(KILLED_LOG) {
        return record_until_killed(Path::new(&path));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (path, whole) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let mut child = std::process::Command::new(std::env::current_exe().expect("this program"))
        .args([
            "--exact",
            "log::tests::broken::a_log_whose_writer_is_killed_can_be_read",
            "--nocapture",
        ])
        .env(KILLED_LOG, &path)
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("a process");
    // Waits for some flushes after the header. Their duration depends on the machine.
    let size = || std::fs::metadata(&path).map_or(0, |file| file.len());
    while size() < 400_000 && child.try_wait().expect("a state").is_none() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    let mut log = LogReader::open(&path).expect("a log");
    let cycles = log
        .by_ref()
        .map(|logged| logged.expect("a cycle").index)
        .collect::<Vec<_>>();
    assert_eq!(log.end(), Some(LogCompleteness::Truncated));
    assert!(
        cycles.len() > 10 && cycles.iter().copied().eq(0..cycles.len() as u64),
        "{}",
        cycles.len()
    );
    let recovered = recover(&path, &whole).expect("recovered");
    assert_eq!(
        recovered.until,
        Some(random_cycle(cycles.len() as u64 - 1).stamp)
    );
    assert_eq!(read(&whole).len(), cycles.len());
}

/// Environment variable with the path of the log whose disk is full early.
const FULL_DISK_LOG: &str = "MIRRORBALL_FULL_DISK_LOG";

fn record_on_full_disk(path: &Path) {
    let config = LogConfig {
        images: ImageCompression::Png,
        queue_images: 1000,
        queue_cycles: 1000,
        flush_period: 1000.0,
        ..LogConfig::default()
    };
    let header = Header::new("test", None);
    let mut recorder =
        Recorder::create(path, &header, &field(), Pace::Live, &config).expect("a recorder");
    for number in 0..300 {
        let _full = recorder.record_cycle(Arc::new(random_cycle(number)));
    }
    let (stats, closed) = recorder.finish_live();
    let message = format!("{:#}", closed.expect_err("a full disk"));
    assert!(message.contains("cannot write"), "{message}");
    let held = read(path);
    let images = held.iter().filter(|logged| logged.image.is_some()).count();
    assert!(held.len() > 20 && held.len() < 280, "{}", held.len());
    assert_eq!(stats.cycles, held.len() as u64);
    // The image of the next cycle may end the last chunk.
    assert!(
        [0, 1].contains(&(stats.images - images as u64)),
        "{stats:?}"
    );
    assert_eq!(stats.lost_from, Some(random_cycle(held.len() as u64).stamp));
}

#[test]
fn a_log_on_a_full_disk_counts_the_cycles_that_a_reader_finds() {
    // The process with small files runs this test, too.
    if let Some(path) = std::env::var_os(FULL_DISK_LOG) {
        return record_on_full_disk(Path::new(&path));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let test = "log::tests::broken::a_log_on_a_full_disk_counts_the_cycles_that_a_reader_finds";
    let limit = "trap '' XFSZ; ulimit -f 2500; exec \"$0\" --exact \"$1\"";
    let done = std::process::Command::new("sh")
        .args(["-c", limit])
        .arg(std::env::current_exe().expect("this program"))
        .arg(test)
        .env(FULL_DISK_LOG, &path)
        .output()
        .expect("a process");
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stdout)
    );
    assert!(path.exists());
}

/// Writes an MCAP file of one chunk with a channel and messages of zeros, compressed, with or without a checksum.
fn write_bomb(path: &Path, message_bytes: usize, messages: u64, checksum: bool) {
    let file = std::fs::File::create(path).expect("a file");
    let options = mcap::WriteOptions::new()
        .chunk_size(None)
        .calculate_chunk_crcs(checksum)
        .compression_threads(0)
        .emit_message_indexes(false);
    let mut writer = options.create(file).expect("a writer");
    let header = Header::new("test", None);
    writer
        .write_metadata(&mcap::records::Metadata {
            name: "mirrorball".to_owned(),
            metadata: header.metadata(),
        })
        .expect("metadata");
    let channel = writer
        .add_channel(0, "/cycle", "protobuf", &Default::default())
        .expect("a channel");
    let data = vec![0; message_bytes];
    for number in 0..messages {
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: number,
            publish_time: number,
        };
        writer
            .write_to_known_channel(&header, &data)
            .expect("written");
    }
    writer.finish().expect("finished");
}

#[test]
fn chunk_that_unpacks_to_far_more_than_its_size_is_refused_by_every_reader() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bomb.mcap");
    for checksum in [false, true] {
        write_bomb(&path, 1024 * 1024, 100, checksum);
        assert!(std::fs::metadata(&path).expect("a file").len() < 100_000);
        let message = read_error(&path);
        assert!(message.contains("unpacks to"), "{message}");
        let recovered = recover(&path, &folder.path().join("b.mcap")).expect("recovered");
        assert_eq!(recovered.messages, 0);
        let index = LogIndex::open(&path).expect("an index");
        assert!(index.load(0).is_err());
    }
}

#[test]
fn log_naming_a_file_outside_itself_is_refused() {
    for (robot, key) in [
        ("field = \"/etc/shadow\"\n", "field"),
        ("field = \"field.toml\"\nmask = \"../mask.png\"\n", "mask"),
        (
            "field = \"field.toml\"\n[map]\nfile = \"/dev/zero\"\n",
            "map.file",
        ),
    ] {
        let header = Header::new("test", None)
            .with_file("robot.toml", robot)
            .with_file("field.toml", "");
        let folder = tempfile::tempdir().expect("a folder");
        let error = format!(
            "{:#}",
            header.write_files(folder.path()).expect_err("refused")
        );
        assert!(error.contains(&format!("robot.toml: {key} = ")), "{error}");
        assert_eq!(
            std::fs::read_dir(folder.path()).expect("a folder").count(),
            0
        );
    }
}

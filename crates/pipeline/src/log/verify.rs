//! Does the same input give the same bits? The cycles of a log are recomputed and compared.

use anyhow::{Result, bail};
use localize::Stamp;
use prost::Message;

use super::encoded_image::ImageCompression;
use super::mcap_records::LogCompleteness;
use super::read::LogReader;
#[cfg(doc)]
use super::read::LoggedCycle;
use super::schema::{convert, wire};
use crate::cycle::Cycle;
use crate::sample::Sample;

/// The first quantity in which two cycles differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Stamp of the cycle.
    pub stamp: Stamp,
    /// Name of the value.
    pub quantity: String,
    /// Value in the log.
    pub recorded: String,
    /// Recomputed value.
    pub computed: String,
}

/// Result of a verification.
#[derive(Debug, Clone, PartialEq)]
pub struct VerificationReport {
    /// Cycles whose estimate was recomputed.
    pub cycles: u64,
    /// Cycles whose detections were recomputed as well.
    pub vision_cycles: u64,
    /// Cycles that differ.
    pub different: u64,
    /// The first difference.
    pub first_difference: Option<Difference>,
    /// Stamp of the first cycle after a dropped one. From there on the log lacks inputs, until a cycle holds its state.
    pub gap: Option<Stamp>,
    /// Stamps of the cycles after gaps that hold the state from which replay goes on.
    pub resumed: Vec<Stamp>,
    /// Cycles between a gap and the next cycle that holds its state.
    pub unverified: u64,
    /// How the log ended.
    pub end: LogCompleteness,
}

/// Recomputes every cycle of a log and compares it bit by bit.
///
/// `process` is a fresh pipeline built from the log's own files: samples in, a cycle after each image. Vision is
/// recomputed until an image is missing or lossy. After that the colour model may differ.
///
/// After a gap, verification goes on at the next cycle that holds the state of the pipeline: [`LoggedCycle::starts_replay`].
pub fn verify(
    mut log: LogReader,
    mut process: impl FnMut(Sample) -> Option<Cycle>,
) -> Result<VerificationReport> {
    let (mut cycles, mut vision_cycles, mut different, mut unverified) = (0, 0, 0, 0);
    let (mut first, mut gap, mut resumed) = (None, None, Vec::new());
    // Index of the next cycle that can be computed again; None behind a gap.
    let mut next_index = Some(0);
    let compare_world = log.header().has_comparable_world();
    let lossless = log.header().images == ImageCompression::Png;
    let mut pixels = lossless;
    for logged in log.by_ref() {
        let logged = logged?;
        if next_index != Some(logged.index) {
            gap = gap.or(Some(logged.cycle.stamp));
            next_index = None;
            if !logged.starts_replay() {
                unverified += 1;
                continue;
            }
            resumed.push(logged.cycle.stamp);
            pixels = lossless;
        }
        next_index = Some(logged.index + 1);
        pixels &= logged.image.is_some() || logged.cycle.detections.is_none();
        let mut computed = None;
        for sample in logged.samples(pixels)? {
            computed = process(sample);
        }
        let Some(computed) = computed else {
            bail!("an image of the log gave no cycle")
        };
        cycles += 1;
        vision_cycles += u64::from(pixels && computed.detections.is_some());
        if let Some(difference) = first_difference(&logged.cycle, &computed, compare_world) {
            different += 1;
            first.get_or_insert(difference);
        }
    }
    let end = log.end().unwrap_or(LogCompleteness::Truncated);
    Ok(VerificationReport {
        cycles,
        vision_cycles,
        different,
        first_difference: first,
        gap,
        resumed,
        unverified,
        end,
    })
}

/// The first difference between two cycles, in the order of the stages. Timings are not compared.
///
/// Detections are compared if both cycles hold them, world and team if `compare_world`.
pub(super) fn first_difference(
    recorded: &Cycle,
    computed: &Cycle,
    compare_world: bool,
) -> Option<Difference> {
    let difference = |quantity: &str, recorded: String, computed: String, stamp: Stamp| {
        Some(Difference {
            stamp,
            quantity: quantity.to_owned(),
            recorded,
            computed,
        })
    };
    let stamp = recorded.stamp;
    // The message of a cycle contains every value without rounding.
    let [ours, theirs] = [recorded, computed].map(|cycle| convert::cycle_to_wire(0, cycle, ""));
    for (quantity, a, b) in comparable_values(&ours, &theirs, compare_world) {
        if a.0 != b.0 {
            let (recorded, computed) = different_lines(&a.1, &b.1);
            return difference(quantity, recorded, computed, stamp);
        }
    }
    None
}

/// The first value in which two descriptions differ, a value per line.
fn different_lines(ours: &str, theirs: &str) -> (String, String) {
    let mut lines = ours.lines().zip(theirs.lines());
    let text = |line: &str| match line.trim().trim_end_matches(',') {
        "None" => "none".to_owned(),
        "Some(" => "a value".to_owned(),
        // The end of a list that is shorter than the other one.
        "]" | ")" | "}" => "no further value".to_owned(),
        opening if opening.ends_with('{') => "a further value".to_owned(),
        value => value.to_owned(),
    };
    match lines.find(|(ours, theirs)| ours != theirs) {
        Some((ours, theirs)) => (text(ours), text(theirs)),
        // Values that a summary does not show.
        None => (
            text(ours.lines().next().unwrap_or_default()),
            "other values".to_owned(),
        ),
    }
}

/// Bytes to compare, and a description for people.
type ComparableValue = (Vec<u8>, String);

fn comparable_values(
    ours: &wire::Cycle,
    theirs: &wire::Cycle,
    compare_world: bool,
) -> Vec<(&'static str, ComparableValue, ComparableValue)> {
    let (a, b) = (ours, theirs);
    let text = |value: &dyn std::fmt::Debug| {
        let text = format!("{value:#?}");
        (text.clone().into_bytes(), text)
    };
    let mut parts = vec![
        ("stamp", text(&a.stamp_ns), text(&b.stamp_ns)),
        ("fault", text(&a.fault), text(&b.fault)),
    ];
    if let (Some(a), Some(b)) = (&a.seen, &b.seen) {
        let brief = |detections: &wire::Detections| {
            let wire::Detections {
                points,
                refused_reason,
                carpet_share,
                ..
            } = detections;
            let summary = format!(
                "{} points, {} refused, carpet {carpet_share}",
                points.x.len(),
                refused_reason.len()
            );
            (detections.encode_to_vec(), summary)
        };
        parts.push(("detections", brief(a), brief(b)));
    }
    let brief =
        |points: &wire::LinePoints| (points.encode_to_vec(), format!("{} points", points.x.len()));
    parts.push(("line points", brief(&a.points), brief(&b.points)));
    let (a, b) = (&a.estimate, &b.estimate);
    parts.extend([
        ("mode", text(&a.mode), text(&b.mode)),
        ("reason", text(&a.reason), text(&b.reason)),
        ("pose", text(&a.pose), text(&b.pose)),
        ("covariance", text(&a.covariance), text(&b.covariance)),
        ("runners-up", text(&a.runners_up), text(&b.runners_up)),
    ]);
    let whole = |estimate: &wire::Estimate| (estimate.encode_to_vec(), format!("{estimate:#?}"));
    parts.push(("estimate", whole(a), whole(b)));
    if compare_world {
        parts.push(("world", text(&ours.world), text(&theirs.world)));
        parts.push(("team", text(&ours.team), text(&theirs.team)));
    }
    parts
}

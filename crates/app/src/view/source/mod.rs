//! Sources of cycles: a log, the view's own simulation, a run in this process, or a remote robot.

pub(crate) mod live;
pub(crate) mod log;
pub(crate) mod metrics_reader;
pub(crate) mod recompute;
pub(crate) mod remote;
pub(crate) mod sim_worker;

use std::sync::Arc;

use localize::Pose;
use vision::image::Image;

use pipeline::Cycle;
use pipeline::sample::SourceImage;

/// A cycle with its image decoded.
#[derive(Debug, Clone)]
pub(crate) struct DecodedCycle {
    /// Inputs and results.
    pub(crate) cycle: Arc<Cycle>,
    /// Particles of the global search; empty if it is not running or the source does not provide them.
    pub(crate) particles: Vec<Pose>,
}

impl DecodedCycle {
    /// Converts a raw camera image to RGB, in the delivering thread.
    pub(crate) fn new(mut cycle: Arc<Cycle>, particles: Vec<Pose>) -> Self {
        if let Some(SourceImage::Raw(_)) = &cycle.inputs.image {
            let cycle = Arc::make_mut(&mut cycle);
            let rgb = cycle.inputs.image.as_ref().and_then(SourceImage::to_rgb);
            cycle.inputs.image = rgb.map(SourceImage::Rgb);
        }
        DecodedCycle { cycle, particles }
    }
}

/// The RGB image of a cycle.
pub(crate) fn rgb_image(cycle: &Cycle) -> Option<&Arc<Image>> {
    match &cycle.inputs.image {
        Some(SourceImage::Rgb(image)) => Some(image),
        _ => None,
    }
}

/// A source of cycles.
pub(crate) enum Source {
    /// No source.
    Empty,
    /// A log.
    Log(Box<log::LogPlayer>),
    /// A live source, which runs on its own.
    Live(Box<live::LiveSource>),
}

impl Source {
    /// First and last time that can be shown, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        match self {
            Source::Empty => None,
            Source::Log(player) => Some(player.span()),
            Source::Live(live) => live.span(),
        }
    }

    /// The cycle to show at a time: the last one at or before it, else the first.
    pub(crate) fn seek(&mut self, time: f64) -> anyhow::Result<Option<DecodedCycle>> {
        match self {
            Source::Empty => Ok(None),
            Source::Log(player) => player.seek(time),
            Source::Live(live) => Ok(live.seek(time)),
        }
    }

    /// The cycle `by` cycles after (negative: before) the one shown last.
    pub(crate) fn step(&mut self, by: i64) -> anyhow::Result<Option<DecodedCycle>> {
        match self {
            Source::Empty => Ok(None),
            Source::Log(player) => player.step(by),
            Source::Live(live) => Ok(live.step(by)),
        }
    }

    /// The simulation, if the view owns it.
    pub(crate) fn simulation(&self) -> Option<&sim_worker::SimWorker> {
        match self {
            Source::Live(live) => live.worker(),
            _ => None,
        }
    }
}

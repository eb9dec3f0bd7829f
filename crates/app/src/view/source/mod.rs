//! Where do the view's cycles come from? A log that is played, or something live: a simulation of its own, a run beside.

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

/// A cycle as it is shown, its image unpacked.
#[derive(Debug, Clone)]
pub(crate) struct DecodedCycle {
    /// What came in and what was found.
    pub(crate) cycle: Arc<Cycle>,
    /// Particles of the relocaliser, where it has some and the source tells them.
    pub(crate) particles: Vec<Pose>,
}

impl DecodedCycle {
    /// A camera's own bytes become red, green and blue here, in the thread that brings them.
    pub(crate) fn new(mut cycle: Arc<Cycle>, particles: Vec<Pose>) -> Self {
        if let Some(SourceImage::Raw(_)) = &cycle.inputs.image {
            let cycle = Arc::make_mut(&mut cycle);
            let rgb = cycle.inputs.image.as_ref().and_then(SourceImage::to_rgb);
            cycle.inputs.image = rgb.map(SourceImage::Rgb);
        }
        DecodedCycle { cycle, particles }
    }
}

/// The image of a cycle that is shown.
pub(crate) fn rgb_image(cycle: &Cycle) -> Option<&Arc<Image>> {
    match &cycle.inputs.image {
        Some(SourceImage::Rgb(image)) => Some(image),
        _ => None,
    }
}

/// A source of cycles.
pub(crate) enum Source {
    /// None yet.
    Empty,
    /// A log.
    Log(Box<log::LogPlayer>),
    /// Something that goes on whether it is looked at or not.
    Live(Box<live::LiveSource>),
}

impl Source {
    /// First and last moment that can be shown, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        match self {
            Source::Empty => None,
            Source::Log(player) => Some(player.span()),
            Source::Live(live) => live.span(),
        }
    }

    /// The cycle shown at a moment: the last one at or before it, else the first.
    pub(crate) fn seek(&mut self, time: f64) -> anyhow::Result<Option<DecodedCycle>> {
        match self {
            Source::Empty => Ok(None),
            Source::Log(player) => player.seek(time),
            Source::Live(live) => Ok(live.seek(time)),
        }
    }

    /// So many cycles on (or back) from the one shown last.
    pub(crate) fn step(&mut self, by: i64) -> anyhow::Result<Option<DecodedCycle>> {
        match self {
            Source::Empty => Ok(None),
            Source::Log(player) => player.step(by),
            Source::Live(live) => Ok(live.step(by)),
        }
    }

    /// The simulation that the view owns.
    pub(crate) fn simulation(&self) -> Option<&sim_worker::SimWorker> {
        match self {
            Source::Live(live) => live.worker(),
            _ => None,
        }
    }
}

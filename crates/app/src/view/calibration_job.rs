//! Runs a map calibration beside the view: it takes from seconds to minutes.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::Result;
use vision::calibrate::ImageResidual;

use crate::commands::calibrate::{self, LinesArgs, MapArgs, Outcome};

/// What to calibrate from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum CalibrationMethod {
    /// Images of a strip of bars.
    #[default]
    Strip,
    /// The same, with the mirror's profile trusted.
    StripWithProfile,
    /// A drive over the field.
    Lines,
}

/// What came of it: the summary, and image by image.
pub(crate) type MapCalibration = (Outcome, Vec<ImageResidual>);

/// A calibration under way.
pub(crate) struct CalibrationJob(Receiver<Result<MapCalibration>>);

impl CalibrationJob {
    /// Starts a calibration of a folder; the map goes to `out`.
    pub(crate) fn start(
        kind: CalibrationMethod,
        dir: PathBuf,
        out: PathBuf,
    ) -> std::io::Result<Self> {
        let (sender, receiver) = sync_channel(1);
        std::thread::Builder::new()
            .name("calibrate".to_owned())
            .spawn(move || {
                let picture = None;
                let found = match kind {
                    CalibrationMethod::Lines => calibrate::calibrate_map_from_lines(&LinesArgs {
                        dir,
                        map: None,
                        out,
                        picture,
                    }),
                    CalibrationMethod::Strip | CalibrationMethod::StripWithProfile => {
                        calibrate::calibrate_map(&MapArgs {
                            dir,
                            out,
                            picture,
                            profile: kind == CalibrationMethod::StripWithProfile,
                        })
                    }
                };
                // The panel may be gone.
                let _ = sender.send(found);
            })?;
        Ok(CalibrationJob(receiver))
    }

    /// What came of it, once.
    pub(crate) fn poll(&self) -> Option<Result<MapCalibration>> {
        match self.0.try_recv() {
            Ok(found) => Some(found),
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                Some(Err(anyhow::anyhow!("the calibration broke off")))
            }
        }
    }
}

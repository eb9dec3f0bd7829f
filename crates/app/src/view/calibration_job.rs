//! Runs a map calibration in a separate thread: it takes from seconds to minutes.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::Result;
use vision::calibrate::ImageResidual;

use crate::commands::calibrate::{self, LinesArgs, MapArgs, Outcome};

/// Input of the calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum CalibrationMethod {
    /// Images of a bar strip.
    #[default]
    Strip,
    /// Images of a bar strip, with the mirror profile held fixed.
    StripWithProfile,
    /// Images and field lines of a drive over the field.
    Lines,
}

/// Result of a calibration: summary, and residuals per image.
pub(crate) type MapCalibration = (Outcome, Vec<ImageResidual>);

/// A running calibration.
pub(crate) struct CalibrationJob(Receiver<Result<MapCalibration>>);

impl CalibrationJob {
    /// Starts a calibration from the images in `dir`; the map is written to `out`.
    pub(crate) fn start(
        method: CalibrationMethod,
        dir: PathBuf,
        out: PathBuf,
    ) -> std::io::Result<Self> {
        let (sender, receiver) = sync_channel(1);
        std::thread::Builder::new()
            .name("calibrate".to_owned())
            .spawn(move || {
                let picture = None;
                let result = match method {
                    CalibrationMethod::Lines => calibrate::calibrate_map_from_lines(&LinesArgs {
                        dir,
                        map: None,
                        from_nothing: false,
                        fit_field: None,
                        out,
                        picture,
                    }),
                    CalibrationMethod::Strip | CalibrationMethod::StripWithProfile => {
                        calibrate::calibrate_map(&MapArgs {
                            dir,
                            out,
                            picture,
                            profile: method == CalibrationMethod::StripWithProfile,
                        })
                    }
                };
                // The receiver is gone if the panel was closed.
                let _ = sender.send(result);
            })?;
        Ok(CalibrationJob(receiver))
    }

    /// The result, returned once when the calibration ends.
    pub(crate) fn poll(&self) -> Option<Result<MapCalibration>> {
        match self.0.try_recv() {
            Ok(result) => Some(result),
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                Some(Err(anyhow::anyhow!("the calibration thread panicked")))
            }
        }
    }
}

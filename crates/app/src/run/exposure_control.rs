//! How do the commands of the exposure control reach the camera?

use hw::{CameraDriver, Devices};
use localize::robot::{CameraControl, ExposureSetting};
use vision::exposure::ExposureCommand;

/// Passes the commands of the exposure control to the camera.
pub(super) struct ExposureControl<'a> {
    camera: Option<(&'a CameraDriver, CameraControl)>,
}

impl<'a> ExposureControl<'a> {
    /// Sets the camera to the first setting of robot.toml's `[exposure]`. Without it the camera is not controlled.
    pub(super) fn start(devices: &'a Devices, control: Option<CameraControl>) -> Self {
        let camera = devices.camera.as_ref().zip(control);
        if let Some((camera, control)) = &camera {
            let first = ExposureSetting {
                exposure: control.exposure,
                gain: control.gain,
            };
            camera.set_exposure(first, control.delay_frames);
        }
        ExposureControl { camera }
    }

    /// Sends a command, if there is one.
    pub(super) fn command_camera(&self, command: Option<ExposureCommand>) {
        if let (Some(command), Some((camera, control))) = (command, &self.camera) {
            camera.set_exposure(command.setting, control.delay_frames);
        }
    }
}

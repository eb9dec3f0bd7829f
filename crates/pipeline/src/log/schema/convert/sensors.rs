//! How are readings of virtual sensors and exposure converted to their messages and back?

use anyhow::{Context, Result};
use localize::robot::ExposureSetting;
use vision::exposure::{ExposureCommand, ExposureStatus};
use vision::objects::virtual_sensors::{Bumper, VirtualSensorReadings};

use super::super::wire;
use super::geometry::same_length;

pub(crate) fn windows_to_wire(readings: &VirtualSensorReadings) -> wire::Windows {
    let VirtualSensorReadings {
        bumpers,
        blue_goal_px,
        yellow_goal_px,
        ball_px,
        kick,
        lens_px,
        lens_centred,
    } = readings;
    let place = |at: &Option<[f32; 2]>| at.map_or_else(Vec::new, |at| at.to_vec());
    wire::Windows {
        bumper_share: bumpers.iter().map(|bumper| bumper.share).collect(),
        bumper_hit: bumpers.iter().map(|bumper| bumper.hit).collect(),
        blue_goal_px: place(blue_goal_px),
        yellow_goal_px: place(yellow_goal_px),
        ball_px: place(ball_px),
        kick: *kick,
        lens_px: place(lens_px),
        lens_centred: *lens_centred,
    }
}

pub(super) fn windows_from_wire(readings: wire::Windows) -> Result<VirtualSensorReadings> {
    let (shares, hits) = (readings.bumper_share, readings.bumper_hit);
    same_length("bumpers", &[shares.len(), hits.len()])?;
    let bumpers = shares.into_iter().zip(hits);
    Ok(VirtualSensorReadings {
        bumpers: bumpers.map(|(share, hit)| Bumper { share, hit }).collect(),
        blue_goal_px: place(&readings.blue_goal_px)?,
        yellow_goal_px: place(&readings.yellow_goal_px)?,
        ball_px: place(&readings.ball_px)?,
        kick: readings.kick,
        lens_px: place(&readings.lens_px)?,
        lens_centred: readings.lens_centred,
    })
}

fn place(values: &[f32]) -> Result<Option<[f32; 2]>> {
    if values.is_empty() {
        return Ok(None);
    }
    let pair = values
        .try_into()
        .context("a place of the log has not 2 numbers")?;
    Ok(Some(pair))
}

pub(crate) fn exposure_to_wire(reading: &ExposureStatus) -> wire::Exposure {
    let &ExposureStatus {
        entropy,
        centre_brightness: level,
        applied_setting: in_force,
        searching,
        command,
        setting_changed_brightness: light_jumped,
        uncontrolled_light_change: warning,
    } = reading;
    wire::Exposure {
        entropy,
        level,
        exposure: in_force.map(|setting| setting.exposure),
        gain: in_force.map(|setting| setting.gain),
        searching,
        command_exposure: command.map(|command| command.setting.exposure),
        command_gain: command.map(|command| command.setting.gain),
        command_from_frame: command.map_or(0, |command| command.from_frame),
        light_jumped,
        warning,
    }
}

/// A setting of the camera, if both values are there.
pub(super) fn camera_setting(exposure: Option<f32>, gain: Option<f32>) -> Option<ExposureSetting> {
    Some(ExposureSetting {
        exposure: exposure?,
        gain: gain?,
    })
}

pub(super) fn exposure_from_wire(reading: &wire::Exposure) -> ExposureStatus {
    ExposureStatus {
        entropy: reading.entropy,
        centre_brightness: reading.level,
        applied_setting: camera_setting(reading.exposure, reading.gain),
        searching: reading.searching,
        command: camera_setting(reading.command_exposure, reading.command_gain).map(|setting| {
            ExposureCommand {
                setting,
                from_frame: reading.command_from_frame,
            }
        }),
        setting_changed_brightness: reading.light_jumped,
        uncontrolled_light_change: reading.warning,
    }
}

//! Which values of which controls make a V4L2 device take images as configured? Settings and limits in, values out.
//!
//! No calls of the kernel are here, so that the translation is tested without a device.

use localize::robot::ExposureSetting;

use super::settings::CameraSettings;
use super::sys;

/// Control identifiers (linux/v4l2-controls.h).
pub(super) const EXPOSURE_AUTO: u32 = 0x009A_0901;
pub(super) const EXPOSURE_ABSOLUTE: u32 = 0x009A_0902;
pub(super) const EXPOSURE_AUTO_PRIORITY: u32 = 0x009A_0903;
pub(super) const AUTO_WHITE_BALANCE: u32 = 0x0098_090C;
pub(super) const AUTOGAIN: u32 = 0x0098_0912;
pub(super) const GAIN: u32 = 0x0098_0913;
pub(super) const WHITE_BALANCE_TEMPERATURE: u32 = 0x0098_091A;
/// Values of EXPOSURE_AUTO.
const EXPOSURE_AUTOMATIC: i32 = 0;
const EXPOSURE_MANUAL: i32 = 1;
const EXPOSURE_APERTURE: i32 = 3;
/// Unit of V4L2's absolute exposure, seconds.
const EXPOSURE_UNIT: f32 = 1e-4;

/// A control to set; `required_as` is its name if the user configured it, so that a refusal is an error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ControlValue {
    pub(super) id: u32,
    pub(super) value: i32,
    pub(super) required_as: Option<&'static str>,
}

/// The controls in the order in which they must be set: automatic modes first, or they would override the values.
///
/// The values are not limited yet.
pub(super) fn control_sequence(settings: &CameraSettings) -> Vec<ControlValue> {
    let control = |id, value, required_as| ControlValue {
        id,
        value,
        required_as,
    };
    let automatic = |on: bool| i32::from(on);
    // Otherwise a webcam lowers its rate in the dark.
    let mut controls = vec![control(EXPOSURE_AUTO_PRIORITY, 0, None)];
    // A device has one of the two automatic modes and refuses the other: webcams the second, others the first.
    let modes: &[i32] = match settings.exposure {
        Some(_) => &[EXPOSURE_MANUAL],
        None => &[EXPOSURE_AUTOMATIC, EXPOSURE_APERTURE],
    };
    controls.extend(modes.iter().map(|mode| control(EXPOSURE_AUTO, *mode, None)));
    controls.extend([
        control(AUTOGAIN, automatic(settings.gain.is_none()), None),
        control(
            AUTO_WHITE_BALANCE,
            automatic(settings.white_balance_k.is_none()),
            None,
        ),
    ]);
    controls.extend(settings.exposure.map(|seconds| {
        let value = (seconds / EXPOSURE_UNIT).round().max(1.0) as i32;
        control(EXPOSURE_ABSOLUTE, value, Some("exposure"))
    }));
    controls.extend(
        settings
            .gain
            .map(|gain| control(GAIN, gain.round() as i32, Some("gain"))),
    );
    controls.extend(
        settings
            .white_balance_k
            .map(|kelvin| control(WHITE_BALANCE_TEMPERATURE, kelvin, Some("white balance"))),
    );
    controls
}

/// The value nearest to `value` that the device takes. None if the control cannot be set.
pub(super) fn value_in_range(value: i32, range: &sys::ControlRange) -> Option<i32> {
    if range.flags & (sys::CONTROL_DISABLED | sys::CONTROL_READ_ONLY) != 0 {
        return None;
    }
    let minimum = i64::from(range.minimum);
    let step = i64::from(range.step.max(1));
    // The maximum need not be a whole number of steps above the minimum.
    let steps_max = (i64::from(range.maximum) - minimum).div_euclid(step).max(0);
    let steps = (i64::from(value) - minimum + step / 2).div_euclid(step);
    Some((minimum + steps.clamp(0, steps_max) * step) as i32)
}

/// Exposure and gain in force, by the values of their controls. None if the device lacks one of them.
pub(super) fn setting_from_values(
    exposure: Option<i32>,
    gain: Option<i32>,
) -> Option<ExposureSetting> {
    Some(ExposureSetting {
        exposure: exposure? as f32 * EXPOSURE_UNIT,
        gain: gain? as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// A device that treats controls as the kernel's drivers do: a value out of its range is limited, but a menu refuses
    /// entries that it does not have, and so do controls that are not there or cannot be set.
    struct Device {
        ranges: BTreeMap<u32, sys::ControlRange>,
        /// Entries of the menu EXPOSURE_AUTO.
        exposure_modes: &'static [i32],
        values: BTreeMap<u32, i32>,
        /// Names of required controls that were refused.
        refused: Vec<&'static str>,
    }

    impl Device {
        /// `ranges`: identifier, minimum, maximum, step, default and flags of struct v4l2_queryctrl.
        fn new(
            exposure_modes: &'static [i32],
            ranges: &[(u32, i32, i32, i32, i32, u32)],
        ) -> Device {
            let ranges: BTreeMap<_, _> = ranges
                .iter()
                .map(|(id, minimum, maximum, step, default, flags)| {
                    let range = sys::ControlRange {
                        id: *id,
                        minimum: *minimum,
                        maximum: *maximum,
                        step: *step,
                        default: *default,
                        flags: *flags,
                        ..sys::ControlRange::default()
                    };
                    (*id, range)
                })
                .collect();
            Device {
                values: ranges.iter().map(|(id, r)| (*id, r.default)).collect(),
                ranges,
                exposure_modes,
                refused: Vec::new(),
            }
        }

        /// A USB webcam (uvcvideo): 100 µs to 0.5 s, automatic by aperture priority. Values that are automatic are
        /// inactive (flag 0x10) until then.
        fn webcam() -> Device {
            Device::new(
                &[EXPOSURE_MANUAL, EXPOSURE_APERTURE],
                &[
                    (AUTO_WHITE_BALANCE, 0, 1, 1, 1, 0),
                    (GAIN, 0, 100, 1, 0, 0),
                    (WHITE_BALANCE_TEMPERATURE, 2800, 6500, 1, 4600, 0x10),
                    (EXPOSURE_AUTO, 0, 3, 1, 3, 0),
                    (EXPOSURE_ABSOLUTE, 1, 5000, 1, 156, 0x10),
                    (EXPOSURE_AUTO_PRIORITY, 0, 1, 1, 0, 0),
                ],
            )
        }

        /// A webcam with coarse steps, whose maximum is not on one of them.
        fn coarse() -> Device {
            let mut device = Device::webcam();
            let exposure = device.ranges.get_mut(&EXPOSURE_ABSOLUTE).expect("there");
            (exposure.minimum, exposure.maximum, exposure.step) = (5, 20_000, 10);
            let gain = device.ranges.get_mut(&GAIN).expect("there");
            (gain.minimum, gain.maximum, gain.step) = (16, 128, 16);
            device
        }

        /// A sensor on a ribbon cable (bcm2835-camera): automatic or manual exposure and no gain.
        fn without_gain() -> Device {
            Device::new(
                &[EXPOSURE_AUTOMATIC, EXPOSURE_MANUAL],
                &[
                    (EXPOSURE_AUTO, 0, 3, 1, 0, 0),
                    (EXPOSURE_ABSOLUTE, 1, 10_000, 1, 1000, 0),
                    (EXPOSURE_AUTO_PRIORITY, 0, 1, 1, 0, 0),
                ],
            )
        }

        fn write(&mut self, control: ControlValue) -> Option<()> {
            let range = self.ranges.get(&control.id)?;
            let value = value_in_range(control.value, range)?;
            let on_grid = (i64::from(value) - i64::from(range.minimum)) % i64::from(range.step);
            assert!(
                on_grid == 0 && value >= range.minimum && value <= range.maximum,
                "{value}"
            );
            let is_mode = control.id == EXPOSURE_AUTO;
            if is_mode && !self.exposure_modes.contains(&value) {
                return None;
            }
            self.values.insert(control.id, value);
            Some(())
        }

        fn apply(&mut self, settings: &CameraSettings) -> Option<ExposureSetting> {
            for control in control_sequence(settings) {
                let written = self.write(control);
                let required = control.required_as.filter(|_| written.is_none());
                self.refused.extend(required);
            }
            let value = |id| self.values.get(&id).copied();
            setting_from_values(value(EXPOSURE_ABSOLUTE), value(GAIN))
        }
    }

    fn fixed(exposure: f32, gain: f32) -> CameraSettings {
        CameraSettings {
            exposure: Some(exposure),
            gain: Some(gain),
            white_balance_k: None,
        }
    }

    #[test]
    fn auto_controls_are_disabled_before_manual_values_and_stay_on_otherwise() {
        let settings = CameraSettings {
            exposure: Some(0.0125),
            gain: None,
            white_balance_k: Some(4500),
        };
        let controls: Vec<_> = control_sequence(&settings)
            .iter()
            .map(|c| (c.id, c.value))
            .collect();
        let expected = [
            (EXPOSURE_AUTO_PRIORITY, 0),
            (EXPOSURE_AUTO, EXPOSURE_MANUAL),
            (AUTOGAIN, 1),
            (AUTO_WHITE_BALANCE, 0),
            (EXPOSURE_ABSOLUTE, 125),
            (WHITE_BALANCE_TEMPERATURE, 4500),
        ];
        assert_eq!(controls, expected);
    }

    #[test]
    fn what_is_in_force_is_the_nearest_value_within_limits_and_steps() {
        for (device, wanted, in_force) in [
            // Units of 100 µs.
            (Device::webcam(), (0.012_34, 40.4), (0.0123, 40.0)),
            (Device::webcam(), (0.0, -5.0), (1e-4, 0.0)),
            (Device::webcam(), (1e-5, 0.0), (1e-4, 0.0)),
            (Device::webcam(), (1e9, 1e9), (0.5, 100.0)),
            (Device::webcam(), (f32::INFINITY, 255.0), (0.5, 100.0)),
            (Device::coarse(), (0.0101, 30.0), (0.0105, 32.0)),
            (Device::coarse(), (0.0, 0.0), (5e-4, 16.0)),
            // The last step below the maximum of 2 s.
            (Device::coarse(), (5.0, 1000.0), (1.9995, 128.0)),
        ] {
            let mut device = device;
            let setting = device.apply(&fixed(wanted.0, wanted.1)).expect("reported");
            let error = (setting.exposure - in_force.0).abs();
            assert!(error < 1e-6, "{wanted:?}: {setting:?}");
            assert_eq!(setting.gain, in_force.1, "{wanted:?}");
            assert!(device.refused.is_empty(), "{:?}", device.refused);
            assert_eq!(device.values[&EXPOSURE_AUTO], EXPOSURE_MANUAL);
        }
    }

    #[test]
    fn exposure_becomes_automatic_again_on_either_kind_of_device() {
        for (mut device, automatic) in [
            (Device::webcam(), EXPOSURE_APERTURE),
            (Device::without_gain(), EXPOSURE_AUTOMATIC),
        ] {
            device.apply(&fixed(0.01, 1.0));
            assert_eq!(device.values[&EXPOSURE_AUTO], EXPOSURE_MANUAL);
            device.apply(&CameraSettings::default());
            assert_eq!(device.values[&EXPOSURE_AUTO], automatic);
        }
    }

    #[test]
    fn controls_that_are_missing_or_cannot_be_set_are_named() {
        let mut device = Device::without_gain();
        let setting = device.apply(&fixed(0.02, 3.0));
        assert_eq!((setting, device.refused), (None, vec!["gain"]));
        assert_eq!(device.values[&EXPOSURE_ABSOLUTE], 200);
        for flag in [sys::CONTROL_DISABLED, sys::CONTROL_READ_ONLY] {
            let mut device = Device::webcam();
            device
                .ranges
                .get_mut(&EXPOSURE_ABSOLUTE)
                .expect("there")
                .flags = flag;
            let setting = device.apply(&fixed(0.02, 3.0)).expect("reported");
            // What the device reports stays true.
            assert_eq!((setting.exposure, setting.gain), (0.0156, 3.0));
            assert_eq!(device.refused, ["exposure"]);
        }
    }

    #[test]
    fn extreme_ranges_do_not_overflow() {
        let range = sys::ControlRange {
            minimum: i32::MIN,
            maximum: i32::MAX,
            step: i32::MAX,
            ..sys::ControlRange::default()
        };
        for value in [i32::MIN, -1, 0, 1, i32::MAX] {
            let taken = value_in_range(value, &range).expect("can be set");
            assert!((i64::from(taken) - i64::from(value)).abs() <= i64::from(i32::MAX) / 2 + 1);
        }
        let inverted = sys::ControlRange {
            minimum: 10,
            maximum: 5,
            step: 0,
            ..sys::ControlRange::default()
        };
        assert_eq!(value_in_range(7, &inverted), Some(10));
    }
}

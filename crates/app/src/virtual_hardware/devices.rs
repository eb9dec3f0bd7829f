//! What does each virtual device send? Samples of the simulation in their wire formats, with the active faults.

use anyhow::Result;
use hw::camera::Encoding;
use localize::Stamp;
use localize::robot::ExposureSetting;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim::Simulator;

use super::base::VirtualBase;
use super::camera::{QueuedImage, VirtualCamera};
use super::faults::{FaultInterval, FaultPlan, HardwareFault, HardwareFaultKind};
use super::inertial::{ImuEncoder, ImuFault};
use super::options::Options;
use super::real_time_sim::ScheduledSample;
use super::robot_folder::{self, EXPOSURE_UNIT};
use super::serial_port::VirtualSerialPort;
use pipeline::csv_table::{CsvWriter, format_seconds};

/// Initial value of the wheel counters: they overflow in every run, after five revolutions of a wheel.
const INITIAL_COUNT: u32 = 0u32.wrapping_sub(20_000);
/// Limits of the virtual camera, unit of the simulator.
const EXPOSURE_MIN: f32 = 0.01;
const EXPOSURE_MAX: f32 = 10.0;
const GAIN_MIN: f32 = 1.0;
const GAIN_MAX: f32 = 16.0;
/// Bytes of noise in place of one message.
const NOISE_BYTES: usize = 23;
/// On a noisy port one byte of this number is wrong.
const BYTES_PER_ERROR: u32 = 200;

/// All devices of the virtual robot.
pub(super) struct VirtualDevices {
    base_port: VirtualSerialPort,
    wit_port: VirtualSerialPort,
    bno085_port: VirtualSerialPort,
    camera: VirtualCamera,
    pub(super) base_firmware: VirtualBase,
    imu_encoder: ImuEncoder,
    faults: FaultPlan,
    pub(super) ground_truth: Option<CsvWriter>,
    /// Last message of the IMU, for the fault that repeats it.
    last_imu_bytes: Vec<u8>,
    last_image: Option<QueuedImage>,
    partial_images_sent: usize,
    base_restarts: usize,
    rng: ChaCha8Rng,
}

impl VirtualDevices {
    pub(super) fn new(
        sim: &Simulator,
        plan: FaultPlan,
        options: &Options<'_>,
        truth: Option<CsvWriter>,
    ) -> Result<Self> {
        let folder = options.folder;
        let base = sim.robot().base.clone().unwrap_or_default();
        let omni = base.kinematics()?;
        let encoding = match options.format {
            "YUYV" => Encoding::Yuyv,
            _ => Encoding::Rgb8,
        };
        Ok(VirtualDevices {
            base_port: VirtualSerialPort::connected(&folder.join(robot_folder::BASE))?,
            wit_port: VirtualSerialPort::connected(&folder.join(robot_folder::WIT))?,
            bno085_port: VirtualSerialPort::connected(&folder.join(robot_folder::BNO085))?,
            camera: VirtualCamera::start(&folder.join(robot_folder::CAMERA), encoding)?,
            base_firmware: VirtualBase::new(options.bus, omni, base.ticks_per_turn),
            imu_encoder: ImuEncoder::default(),
            faults: plan,
            ground_truth: truth,
            last_imu_bytes: Vec::new(),
            last_image: None,
            partial_images_sent: 0,
            base_restarts: 0,
            rng: ChaCha8Rng::seed_from_u64(sim.scenario().seed),
        })
    }

    /// Sends a sample by its device; `time`: seconds since the start.
    pub(super) fn deliver(&mut self, due: ScheduledSample, time: f64) -> Result<()> {
        self.update_connections(time)?;
        let answers = self
            .base_firmware
            .receive(&self.base_port.read(), hw::now());
        self.send_base(&answers, time);
        let at = due.stamp;
        match due.sample {
            sim::SimSample::Odometry(_) => self.send_encoders(&due.wheel_angles, at, time),
            sim::SimSample::Imu(imu) => {
                let message = self
                    .base_firmware
                    .encode_imu(&imu, self.board_time_us(at, time));
                self.send_base(&message, time);
                self.send_imu(&imu, time);
            }
            sim::SimSample::Compass(compass) => {
                let message = self
                    .base_firmware
                    .encode_heading(&compass, self.board_time_us(at, time));
                self.send_base(&message, time);
                if !self.faults.is_active(HardwareFaultKind::ImuGarbage, time) {
                    self.wit_port.send(&ImuEncoder::encode_wit_angle(&compass));
                }
            }
            sim::SimSample::Image(image) => self.send_image(image, due.setting, at, time),
            sim::SimSample::Truth(truth) => {
                if let Some(file) = &mut self.ground_truth {
                    let (stamp, pose) = (format_seconds(at), truth.robot.pose);
                    // Its image is the next sample, and was taken with the same setting.
                    let exposure = due.setting.exposure * EXPOSURE_UNIT;
                    file.write_row(format_args!(
                        "{stamp},{:.5},{:.5},{:.6},{exposure:.6},{:.2}",
                        pose.x, pose.y, pose.theta, due.setting.gain
                    ))?;
                }
            }
            sim::SimSample::Command(_) => {}
        }
        Ok(())
    }

    /// Exposure and gain that the camera was commanded since the last call, unit of the simulator, within the limits of
    /// the virtual camera.
    pub(super) fn commanded_setting(&self) -> Option<ExposureSetting> {
        let setting = self.camera.take_commanded_setting()?;
        Some(ExposureSetting {
            exposure: (setting.exposure / EXPOSURE_UNIT).clamp(EXPOSURE_MIN, EXPOSURE_MAX),
            gain: setting.gain.clamp(GAIN_MIN, GAIN_MAX),
        })
    }

    /// Unplugs and plugs in devices by the fault plan.
    fn update_connections(&mut self, time: f64) -> Result<()> {
        if self
            .faults
            .is_active(HardwareFaultKind::BaseUnplugged, time)
        {
            self.base_port.disconnect()?;
            self.base_firmware.on_reconnect();
        } else {
            self.base_port.connect()?;
        }
        if self.faults.is_active(HardwareFaultKind::ImuUnplugged, time) {
            self.wit_port.disconnect()?;
        } else {
            self.wit_port.connect()?;
        }
        self.camera.set_unplugged(
            self.faults
                .is_active(HardwareFaultKind::CameraUnplugged, time),
        );
        Ok(())
    }

    /// Time of the board's clock, µs.
    fn board_time_us(&self, at: Stamp, time: f64) -> u32 {
        let step = self.faults.active(HardwareFaultKind::BaseClock, time);
        let stamp = at + step.map_or(0.0, |fault| fault.step);
        // Overflows after 71 minutes, as the board's clock does.
        (stamp.0 / 1000) as u32
    }

    fn send_encoders(&mut self, wheel_angles: &[f64], at: Stamp, time: f64) {
        let restarts = self
            .faults
            .started_count(HardwareFaultKind::BaseRestarts, time);
        let restarted = restarts > std::mem::replace(&mut self.base_restarts, restarts);
        let time_us = self.board_time_us(at, time);
        let message = match &mut self.base_firmware {
            VirtualBase::Board(board) => {
                board.encode_status(time, time_us, wheel_angles, INITIAL_COUNT, restarted)
            }
            VirtualBase::Vescs(vescs) => vescs.encode_status(wheel_angles, INITIAL_COUNT, at),
        };
        self.send_base(&message, time);
    }

    fn send_base(&mut self, message: &[u8], time: f64) {
        if message.is_empty() || self.faults.is_active(HardwareFaultKind::BaseSilent, time) {
            return;
        }
        let mut bytes = message.to_vec();
        if self.faults.is_active(HardwareFaultKind::BaseGarbage, time) {
            bytes = self.random_bytes();
        }
        if self.faults.is_active(HardwareFaultKind::BaseNoise, time) {
            for byte in &mut bytes {
                if self.rng.random_range(0..BYTES_PER_ERROR) == 0 {
                    *byte ^= 1 << self.rng.random_range(0..8u32);
                }
            }
        }
        self.base_port.send(&bytes);
    }

    fn random_bytes(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; NOISE_BYTES];
        self.rng.fill_bytes(&mut bytes);
        bytes
    }

    fn send_imu(&mut self, imu: &localize::sample::Imu, time: f64) {
        let message = self.imu_encoder.encode_bno085(imu);
        self.bno085_port.send(&message);
        if self.faults.is_active(HardwareFaultKind::ImuGarbage, time) {
            let noise = self.random_bytes();
            return self.wit_port.send(&noise);
        }
        if !self.faults.is_active(HardwareFaultKind::ImuStuck, time) {
            let fault = if self.faults.is_active(HardwareFaultKind::ImuNan, time) {
                ImuFault::Saturated
            } else {
                ImuFault::None
            };
            self.last_imu_bytes = ImuEncoder::encode_wit_imu(imu, fault);
        }
        self.wit_port.send(&self.last_imu_bytes);
    }

    fn send_image(
        &mut self,
        image: sim::simulation::SimImage,
        setting: ExposureSetting,
        at: Stamp,
        time: f64,
    ) {
        let clock_fault = self.faults.active(HardwareFaultKind::CameraClock, time);
        let mut queued = QueuedImage {
            stamp_ns: (at + clock_fault.map_or(0.0, |fault| fault.step)).0,
            setting: ExposureSetting {
                exposure: setting.exposure * EXPOSURE_UNIT,
                ..setting
            },
            size_px: [image.width_px, image.height_px],
            rgb: std::sync::Arc::new(image.rgb),
            truncated_to: None,
        };
        if self.faults.is_active(HardwareFaultKind::CameraSilent, time) {
            return;
        }
        if self
            .faults
            .is_active(HardwareFaultKind::CameraHalfFrame, time)
        {
            let started = self
                .faults
                .started_count(HardwareFaultKind::CameraHalfFrame, time);
            if started == self.partial_images_sent {
                return;
            }
            self.partial_images_sent = started;
            queued.truncated_to = Some(0.5);
        }
        if self
            .faults
            .is_active(HardwareFaultKind::CameraFreezes, time)
        {
            let frozen = self.last_image.as_ref().unwrap_or(&queued);
            queued.rgb = frozen.rgb.clone();
        }
        self.last_image = Some(queued.clone());
        self.camera.send(queued);
    }

    pub(super) fn fault_intervals(&self, start: Stamp) -> Vec<FaultInterval> {
        let interval = |fault: &HardwareFault| FaultInterval {
            kind: fault.kind,
            from_s: (start + fault.at).seconds(),
            until_s: (start + fault.at + fault.duration).seconds(),
        };
        self.faults.faults.iter().map(interval).collect()
    }
}

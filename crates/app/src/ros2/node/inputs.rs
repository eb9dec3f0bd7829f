//! What do other programs send? Commands, poses, and samples of sensors that are not Mirrorball's own.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::SyncSender;

use hw::DeviceEvent;
use hw::camera::{CapturedImage, Encoding};
use localize::sample::{Imu as ImuSample, Odometry as WheelSample};
use localize::{Stamp, math};
use ros2_client::{MessageInfo, RmwRequestId};

use super::super::config::Ros2Config;
use super::super::messages::{Image, Imu, Odometry, PoseWithCovariance, Time, Twist, Vector3};
use super::super::odometry_frame::PlanarPose;
use super::command_guard::CommandGuard;
use super::given_pose::{planar_given, yaw_of};
use super::shared::{Drive, GivenPose, Shared};

/// Largest age of a sample's stamp; an older one is of another clock, seconds.
const STAMP_AGE_MAX: f64 = 1.0;
/// Fastest motion between two poses of odometry, m/s; a faster one is a reset.
const SPEED_MAX: f64 = 20.0;
/// Poses of another base that are kept: a second at 1000 Hz.
const ODOMETRY_BUFFER: usize = 1000;

/// Something received.
pub(super) enum Incoming {
    Twist(Twist, MessageInfo),
    /// By topic, or by a service's request.
    GivenPose(PoseWithCovariance, Option<RmwRequestId>),
    Odometry(Box<Odometry>),
    Imu(Imu),
    Image(Image),
}

/// What the receiving thread does with messages.
pub(super) struct InputHandler {
    guard: CommandGuard,
    accepts_pose: bool,
    shared: Arc<Shared>,
    poses: SyncSender<GivenPose>,
    drive: Box<Drive>,
    images: u32,
}

impl InputHandler {
    pub(super) fn new(
        config: &Ros2Config,
        shared: Arc<Shared>,
        poses: SyncSender<GivenPose>,
        drive: Box<Drive>,
    ) -> Self {
        let (valid_max_ms, speed_max) = (config.valid_max_ms, config.speed_max);
        InputHandler {
            guard: CommandGuard::new(config.accept_commands, valid_max_ms, speed_max),
            accepts_pose: config.accept_pose,
            shared,
            poses,
            drive,
            images: 0,
        }
    }

    /// Passes a message on to whom it is for.
    pub(super) fn handle(&mut self, incoming: Incoming) {
        match incoming {
            Incoming::Twist(twist, info) => self.take_command(&twist, &info),
            Incoming::GivenPose(pose, _) => self.take_pose(&pose),
            Incoming::Odometry(odometry) => self.take_odometry(&odometry),
            Incoming::Imu(imu) => self.take_imu(&imu),
            Incoming::Image(image) => self.take_image(image),
        }
    }

    fn take_command(&mut self, twist: &Twist, info: &MessageInfo) {
        let sent_ns = info.source_timestamp().map(|sent| sent.to_nanos());
        let sender = info.publisher_gid().to_bytes16();
        let checked = self.guard.accept(twist, sender, sent_ns, hw::now());
        let refusal = match checked {
            Ok((twist, deadline)) => {
                let executed = (self.drive)(twist, deadline);
                let mut state = self.shared.lock();
                if executed {
                    state.accepted += 1;
                } else {
                    state.overruled += 1;
                }
                return;
            }
            Err(refusal) => refusal,
        };
        let mut state = self.shared.lock();
        let count = state.refused.entry(refusal).or_default();
        *count += 1;
        let is_first = *count == 1;
        drop(state);
        if is_first {
            let reason = refusal.explain();
            self.shared
                .notice(format!("commands of ROS 2 are rejected: {reason}"));
        }
    }

    fn take_pose(&mut self, given: &PoseWithCovariance) {
        if !self.accepts_pose {
            self.shared.notice(
                "a pose given by ROS 2 is rejected: set accept_pose = true in [ros2] of network.toml"
                    .to_owned(),
            );
            return;
        }
        match planar_given(given) {
            // With a pose that the run has not taken yet, this one is not the first.
            Some(given) => drop(self.poses.try_send(given)),
            None => self
                .shared
                .notice("a pose given by ROS 2 is rejected: not finite".to_owned()),
        }
    }

    /// A stamp by the clock of samples: that of the message, or now if that is no time of the last second.
    fn stamp(&self, sent: &Time) -> Stamp {
        let now = hw::now();
        let sent_ns = i64::from(sent.sec) * 1_000_000_000 + i64::from(sent.nanosec);
        let stamp = Stamp(sent_ns.saturating_sub(hw::realtime_offset_ns()));
        let age = now - stamp;
        if (-0.005..STAMP_AGE_MAX).contains(&age) {
            return stamp.min(now);
        }
        self.shared.notice(
            "samples of ROS 2 have stamps of another clock: the time of their arrival is used. Synchronize the clocks"
                .to_owned(),
        );
        now
    }

    fn push(&self, event: DeviceEvent) {
        let events = self.shared.lock().events.clone();
        if let Some(events) = events {
            self.shared.samples.fetch_add(1, Ordering::Relaxed);
            events.push(event);
        }
    }

    fn take_odometry(&mut self, odometry: &Odometry) {
        let (position, orientation) = (
            &odometry.pose.pose.position,
            &odometry.pose.pose.orientation,
        );
        let pose = PlanarPose {
            x: position.x,
            y: position.y,
            theta: yaw_of(orientation),
        };
        if !(pose.x + pose.y + pose.theta).is_finite() {
            return;
        }
        let stamp = self.stamp(&odometry.header.stamp);
        let mut state = self.shared.lock();
        let poses = &mut state.external_odometry;
        let Some((last, before)) = poses.back().copied() else {
            poses.push_back((stamp, pose));
            return;
        };
        let step = stamp - last;
        if step <= 0.0 {
            return;
        }
        let turned = math::sin_cos(pose.theta - before.theta);
        let turn = math::atan2(turned.0, turned.1);
        let (sin, cos) = math::sin_cos(before.theta);
        let (east, north) = (pose.x - before.x, pose.y - before.y);
        // The heading grows without jumps, so that poses can be interpolated.
        let theta = before.theta + turn;
        poses.push_back((stamp, PlanarPose { theta, ..pose }));
        if poses.len() > ODOMETRY_BUFFER {
            poses.pop_front();
        }
        drop(state);
        if math::hypot(east, north) > SPEED_MAX * step.max(0.05) {
            let text = "the odometry of ROS 2 jumps: taken as a reset";
            self.shared.notice(text.to_owned());
            return;
        }
        self.push(DeviceEvent::Odometry(WheelSample {
            stamp,
            dx: (cos * east + sin * north) as f32,
            dy: (-sin * east + cos * north) as f32,
            dtheta: turn as f32,
            slip: 0.0,
        }));
    }

    fn take_imu(&mut self, imu: &Imu) {
        let vector = |value: &Vector3| [value.x, value.y, value.z].map(|value| value as f32);
        self.push(DeviceEvent::Imu(ImuSample {
            stamp: self.stamp(&imu.header.stamp),
            specific_force: vector(&imu.linear_acceleration),
            angular_velocity: vector(&imu.angular_velocity),
        }));
    }

    fn take_image(&mut self, image: Image) {
        let stamp = self.stamp(&image.header.stamp);
        let Some(encoding) = encoding(&image.encoding) else {
            let text = format!(
                "images of ROS 2 are rejected: encoding {:?} (expected rgb8, bgr8, mono8, bayer_*8, yuv422 or yuv422_yuy2)",
                image.encoding
            );
            self.shared.notice(text);
            return;
        };
        let (width_px, height_px) = (image.width as usize, image.height as usize);
        let stride = image.step as usize;
        let row_bytes = encoding.row_bytes(width_px);
        let is_whole = width_px > 0
            && height_px > 0
            && stride >= row_bytes
            && stride
                .checked_mul(height_px - 1)
                .is_some_and(|above| image.data.0.len() >= above.saturating_add(row_bytes));
        if !is_whole {
            let text = "images of ROS 2 are rejected: fewer bytes than their size says";
            self.shared.notice(text.to_owned());
            return;
        }
        self.images = self.images.wrapping_add(1);
        self.push(DeviceEvent::Image(CapturedImage {
            stamp,
            sequence: self.images,
            width_px,
            height_px,
            encoding,
            stride,
            repeated: false,
            setting: None,
            data: Arc::new(image.data.0.into()),
        }));
    }
}

fn encoding(name: &str) -> Option<Encoding> {
    Some(match name {
        "rgb8" => Encoding::Rgb8,
        "bgr8" | "8UC3" => Encoding::Bgr8,
        "mono8" | "8UC1" => Encoding::Grey8,
        "bayer_rggb8" => Encoding::BayerRggb,
        "bayer_bggr8" => Encoding::BayerBggr,
        "bayer_gbrg8" => Encoding::BayerGbrg,
        "bayer_grbg8" => Encoding::BayerGrbg,
        "yuv422" | "uyvy" => Encoding::Uyvy,
        "yuv422_yuy2" | "yuyv" => Encoding::Yuyv,
        _ => return None,
    })
}

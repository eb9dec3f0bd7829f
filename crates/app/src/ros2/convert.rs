//! Which ROS 2 messages represent a cycle? The same ones in a bag and on the network.

use localize::filter::FilterConfig;
use localize::sample::{Imu as ImuSample, LinePoint};
use localize::world::TrackedObject;
use localize::{Mode, Stamp};
use nalgebra::Matrix3;
use pipeline::Cycle;
use pipeline::log::{mode_and_advice, reason_text};

use super::frames::Frames;
use super::markers;
use super::messages::{
    BoundingBox3D, Byte, Bytes, Detection3D, Detection3DArray, DiagnosticArray, DiagnosticStatus,
    Header, Imu, KeyValue, MagneticField, MarkerArray, ObjectHypothesis, ObjectHypothesisWithPose,
    Odometry, PointCloud2, PointField, PoseWithCovariance, PoseWithCovarianceStamped,
    QuaternionStamped, TFMessage, TransformStamped, Twist, TwistWithCovariance, Vector3,
};
use super::odometry_frame::{OdometryFrame, PlanarPose};
use super::primitives::{
    covariance6, header, planar_pose_message, planar_transform, uncertain_pose, yaw,
};

/// `datatype` of a 32-bit float in a point cloud.
const FLOAT32: u8 = 7;

/// A message with its topic.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Outgoing {
    Odometry(Box<Odometry>),
    Pose(PoseWithCovarianceStamped),
    Transforms(TFMessage),
    Imu(Imu),
    Compass(QuaternionStamped),
    MagneticField(MagneticField),
    LinePoints(PointCloud2),
    Markers(MarkerArray),
    Detections(Detection3DArray),
    Diagnostics(DiagnosticArray),
    Truth(PoseWithCovarianceStamped),
}

/// Converts cycles in their order.
pub(crate) struct MessageConverter {
    frames: Frames,
    /// Added to a stamp it gives the time of its message, nanoseconds.
    clock_offset_ns: i64,
    odometry: OdometryFrame,
    /// Another program publishes the frame `odom`.
    has_external_odometry: bool,
    /// Its pose at the next cycle.
    external_odometry: Option<PlanarPose>,
}

impl MessageConverter {
    /// A converter whose frame `odom` begins with the first cycle.
    pub(crate) fn new(frames: Frames, clock_offset_ns: i64, filter: &FilterConfig) -> Self {
        MessageConverter {
            frames,
            clock_offset_ns,
            odometry: OdometryFrame::new(filter),
            has_external_odometry: false,
            external_odometry: None,
        }
    }

    /// The wall clock has moved against that of the stamps.
    #[cfg(feature = "ros2")]
    pub(crate) fn set_clock_offset_ns(&mut self, clock_offset_ns: i64) {
        self.clock_offset_ns = clock_offset_ns;
    }

    /// Another program publishes the frame `odom`; `pose`: of the robot in it at the next cycle's image.
    #[cfg(feature = "ros2")]
    pub(crate) fn set_external_odometry(&mut self, exists: bool, pose: Option<PlanarPose>) {
        self.has_external_odometry = exists;
        self.external_odometry = pose;
    }

    /// Nanoseconds of a message's stamp.
    pub(crate) fn time_ns(&self, stamp: Stamp) -> i64 {
        stamp.0.saturating_add(self.clock_offset_ns)
    }

    /// The messages of a cycle with their times, in the order of publication. Images are separate.
    pub(crate) fn messages(&mut self, cycle: &Cycle) -> Vec<(i64, Outgoing)> {
        let mut messages = Vec::new();
        for sample in &cycle.inputs.odometry {
            self.odometry.add(sample);
            if self.has_external_odometry {
                continue;
            }
            let stamp_ns = self.time_ns(sample.stamp);
            messages.push((
                stamp_ns,
                Outgoing::Odometry(Box::new(self.odometry_message(stamp_ns))),
            ));
            let frames = [&*self.frames.odom, &*self.frames.base];
            let transform = planar_transform(stamp_ns, frames, self.odometry.pose, 0.0);
            messages.push((stamp_ns, transforms(transform)));
        }
        for sample in &cycle.inputs.imu {
            let stamp_ns = self.time_ns(sample.stamp);
            messages.push((stamp_ns, Outgoing::Imu(self.imu_message(sample, stamp_ns))));
        }
        for sample in &cycle.inputs.compass {
            let stamp_ns = self.time_ns(sample.stamp);
            let heading = QuaternionStamped {
                header: header(stamp_ns, &self.frames.map),
                quaternion: yaw(sample.heading.into()),
            };
            messages.push((stamp_ns, Outgoing::Compass(heading)));
            if let Some([x, y]) = sample.magnetic_field.map(|field| field.map(f64::from)) {
                let field = MagneticField {
                    header: header(stamp_ns, &self.frames.base),
                    magnetic_field: Vector3 { x, y, z: 0.0 },
                    ..MagneticField::default()
                };
                messages.push((stamp_ns, Outgoing::MagneticField(field)));
            }
        }
        if let Some(truth) = &cycle.inputs.truth {
            let stamp_ns = self.time_ns(truth.stamp);
            let pose = PoseWithCovarianceStamped {
                header: header(stamp_ns, &self.frames.map),
                pose: uncertain_pose(planar(truth.pose), &Matrix3::zeros()),
            };
            messages.push((stamp_ns, Outgoing::Truth(pose)));
        }
        let stamp_ns = self.time_ns(cycle.stamp);
        let results = self.results(cycle, stamp_ns);
        messages.extend(results.into_iter().map(|message| (stamp_ns, message)));
        messages
    }

    /// What the pipeline found.
    fn results(&self, cycle: &Cycle, stamp_ns: i64) -> Vec<Outgoing> {
        let frames = &self.frames;
        let on_robot = || header(stamp_ns, &frames.base);
        let mut messages = Vec::new();
        if let Some(pose) = cycle.estimate.pose.map(planar) {
            let covariance = cycle.estimate.covariance.map(f64::from);
            messages.push(Outgoing::Pose(PoseWithCovarianceStamped {
                header: header(stamp_ns, &frames.map),
                pose: uncertain_pose(pose, &covariance),
            }));
            let odometry = if self.has_external_odometry {
                self.external_odometry
            } else {
                Some(self.odometry.pose_at(cycle.stamp))
            };
            if let Some(odometry) = odometry {
                let names = [&*frames.map, &*frames.odom];
                let map_from_odom = pose.correction_of(odometry);
                let transform = planar_transform(stamp_ns, names, map_from_odom, 0.0);
                messages.push(transforms(transform));
            }
        }
        messages.push(Outgoing::LinePoints(line_points(
            &cycle.line_points,
            on_robot(),
        )));
        let ball = cycle.world.ball.iter().map(|ball| ("ball", ball));
        let robots = cycle.world.robots.iter().map(|robot| ("robot", robot));
        messages.push(Outgoing::Detections(Detection3DArray {
            header: on_robot(),
            detections: ball
                .chain(robots)
                .map(|(kind, object)| {
                    let flight = cycle.world.ball_in_air.filter(|_| kind == "ball");
                    let above = flight.map_or(0.0, |ball| ball.from_robot.at[2] - BALL_RADIUS);
                    detection(kind, object, above.into(), on_robot())
                })
                .collect(),
        }));
        let on_field = header(stamp_ns, &frames.map);
        messages.push(Outgoing::Markers(markers::cycle_markers(cycle, &on_field)));
        messages.push(Outgoing::Diagnostics(DiagnosticArray {
            header: header(stamp_ns, ""),
            status: vec![localization_status(cycle)],
        }));
        messages
    }

    fn odometry_message(&self, stamp_ns: i64) -> Odometry {
        let [x, y, theta] = self.odometry.velocity;
        Odometry {
            header: header(stamp_ns, &self.frames.odom),
            child_frame_id: self.frames.base.clone(),
            pose: uncertain_pose(self.odometry.pose, &self.odometry.covariance),
            twist: TwistWithCovariance {
                twist: Twist {
                    linear: Vector3 { x, y, z: 0.0 },
                    angular: Vector3 {
                        x: 0.0,
                        y: 0.0,
                        z: theta,
                    },
                },
                covariance: covariance6(&self.odometry.velocity_covariance),
            },
        }
    }

    fn imu_message(&self, sample: &ImuSample, stamp_ns: i64) -> Imu {
        let vector = |values: [f32; 3]| {
            let [x, y, z] = values.map(f64::from);
            Vector3 { x, y, z }
        };
        let mut unknown = [0.0; 9];
        // REP 145: no orientation.
        unknown[0] = -1.0;
        Imu {
            header: header(stamp_ns, &self.frames.base),
            orientation_covariance: unknown,
            angular_velocity: vector(sample.angular_velocity),
            linear_acceleration: vector(sample.specific_force),
            ..Imu::default()
        }
    }
}

fn planar(pose: localize::Pose) -> PlanarPose {
    PlanarPose {
        x: pose.x.into(),
        y: pose.y.into(),
        theta: pose.theta.into(),
    }
}

fn transforms(transform: TransformStamped) -> Outgoing {
    Outgoing::Transforms(TFMessage {
        transforms: vec![transform],
    })
}

fn line_points(points: &[LinePoint], header: Header) -> PointCloud2 {
    let names = ["x", "y", "z", "std_radial", "std_tangential"];
    let field = |(index, name): (usize, &str)| PointField {
        name: name.to_owned(),
        offset: 4 * index as u32,
        datatype: FLOAT32,
        count: 1,
    };
    let row = |point: &LinePoint| {
        [
            point.at.x,
            point.at.y,
            0.0,
            point.std_radial,
            point.std_tangential,
        ]
    };
    let point_step = 4 * names.len() as u32;
    let data: Vec<u8> = points
        .iter()
        .flat_map(row)
        .flat_map(f32::to_le_bytes)
        .collect();
    PointCloud2 {
        header,
        height: 1,
        width: points.len() as u32,
        fields: names.into_iter().enumerate().map(field).collect(),
        is_bigendian: false,
        point_step,
        row_step: data.len() as u32,
        data: Bytes(data),
        is_dense: true,
    }
}

/// Radius of a size 5 ball, metres.
const BALL_RADIUS: f32 = 0.11;

/// An object in the robot's frame, which is known even while the robot is lost.
///
/// `above`: height of its lowest point above the ground, metres.
fn detection(kind: &str, object: &TrackedObject, above: f64, header: Header) -> Detection3D {
    let (side, height) = if kind == "ball" {
        (0.22, 0.22)
    } else {
        (0.52, 0.8)
    };
    let mut pose = planar_pose_message(PlanarPose {
        x: object.at.x.into(),
        y: object.at.y.into(),
        theta: 0.0,
    });
    pose.position.z = above + height / 2.0;
    let mut covariance = object
        .covariance
        .fixed_view::<3, 3>(0, 0)
        .map(f64::from)
        .into_owned();
    // The heading is not observed: a uniform distribution. The covariance's third row is of the velocity.
    covariance.row_mut(2).fill(0.0);
    covariance.column_mut(2).fill(0.0);
    covariance[(2, 2)] = std::f64::consts::PI * std::f64::consts::PI / 3.0;
    Detection3D {
        header,
        results: vec![ObjectHypothesisWithPose {
            hypothesis: ObjectHypothesis {
                class_id: kind.to_owned(),
                score: object.probability.into(),
            },
            pose: PoseWithCovariance {
                pose: pose.clone(),
                covariance: covariance6(&covariance),
            },
        }],
        bbox: BoundingBox3D {
            center: pose,
            size: Vector3 {
                x: side,
                y: side,
                z: height,
            },
        },
        id: format!("{kind} {}", object.id),
    }
}

fn localization_status(cycle: &Cycle) -> DiagnosticStatus {
    let estimate = &cycle.estimate;
    let level = match (estimate.mode, &cycle.image_fault) {
        (Mode::Lost, _) => 2,
        (Mode::Global, _) | (_, Some(_)) => 1,
        (Mode::Tracking, None) => u8::from(!reason_text(estimate).is_empty()),
    };
    let value = |key: &str, value: String| KeyValue {
        key: key.to_owned(),
        value,
    };
    let mut values = vec![
        value("line_points", estimate.line_points.to_string()),
        value("share_on_markings", estimate.inlier_share.to_string()),
        value("residual_m", estimate.inlier_rms.to_string()),
        value("half_known", estimate.half_known.to_string()),
        value("vision_ms", cycle.timings.see_ms.to_string()),
        value("localization_ms", cycle.timings.localize_ms.to_string()),
    ];
    if let Some(fault) = &cycle.image_fault {
        values.push(value("image_fault", fault.clone()));
    }
    DiagnosticStatus {
        level: Byte(level),
        name: "mirrorball: localization".to_owned(),
        message: mode_and_advice(estimate),
        hardware_id: String::new(),
        values,
    }
}

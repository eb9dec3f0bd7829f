//! What can be shown of a log of another format? Poses, truth and line points from the topics for viewers.

use std::collections::{BTreeMap, HashMap};

use anyhow::Result;
use foxglove::messages::{PointCloud, Pose as StockPose, PoseInFrame};
use localize::Stamp;
use localize::frames::At;
use localize::math;
use localize::sample::LinePoint;
use prost::Message;

use super::encoded_image::EncodedImage;
use super::read::LoggedCycle;
use super::schema::{convert, wire};
use crate::cycle::Cycle;

/// Collects poses, truth and line points by stamp.
#[derive(Default)]
pub(super) struct FallbackReader {
    cycles: BTreeMap<u64, FallbackCycle>,
}

#[derive(Default)]
struct FallbackCycle {
    pose: Option<wire::Pose>,
    truth: Option<wire::Pose>,
    points: Vec<LinePoint>,
}

impl FallbackReader {
    /// Adds a cycle with this stamp.
    pub(super) fn add_cycle(&mut self, time: u64) {
        self.cycles.entry(time).or_default();
    }

    /// Adds a message of any topic. Topics without poses or line points are ignored.
    pub(super) fn add_message(&mut self, topic: &str, time: u64, data: &[u8]) {
        match topic {
            "/pose" => {
                let pose = PoseInFrame::decode(data).ok().and_then(|m| m.pose);
                self.cycles.entry(time).or_default().pose =
                    pose.and_then(|pose| planar_pose(&pose));
            }
            "/truth/pose" => {
                let pose = PoseInFrame::decode(data).ok().and_then(|m| m.pose);
                self.cycles.entry(time).or_default().truth =
                    pose.and_then(|pose| planar_pose(&pose));
            }
            "/vision/line_points" => {
                if let Ok(cloud) = PointCloud::decode(data) {
                    self.cycles.entry(time).or_default().points = line_points_from_cloud(&cloud);
                }
            }
            _ => {}
        }
    }

    /// A cycle per stamp, with its image if there is one.
    pub(super) fn into_cycles(
        mut self,
        mut images: HashMap<u64, EncodedImage>,
    ) -> Result<Vec<LoggedCycle>> {
        let mut times: Vec<u64> = images.keys().copied().collect();
        times.sort_unstable();
        for time in times {
            self.add_cycle(time);
        }
        let logged = |(index, (time, fallback)): (usize, (u64, FallbackCycle))| {
            Ok(LoggedCycle {
                index: index as u64,
                image: images.remove(&time),
                cycle: fallback.into_cycle(Stamp(i64::try_from(time).unwrap_or(i64::MAX)))?,
            })
        };
        self.cycles.into_iter().enumerate().map(logged).collect()
    }
}

impl FallbackCycle {
    // Converted by way of the message, whose defaults fill the other fields.
    fn into_cycle(self, stamp: Stamp) -> Result<Cycle> {
        let truth = self.truth.map(|pose| wire::GroundTruth {
            stamp_ns: stamp.0,
            pose,
            ..wire::GroundTruth::default()
        });
        let mode = match self.pose {
            Some(_) => "tracking",
            None => "lost",
        };
        let mut points = wire::LinePoints::default();
        for point in &self.points {
            points.x.push(point.at.x);
            points.y.push(point.at.y);
            points.std_radial.push(point.std_radial);
            points.std_tangential.push(point.std_tangential);
        }
        let estimate = wire::Estimate {
            stamp_ns: stamp.0,
            pose: self.pose,
            covariance: vec![0.0; 9],
            mode: mode.to_owned(),
            line_points: self.points.len() as u32,
            lean: vec![0.0; 2],
            odometry_scales: vec![1.0; 2],
            half_known: true,
            ..wire::Estimate::default()
        };
        convert::cycle_from_wire(wire::Cycle {
            stamp_ns: stamp.0,
            truth,
            points,
            estimate,
            ..wire::Cycle::default()
        })
    }
}

fn planar_pose(pose: &StockPose) -> Option<wire::Pose> {
    let (at, rotation) = (pose.position.as_ref()?, pose.orientation.as_ref()?);
    Some(wire::Pose {
        x: at.x as f32,
        y: at.y as f32,
        theta: (2.0 * math::atan2(rotation.z, rotation.w)) as f32,
    })
}

/// Line points from a point cloud whose fields are 32-bit floats, as in our logs.
fn line_points_from_cloud(cloud: &PointCloud) -> Vec<LinePoint> {
    let stride = cloud.point_stride as usize;
    let offset = |name: &str| {
        let field = cloud.fields.iter().find(|field| field.name == name)?;
        Some(field.offset as usize)
    };
    let (Some(x), Some(y)) = (offset("x"), offset("y")) else {
        return Vec::new();
    };
    let (radial, tangential) = (offset("std_radial"), offset("std_tangential"));
    let rows = cloud.data.chunks_exact(stride.max(1));
    rows.filter_map(|row| {
        let float = |at: usize| {
            let bytes = row.get(at..at + 4)?.try_into().ok()?;
            Some(f32::from_le_bytes(bytes))
        };
        Some(LinePoint {
            at: At::new(float(x)?, float(y)?),
            std_radial: radial.and_then(float).unwrap_or(0.0),
            std_tangential: tangential.and_then(float).unwrap_or(0.0),
        })
    })
    .collect()
}

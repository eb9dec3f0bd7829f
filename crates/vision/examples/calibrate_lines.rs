//! Error of the calibration from lines against a known map: `calibrate_lines FOLDER START.npz TRUE.npz`

use std::error::Error;
use std::path::PathBuf;

use localize::Field;
use localize::robot::CameraConfig;
use vision::calibrate::{NamedImage, calibrate_lines};
use vision::{GroundMap, Image, VisionConfig};

#[derive(serde::Deserialize)]
struct Robot {
    field: PathBuf,
    camera: CameraConfig,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [folder, start, exact] = arguments.as_slice() else {
        return Err("usage: calibrate_lines FOLDER START.npz TRUE.npz".into());
    };
    let robot: Robot = toml::from_str(&std::fs::read_to_string(folder.join("robot.toml"))?)?;
    let field = Field::load(&folder.join(&robot.field))?;
    let mut images = Vec::new();
    for record in csv::Reader::from_path(folder.join("frames.csv"))?.records() {
        let record = record?;
        images.push(NamedImage {
            name: record[1].to_owned(),
            image: Image::load(&folder.join(&record[1]))?,
        });
    }
    let (start, exact) = (GroundMap::load(start)?, GroundMap::load(exact)?);
    let found = calibrate_lines(
        &robot.camera,
        &start,
        &field,
        &[],
        &images,
        &VisionConfig::default(),
        &|_| (),
    )?;
    for (image, pose) in found.images.iter().zip(&found.poses) {
        println!(
            "{} {} points rms {:.2} px {:?} {:?}",
            image.name,
            image.points,
            image.rms_px,
            image.left_out,
            pose.map(|pose| (pose.x, pose.y, pose.theta))
        );
    }
    println!("rms {:.3} m, inliers {:.2}", found.rms, found.inlier_share);
    for (from, to) in [(0.3, 1.0), (1.0, 2.0), (2.0, 3.0), (0.0, 3.0), (3.0, 5.0)] {
        let mut offs = [Vec::new(), Vec::new()];
        for v in 0..exact.height_px {
            for u in 0..exact.width_px {
                let Some(truth) = exact
                    .at(u, v)
                    .filter(|at| (from..to).contains(&at.distance()))
                else {
                    continue;
                };
                for (offs, map) in offs.iter_mut().zip([&start, &found.map]) {
                    if let Some(at) = map.at(u, v) {
                        offs.push(at.distance_to(truth));
                    }
                }
            }
        }
        let medians = offs.map(|mut offs| {
            offs.sort_by(f32::total_cmp);
            offs.get(offs.len() / 2).copied()
        });
        println!(
            "{from} to {to} m: start {:?}, found {:?}",
            medians[0], medians[1]
        );
    }
    Ok(())
}

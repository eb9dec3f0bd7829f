//! Which images is a calibration made from? Those of a strip or of a recording, and those it leaves out.

use std::path::Path;

use anyhow::{Error, Result, ensure};
use pipeline::csv_table::CsvTable;
use serde::Serialize;
use vision::calibrate::{ImageResidual, NamedImage, StripImage};
use vision::image::{CommonOrientation, Image};

#[derive(Serialize)]
pub(super) struct SkippedImage {
    pub(super) file: String,
    pub(super) reason: String,
}

impl SkippedImage {
    pub(super) fn from_residuals(images: &[ImageResidual]) -> Vec<SkippedImage> {
        let left_out = images.iter().filter_map(|image| {
            Some(SkippedImage {
                file: image.name.clone(),
                reason: image.left_out.clone()?,
            })
        });
        left_out.collect()
    }
}

pub(super) fn load_strip_images(folder: &Path) -> Result<Vec<StripImage>> {
    let path = folder.join("strip.csv");
    let table = CsvTable::read(&path, &["file", "direction_rad"])?;
    let (mut images, mut common) = (Vec::new(), CommonOrientation::default());
    for row in table.rows() {
        let name = row.text("file")?.to_owned();
        let direction = row.number("direction_rad")?;
        match Image::load_with_orientation(&folder.join(&name)) {
            Ok((image, orientation)) => {
                common.check(&name, orientation).map_err(Error::msg)?;
                images.push(StripImage {
                    name,
                    direction,
                    image,
                });
            }
            Err(error) => eprintln!("{}: left out: {error}", row.location()),
        }
    }
    ensure!(
        !images.is_empty(),
        "{}: no image can be read",
        path.display()
    );
    Ok(images)
}

/// The images of frames.csv, or of strip.csv if there is none. Images that cannot be read are reported and left out.
pub(super) fn load_drive_images(folder: &Path) -> Result<Vec<NamedImage>> {
    let (frames, strip) = (folder.join("frames.csv"), folder.join("strip.csv"));
    // A message about a missing table names the usual one.
    let path = if !frames.exists() && strip.exists() {
        strip
    } else {
        frames
    };
    let (mut images, mut common) = (Vec::new(), CommonOrientation::default());
    for row in CsvTable::read(&path, &["file"])?.rows() {
        let name = row.text("file")?.to_owned();
        match Image::load_with_orientation(&folder.join(&name)) {
            Ok((image, orientation)) => {
                common.check(&name, orientation).map_err(Error::msg)?;
                images.push(NamedImage { name, image });
            }
            Err(error) => eprintln!("{}: left out: {error}", row.location()),
        }
    }
    ensure!(
        !images.is_empty(),
        "{}: no image can be read",
        path.display()
    );
    Ok(images)
}

//! Which images is a calibration made from? Those of a strip or of a recording, and those it leaves out.

use std::path::Path;

use anyhow::{Error, Result, ensure};
use pipeline::csv_table::CsvTable;
use pipeline::score::summary::pluralize;
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

/// Names each image that was left out and why, images with the same reason in one line.
pub(super) fn print_left_out(images: &[ImageResidual]) {
    for line in left_out_lines(images) {
        println!("{line}");
    }
}

fn left_out_lines(images: &[ImageResidual]) -> Vec<String> {
    let mut reasons: Vec<&str> = Vec::new();
    for reason in images.iter().filter_map(|image| image.left_out.as_deref()) {
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    let line = |reason: &str| {
        let is_named = |image: &ImageResidual| image.left_out.as_deref() == Some(reason);
        let runs = images.chunk_by(|a, b| is_named(a) == is_named(b));
        let runs = runs.filter(|run| is_named(&run[0]));
        let place = common_place(images);
        let names: Vec<String> = runs
            .clone()
            .map(|run| name_run(run, place.is_some()))
            .collect();
        let count = pluralize(runs.map(<[_]>::len).sum(), "image");
        let place = place.map_or_else(String::new, |place| format!("{place}: "));
        format!("{count} left out: {reason} ({place}{})", names.join(", "))
    };
    reasons.into_iter().map(line).collect()
}

/// Folder and extension that all images share, as a pattern.
fn common_place(images: &[ImageResidual]) -> Option<String> {
    let place = |image: &ImageResidual| {
        let extension = Path::new(&image.name).extension()?.to_str()?.to_owned();
        let pattern = Path::new(&image.name).with_file_name(format!("*.{extension}"));
        Some(pattern.display().to_string())
    };
    let (first, rest) = images.split_first()?;
    let first = place(first)?;
    let is_common = !rest.is_empty()
        && rest
            .iter()
            .all(|image| place(image).as_ref() == Some(&first));
    is_common.then_some(first)
}

/// The names of neighbouring images: the first and the last.
fn name_run(run: &[ImageResidual], stem_alone: bool) -> String {
    let name = |image: &ImageResidual| {
        let stem = Path::new(&image.name).file_stem().filter(|_| stem_alone);
        stem.map_or_else(
            || image.name.clone(),
            |stem| stem.to_string_lossy().into_owned(),
        )
    };
    match run {
        [] => String::new(),
        [only] => name(only),
        [first, .., last] => format!("{} to {}", name(first), name(last)),
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
            Err(error) => stderr_line!("{}: left out: {error}", row.location()),
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
    load_spread_images(folder, usize::MAX)
}

/// As [`load_drive_images`], at most so many, evenly spread over the drive: thousands would not fit into memory.
pub(super) fn load_spread_images(folder: &Path, images_max: usize) -> Result<Vec<NamedImage>> {
    let (frames, strip) = (folder.join("frames.csv"), folder.join("strip.csv"));
    // A message about a missing table names the usual one.
    let path = if !frames.exists() && strip.exists() {
        strip
    } else {
        frames
    };
    let (mut images, mut common) = (Vec::new(), CommonOrientation::default());
    let table = CsvTable::read(&path, &["file"])?;
    let count = table.rows().count();
    let step = count.div_ceil(images_max).max(1);
    if step > 1 {
        stderr_line!(
            "{} of {count} images are used, evenly spread: more add time, not accuracy",
            count.div_ceil(step)
        );
    }
    for row in table.rows().step_by(step) {
        let name = row.text("file")?.to_owned();
        match Image::load_with_orientation(&folder.join(&name)) {
            Ok((image, orientation)) => {
                common.check(&name, orientation).map_err(Error::msg)?;
                images.push(NamedImage { name, image });
            }
            Err(error) => stderr_line!("{}: left out: {error}", row.location()),
        }
    }
    ensure!(
        !images.is_empty(),
        "{}: no image can be read",
        path.display()
    );
    Ok(images)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_left_out_for_one_reason_are_one_line_with_every_name() {
        let images: Vec<ImageResidual> = (0..300)
            .map(|number| ImageResidual {
                name: format!("frames/{number:03}.png"),
                points: 0,
                rms_px: 0.0,
                left_out: match number {
                    3 => Some("too few line points: 5".to_owned()),
                    _ if number % 100 < 50 => None,
                    _ => Some("not needed: 60 images suffice".to_owned()),
                },
            })
            .collect();
        assert_eq!(
            left_out_lines(&images),
            [
                "1 image left out: too few line points: 5 (frames/*.png: 003)",
                "150 images left out: not needed: 60 images suffice (frames/*.png: 050 to 099, 150 to 199, 250 to 299)",
            ]
        );
    }
}

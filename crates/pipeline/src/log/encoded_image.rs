//! How is an image stored? Losslessly (PNG), for viewers (JPEG), or not at all.

use anyhow::{Context, Result, anyhow};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use jpeg_encoder::ColorType;
use serde::{Deserialize, Serialize};

use vision::image::Image;

/// Compression of the images in a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ImageCompression {
    /// Lossless, so that replay can recompute vision.
    #[default]
    Png,
    /// A fifth of the size at quality 90, a tenth at 80; replay recomputes from the recorded line points.
    Jpeg,
    /// No images; replay recomputes from the recorded line points.
    None,
}

impl ImageCompression {
    /// All modes.
    pub const ALL: [ImageCompression; 3] = [
        ImageCompression::Png,
        ImageCompression::Jpeg,
        ImageCompression::None,
    ];

    /// The `format` of foxglove.CompressedImage and the file name's extension.
    pub fn name(self) -> &'static str {
        match self {
            ImageCompression::Png => "png",
            ImageCompression::Jpeg => "jpeg",
            ImageCompression::None => "none",
        }
    }

    /// The mode of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        ImageCompression::ALL
            .into_iter()
            .find(|mode| mode.name() == name)
    }
}

/// An encoded image.
#[derive(Debug, Clone, PartialEq)]
pub struct EncodedImage {
    /// PNG or JPEG.
    pub compression: ImageCompression,
    /// Bytes of the file.
    pub bytes: Vec<u8>,
}

impl EncodedImage {
    /// Encodes an image. None if the mode stores no images.
    pub fn new(source: &Image, mode: ImageCompression, jpeg_quality: u8) -> Result<Option<Self>> {
        let (width_px, height_px) = (source.width_px, source.height_px);
        let context = || format!("cannot encode an image of {width_px} × {height_px} pixels");
        let mut bytes = Vec::with_capacity(source.rgb.len());
        match mode {
            // 1.1 ms for 480 × 480 pixels with sensor noise; the next better setting takes six times as long for 1 %.
            ImageCompression::Png => {
                let encoder =
                    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up);
                let (width, height) = (width_px as u32, height_px as u32);
                let rgb = ExtendedColorType::Rgb8;
                let written = encoder.write_image(&source.rgb, width, height, rgb);
                written.with_context(context)?;
            }
            ImageCompression::Jpeg => {
                let size = |size_px| u16::try_from(size_px).with_context(context);
                let (width, height) = (size(width_px)?, size(height_px)?);
                jpeg_encoder::Encoder::new(&mut bytes, jpeg_quality)
                    .encode(&source.rgb, width, height, ColorType::Rgb)
                    .with_context(context)?;
            }
            ImageCompression::None => return Ok(None),
        }
        Ok(Some(EncodedImage {
            compression: mode,
            bytes,
        }))
    }

    /// Decodes the image.
    pub fn decode(&self) -> Result<Image> {
        Image::decode(&self.bytes)
            .map_err(|reason| anyhow!("an image of the log is damaged: {reason}"))
    }
}

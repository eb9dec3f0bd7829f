//! What does the camera deliver? A borrowed frame in the camera's own pixel format, and images from files.

use std::path::Path;

use crate::error::VisionError;

/// How a frame's bytes make pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    /// Red, green, blue; 8 bits each.
    Rgb8,
    /// Blue, green, red; 8 bits each (OpenCV's order).
    Bgr8,
    /// Brightness alone, 8 bits.
    Grey8,
}

impl PixelFormat {
    /// Bytes that a row of so many pixels needs at least.
    pub fn row_bytes(self, width_px: usize) -> usize {
        match self {
            PixelFormat::Rgb8 | PixelFormat::Bgr8 => 3 * width_px,
            PixelFormat::Grey8 => width_px,
        }
    }
}

/// One frame, borrowed from whoever holds its bytes.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// How the bytes make pixels.
    pub format: PixelFormat,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// Row by row from the top.
    pub data: &'a [u8],
}

impl<'a> Frame<'a> {
    /// A frame whose rows follow each other without gaps.
    pub fn packed(width_px: usize, height_px: usize, format: PixelFormat, data: &'a [u8]) -> Self {
        Frame {
            width_px,
            height_px,
            format,
            stride: format.row_bytes(width_px),
            data,
        }
    }

    /// Refuses a frame of another size than wanted or with bytes missing.
    pub fn check(&self, width_px: usize, height_px: usize) -> Result<(), VisionError> {
        if (self.width_px, self.height_px) != (width_px, height_px) {
            return Err(VisionError::Size {
                found_width_px: self.width_px,
                found_height_px: self.height_px,
                wanted_width_px: width_px,
                wanted_height_px: height_px,
            });
        }
        let row = self.format.row_bytes(width_px);
        let wanted = self.stride.max(row) * height_px.saturating_sub(1) + row;
        if self.data.len() < wanted || self.stride < row {
            return Err(VisionError::Torn {
                found: self.data.len(),
                wanted,
            });
        }
        Ok(())
    }

    /// Red, green and blue of a pixel inside the frame.
    pub fn rgb(&self, column: usize, row: usize) -> [u8; 3] {
        let start = row * self.stride;
        match self.format {
            PixelFormat::Rgb8 => {
                let at = start + 3 * column;
                [self.data[at], self.data[at + 1], self.data[at + 2]]
            }
            PixelFormat::Bgr8 => {
                let at = start + 3 * column;
                [self.data[at + 2], self.data[at + 1], self.data[at]]
            }
            PixelFormat::Grey8 => [self.data[start + column]; 3],
        }
    }
}

/// An image that owns its bytes: red, green, blue, row by row, packed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// `3 · width_px · height_px` bytes.
    pub rgb: Vec<u8>,
}

impl Image {
    /// Decodes a PNG or JPEG file.
    pub fn load(path: &Path) -> Result<Self, VisionError> {
        let refuse = |reason: String| VisionError::Image {
            path: path.to_owned(),
            reason,
        };
        let reader = image::ImageReader::open(path)
            .map_err(|error| refuse(error.to_string()))?
            .with_guessed_format()
            .map_err(|error| refuse(error.to_string()))?;
        let decoded = reader
            .decode()
            .map_err(|error| refuse(error.to_string()))?
            .into_rgb8();
        Ok(Image {
            width_px: decoded.width() as usize,
            height_px: decoded.height() as usize,
            rgb: decoded.into_raw(),
        })
    }

    /// Writes a PNG or JPEG file, as its name ends.
    pub fn save(&self, path: &Path) -> Result<(), VisionError> {
        image::save_buffer(
            path,
            &self.rgb,
            self.width_px as u32,
            self.height_px as u32,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(|error| VisionError::File {
            path: path.to_owned(),
            reason: error.to_string(),
        })
    }

    /// The image as a frame.
    pub fn frame(&self) -> Frame<'_> {
        Frame::packed(self.width_px, self.height_px, PixelFormat::Rgb8, &self.rgb)
    }
}

//! A camera driver's frame as the pipeline takes it: the same bytes, without a copy.

use hw::camera::{CapturedImage, Encoding};
use pipeline::sample::RawImage;
use vision::image::PixelFormat;

/// The driver's frame with its buffer; JPEG must have been decoded.
pub fn raw_image(frame: CapturedImage) -> RawImage {
    RawImage {
        width_px: frame.width_px,
        height_px: frame.height_px,
        format: pixel_format(frame.encoding),
        stride: frame.stride,
        data: frame.data,
    }
}

fn pixel_format(encoding: Encoding) -> PixelFormat {
    match encoding {
        Encoding::Yuyv => PixelFormat::Yuyv,
        Encoding::Uyvy => PixelFormat::Uyvy,
        Encoding::Nv12 => PixelFormat::Nv12,
        Encoding::Bgr8 => PixelFormat::Bgr8,
        Encoding::Grey8 => PixelFormat::Grey8,
        Encoding::BayerRggb => PixelFormat::BayerRggb,
        Encoding::BayerGrbg => PixelFormat::BayerGrbg,
        Encoding::BayerGbrg => PixelFormat::BayerGbrg,
        Encoding::BayerBggr => PixelFormat::BayerBggr,
        Encoding::Rgb8 | Encoding::Mjpeg => PixelFormat::Rgb8,
    }
}

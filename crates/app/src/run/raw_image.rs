//! How does a driver's image become the pipeline's? The same buffer, without a copy.

use hw::camera::{CapturedImage, Encoding};
use pipeline::sample::RawImage;
use vision::image::PixelFormat;

/// Converts the driver's image with its buffer; JPEG must have been decoded.
pub(crate) fn raw_image(image: CapturedImage) -> RawImage {
    RawImage {
        width_px: image.width_px,
        height_px: image.height_px,
        format: pixel_format(image.encoding),
        stride: image.stride,
        data: image.data,
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

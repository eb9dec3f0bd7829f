//! How does the light of a scene become an image? Motion blur, scattering, exposure, mosaic, tone curve, compression.

use std::ops::Range;

use rand_chacha::ChaCha8Rng;

use super::image::{LightImage, hood};
use super::lanes::LANES;
use super::motion_blur::MotionBlur;
use super::own_body::OwnBody;
use super::row_transform::CameraMotion;
use super::scatter::Scatter;
use crate::image_sensor::{
    ImageSensor, ImageSensorConfig, JpegCompression, Pcg, Raw, SiteGains, demosaic_row,
    site_colours,
};

/// From light to bytes.
pub(super) struct Development {
    size_px: [usize; 2],
    motion_blur: MotionBlur,
    own: OwnBody,
    /// Columns without a ray in each row.
    blank: Vec<Vec<Range<usize>>>,
    /// Columns of each row that something in front of the camera hides.
    occluded: Vec<Vec<usize>>,
    scatter: Scatter,
    image_sensor: ImageSensor,
    pcg: Pcg,
    raw: Raw,
    /// All bits set in even columns, none in odd ones.
    even: Vec<u16>,
    /// Squared distance from the image's centre over that of its corners, by columns and by rows.
    falloff: [Vec<f32>; 2],
    /// Light of one row in the colours that its pixels measure, without and with scattered light.
    light: Vec<u16>,
    site_light: Vec<f32>,
    scale: Vec<f32>,
    tones: [Vec<u16>; 3],
    jpeg: Option<JpegCompression>,
}

/// What is constant during the development of one image.
struct Exposure<'a> {
    image: &'a LightImage,
    smeared: bool,
    scattered: bool,
    image_sensor: &'a ImageSensorConfig,
}

impl Development {
    pub(super) fn new(
        [width_px, height_px]: [usize; 2],
        motion_blur: MotionBlur,
        own: OwnBody,
        blank: Vec<Vec<Range<usize>>>,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let (middle_u, middle_v) = (width_px as f32 / 2.0, height_px as f32 / 2.0);
        let corner2 = middle_u * middle_u + middle_v * middle_v;
        let falloff = |count: usize, middle: f32| {
            (0..count)
                .map(|pixel| (pixel as f32 - middle).powi(2) / corner2)
                .collect()
        };
        Development {
            size_px: [width_px, height_px],
            motion_blur,
            own,
            blank,
            occluded: vec![Vec::new(); height_px.next_multiple_of(LANES)],
            scatter: Scatter::default(),
            image_sensor: ImageSensor::new(width_px, rng),
            pcg: Pcg::new(rng),
            raw: Raw::new(width_px, height_px),
            even: (0..width_px)
                .map(|column| if column % 2 == 0 { u16::MAX } else { 0 })
                .collect(),
            falloff: [falloff(width_px, middle_u), falloff(height_px, middle_v)],
            light: Vec::new(),
            site_light: vec![0.0; width_px],
            scale: vec![0.0; width_px],
            tones: [0; 3].map(|_| vec![0; width_px]),
            jpeg: None,
        }
    }

    pub(super) fn develop(
        &mut self,
        image: &LightImage,
        motion: &CameraMotion,
        image_sensor: &ImageSensorConfig,
        light_colour: [f32; 3],
        pixels: &mut [[u8; 3]],
    ) {
        let exposure = Exposure {
            image,
            smeared: self.motion_blur.set_motion(motion),
            scattered: image_sensor.bloom + image_sensor.glare > 0.0,
            image_sensor,
        };
        if exposure.scattered {
            self.scatter.update(image, &self.own.cells, image_sensor);
        }
        self.light.resize(image.stride, 0);
        if image_sensor.bayer {
            self.develop_mosaic(&exposure, light_colour, pixels);
        } else {
            self.develop_colours(&exposure, light_colour, pixels);
        }
        self.compress(image_sensor.jpeg_quality, pixels);
    }

    /// Each pixel measures one colour.
    fn develop_mosaic(
        &mut self,
        exposure: &Exposure,
        light_colour: [f32; 3],
        pixels: &mut [[u8; 3]],
    ) {
        let [width_px, height_px] = self.size_px;
        let gains = [0, 1].map(|row| {
            SiteGains::new(
                exposure.image_sensor,
                light_colour,
                site_colours(row),
                width_px,
            )
        });
        for row in 0..height_px {
            let colours = site_colours(row);
            self.set_light(exposure, row, colours);
            self.set_scale(exposure.image_sensor, row);
            self.set_site_light(exposure, row, colours, row % 2);
            self.image_sensor.expose_row(
                exposure.image_sensor.haze,
                &gains[row % 2],
                &self.site_light,
                &self.scale,
                &mut self.pcg,
                self.raw.row_mut(row),
            );
        }
        self.raw.fill_border();
        for (row, pixels) in pixels.chunks_mut(width_px).enumerate() {
            let planes = self.tones.each_mut().map(|plane| &mut plane[..]);
            demosaic_row(row, self.raw.neighbourhood(row), &self.even, planes);
            let tones = self.tones.each_ref().map(|plane| &plane[..]);
            self.image_sensor.tone_map(tones, pixels);
        }
    }

    /// Each pixel measures all colours.
    fn develop_colours(
        &mut self,
        exposure: &Exposure,
        light_colour: [f32; 3],
        pixels: &mut [[u8; 3]],
    ) {
        let width_px = self.size_px[0];
        let gains = [0, 1, 2].map(|colour| {
            SiteGains::new(exposure.image_sensor, light_colour, [colour; 2], width_px)
        });
        for (row, pixels) in pixels.chunks_mut(width_px).enumerate() {
            self.set_scale(exposure.image_sensor, row);
            for (colour, gains) in gains.iter().enumerate() {
                self.set_light(exposure, row, [colour; 2]);
                self.set_site_light(exposure, row, [colour; 2], colour);
                self.image_sensor.expose_row(
                    exposure.image_sensor.haze,
                    gains,
                    &self.site_light,
                    &self.scale,
                    &mut self.pcg,
                    &mut self.tones[colour],
                );
            }
            let tones = self.tones.each_ref().map(|plane| &plane[..]);
            self.image_sensor.tone_map(tones, pixels);
        }
    }

    /// Vignetting of a row.
    fn set_scale(&mut self, image_sensor: &ImageSensorConfig, row: usize) {
        let [columns, rows] = &self.falloff;
        for (scale, column) in self.scale.iter_mut().zip(columns) {
            *scale = 1.0 - image_sensor.vignetting * (column + rows[row]);
        }
    }

    /// Light of a row of pixels that measure two colours in even and odd columns, smeared by motion, behind the robot's own
    /// parts.
    fn set_light(&mut self, exposure: &Exposure, row: usize, colours: [usize; 2]) {
        let image = exposure.image;
        let light = &mut self.light;
        if exposure.smeared {
            self.motion_blur.blur_row(image, row, colours, light);
        } else {
            let [even, odd] =
                colours.map(|colour| &image.plane(colour)[row * image.stride..][..image.stride]);
            let planes = even.as_chunks::<2>().0.iter().zip(odd.as_chunks::<2>().0);
            for (light, (even, odd)) in light.as_chunks_mut::<2>().0.iter_mut().zip(planes) {
                *light = [even[0], odd[1]];
            }
        }
        self.own.draw(row, colours, light);
        // The rim moves with the camera: nothing smears over it.
        let hood = colours.map(|colour| hood()[colour]);
        for run in &self.blank[row] {
            for (light, mask) in light[run.clone()].iter_mut().zip(&self.even[run.clone()]) {
                *light = (hood[0] & mask) | (hood[1] & !mask);
            }
        }
        for column in &self.occluded[row] {
            light[*column] = hood[column % 2];
        }
    }

    /// Forgets what hides pixels.
    pub(super) fn clear_occluded(&mut self) {
        self.occluded.iter_mut().for_each(Vec::clear);
    }

    /// Hides a pixel of the next image, the robot's own parts included.
    pub(super) fn occlude(&mut self, column: usize, row: usize) {
        self.occluded[row].push(column);
    }

    /// Light on a row of pixels that measure two colours in even and odd columns, scattered light included.
    fn set_site_light(
        &mut self,
        exposure: &Exposure,
        row: usize,
        colours: [usize; 2],
        pattern: usize,
    ) {
        let image_sensor = exposure.image_sensor;
        let direct = 1.0 - image_sensor.bloom - image_sensor.glare;
        let sites = self.light.iter().map(|light| f32::from(*light));
        if exposure.scattered {
            let ([above, below], part) = self.scatter.row(row, colours, pattern);
            let scattered = above.iter().zip(below);
            for ((out, site), (above, below)) in
                self.site_light.iter_mut().zip(sites).zip(scattered)
            {
                *out = direct.mul_add(site, part.mul_add(below - above, *above));
            }
        } else {
            for (out, site) in self.site_light.iter_mut().zip(sites) {
                *out = direct * site;
            }
        }
    }

    fn compress(&mut self, quality: u8, pixels: &mut [[u8; 3]]) {
        if quality == 0 {
            return;
        }
        let jpeg = match &mut self.jpeg {
            Some(jpeg) if jpeg.quality() == quality => jpeg,
            other => other.insert(JpegCompression::new(quality)),
        };
        jpeg.compress(pixels, self.size_px[0]);
    }
}

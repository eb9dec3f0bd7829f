//! Letters of pictures that commands write.

use vision::image::Image;
use vision::overlay::{self, Rgb};

/// Width of a letter, pixels.
pub(crate) const LETTER_WIDTH_PX: i64 = 8;
/// Height of a letter, pixels: each row of the font is drawn twice, since 8 × 16 letters read better than 8 × 8.
pub(crate) const LETTER_HEIGHT_PX: i64 = 16;

/// Rows of a letter, bit 0 leftmost. None outside ASCII.
pub(crate) fn glyph(letter: char) -> Option<[u8; 8]> {
    font8x8::legacy::BASIC_LEGACY.get(letter as usize).copied()
}

/// One line of text with its left top corner at pixels; what lies outside the image is left out.
pub(crate) fn draw_text(image: &mut Image, [left, top]: [i64; 2], text: &str, colour: Rgb) {
    for (index, letter) in text.chars().enumerate() {
        let Some(rows) = glyph(letter) else { continue };
        for (row, bits) in rows.into_iter().enumerate() {
            for column in (0..LETTER_WIDTH_PX).filter(|column| bits >> column & 1 == 1) {
                let u = left + LETTER_WIDTH_PX * index as i64 + column;
                let v = top + 2 * row as i64;
                overlay::draw_pixel(image, u, v, colour);
                overlay::draw_pixel(image, u, v + 1, colour);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_drawn_inside_its_box_and_clipped_at_the_border() {
        let mut image = Image {
            width_px: 60,
            height_px: 20,
            rgb: vec![0; 3 * 60 * 20],
        };
        draw_text(&mut image, [4, 2], "5 m", [255, 0, 0]);
        let lit: Vec<usize> = (0..60 * 20)
            .filter(|pixel| image.rgb[3 * pixel] == 255)
            .collect();
        assert!(lit.len() > 40);
        let inside = |pixel: &usize| {
            (4..4 + 3 * LETTER_WIDTH_PX).contains(&((pixel % 60) as i64))
                && (2..2 + LETTER_HEIGHT_PX).contains(&((pixel / 60) as i64))
        };
        assert!(lit.iter().all(inside));
        draw_text(&mut image, [55, 15], "88", [255, 0, 0]);
        draw_text(&mut image, [-5, -5], "88", [255, 0, 0]);
    }
}

//! In which colours? Okabe and Ito's eight, which stay apart whatever one's colour vision; and each sign has a shape too.

use eframe::egui::Color32;
use localize::estimate::Mode;
use vision::colour::lookup_table::ColourClass;
use vision::lines::detection::RejectionReason;

pub(crate) const ORANGE: Color32 = Color32::from_rgb(230, 159, 0);
pub(crate) const SKY: Color32 = Color32::from_rgb(86, 180, 233);
pub(crate) const GREEN: Color32 = Color32::from_rgb(0, 158, 115);
pub(crate) const YELLOW: Color32 = Color32::from_rgb(240, 228, 66);
pub(crate) const BLUE: Color32 = Color32::from_rgb(0, 114, 178);
pub(crate) const VERMILION: Color32 = Color32::from_rgb(213, 94, 0);
pub(crate) const PURPLE: Color32 = Color32::from_rgb(204, 121, 167);
pub(crate) const GREY: Color32 = Color32::from_rgb(150, 150, 150);

/// The carpet of the field panel: dark enough for every one of the eight.
pub(crate) const CARPET: Color32 = Color32::from_rgb(24, 62, 46);
/// The floor around it.
pub(crate) const FLOOR: Color32 = Color32::from_rgb(38, 40, 44);
/// Markings.
pub(crate) const LINE: Color32 = Color32::from_rgb(222, 228, 222);
/// Where the robot takes itself to be.
pub(crate) const ESTIMATE: Color32 = ORANGE;
/// Where it truly is.
pub(crate) const TRUTH: Color32 = SKY;
/// Line points.
pub(crate) const LINE_POINT: Color32 = VERMILION;
/// The field's lines in the camera's image, and rings on the ground.
pub(crate) const PROJECTED_LINE: Color32 = SKY;
/// The ball.
pub(crate) const BALL: Color32 = YELLOW;
/// Robots.
pub(crate) const ROBOT: Color32 = PURPLE;
/// Goals and posts.
pub(crate) const GOAL: Color32 = Color32::WHITE;

/// The colour that a class is painted in.
pub(crate) fn class_colour(class: ColourClass) -> Color32 {
    match class {
        ColourClass::BLACK => Color32::BLACK,
        ColourClass::WHITE => Color32::WHITE,
        ColourClass::CARPET => GREEN,
        ColourClass::RED => VERMILION,
        ColourClass::BLUE => BLUE,
        ColourClass::CYAN => SKY,
        ColourClass::MAGENTA => PURPLE,
        ColourClass::YELLOW => YELLOW,
        ColourClass::BALL => ORANGE,
        _ => GREY,
    }
}

/// The colour and the words of a refusal.
pub(crate) fn rejection_style(reason: RejectionReason) -> (Color32, &'static str) {
    match reason {
        RejectionReason::NoAdjacentCarpet => (GREY, "no carpet beside it"),
        RejectionReason::TooNarrow => (YELLOW, "too narrow"),
        RejectionReason::TooWide => (SKY, "too wide"),
        RejectionReason::TooFaint => (PURPLE, "too faint"),
        RejectionReason::NotWhite => (BLUE, "not white"),
        RejectionReason::BeyondCarpet => (GREEN, "beyond the carpet"),
    }
}

/// The colour of a mode.
pub(crate) fn mode_colour(mode: Mode) -> Color32 {
    match mode {
        Mode::Tracking => GREEN,
        Mode::Global => SKY,
        Mode::Lost => VERMILION,
    }
}

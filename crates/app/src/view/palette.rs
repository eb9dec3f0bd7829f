//! Colours of the view: Okabe and Ito's palette, distinguishable with colour vision deficiency. Marks also differ in shape.

use eframe::egui::Color32;
use localize::estimate::Mode;
use vision::colour::lookup_table::ColourClass;
use vision::lines::detection::RejectionReason;

use super::status_message::StatusMessage;

pub(crate) const ORANGE: Color32 = Color32::from_rgb(230, 159, 0);
pub(crate) const SKY: Color32 = Color32::from_rgb(86, 180, 233);
pub(crate) const GREEN: Color32 = Color32::from_rgb(0, 158, 115);
pub(crate) const YELLOW: Color32 = Color32::from_rgb(240, 228, 66);
pub(crate) const BLUE: Color32 = Color32::from_rgb(0, 114, 178);
pub(crate) const VERMILION: Color32 = Color32::from_rgb(213, 94, 0);
pub(crate) const PURPLE: Color32 = Color32::from_rgb(204, 121, 167);
pub(crate) const GREY: Color32 = Color32::from_rgb(150, 150, 150);

/// Carpet of the field panel: dark enough for contrast with every palette colour.
pub(crate) const CARPET: Color32 = Color32::from_rgb(24, 62, 46);
/// Floor around the carpet.
pub(crate) const FLOOR: Color32 = Color32::from_rgb(38, 40, 44);
/// Field markings.
pub(crate) const LINE: Color32 = Color32::from_rgb(222, 228, 222);
/// Estimated pose.
pub(crate) const ESTIMATE: Color32 = ORANGE;
/// True pose.
pub(crate) const TRUTH: Color32 = SKY;
/// Line points.
pub(crate) const LINE_POINT: Color32 = VERMILION;
/// Projected field lines and the ground grid.
pub(crate) const PROJECTED_LINE: Color32 = SKY;
/// Ball.
pub(crate) const BALL: Color32 = YELLOW;
/// Robots.
pub(crate) const ROBOT: Color32 = PURPLE;
/// Goals and posts.
pub(crate) const GOAL: Color32 = Color32::WHITE;

/// Display colour of a colour class. Not injective: all other classes share one grey.
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

/// Display colour and description of a rejection reason.
pub(crate) fn rejection_style(reason: RejectionReason) -> (Color32, &'static str) {
    match reason {
        RejectionReason::NoAdjacentCarpet => (GREY, "no adjacent carpet"),
        RejectionReason::TooNarrow => (YELLOW, "too narrow"),
        RejectionReason::TooWide => (SKY, "too wide"),
        RejectionReason::TooFaint => (PURPLE, "too faint"),
        RejectionReason::NotWhite => (BLUE, "not white"),
        RejectionReason::BeyondCarpet => (GREEN, "beyond the carpet"),
    }
}

/// Display colour of a localization mode.
pub(crate) fn mode_colour(mode: Mode) -> Color32 {
    match mode {
        Mode::Tracking => GREEN,
        Mode::Global => SKY,
        Mode::Lost => VERMILION,
    }
}

/// Colour of a run that is shown beside the first one, by its number.
pub(crate) fn run_colour(number: usize) -> Color32 {
    const COLOURS: [Color32; 5] = [GREEN, SKY, PURPLE, YELLOW, VERMILION];
    COLOURS[number % COLOURS.len()]
}

/// Colour of an action's outcome.
pub(crate) fn message_colour(message: &StatusMessage) -> Color32 {
    if message.ok { GREEN } else { VERMILION }
}

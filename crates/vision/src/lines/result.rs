//! Results of line detection: line points, and rejected peaks with their reason.

use localize::sample::LinePoint;

/// Why a peak is not a line point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RejectionReason {
    /// No carpet on one side.
    NoAdjacentCarpet,
    /// Narrower on the ground than a line.
    TooNarrow,
    /// Wider on the ground than a line, even if crossed aslant.
    TooWide,
    /// Contrast within noise, or below that of a line of this width.
    TooFaint,
    /// The added light is not white.
    NotWhite,
    /// Beyond the carpet's boundary.
    BeyondCarpet,
}

/// A peak that is not a line point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RejectedCandidate {
    /// Its maximum in the image: column, row, pixels.
    pub position_px: [f32; 2],
    /// Why it was rejected.
    pub reason: RejectionReason,
}

/// A line point on the ground and in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePointDetection {
    /// Ground point, robot frame.
    pub point: LinePoint,
    /// Image position: column, row, pixels.
    pub position_px: [f32; 2],
    /// Brightness above the adjacent carpet, levels of 255.
    pub contrast: f32,
    /// Width on the ground along its scan line, metres.
    pub width: f32,
}

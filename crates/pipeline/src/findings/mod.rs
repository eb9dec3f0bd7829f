//! Where did a run go wrong, and why? Cycles in, moments that a person should look at out, each with its likely causes.
//!
//! A moment is found by what the run itself says: the stated uncertainty, the truth where there is one, the wheels between two
//! images. Causes are measurements that differ from those of the rest of the run at that moment, so that no threshold has to
//! fit a certain robot or hall.

mod causes;
mod history;
mod missing;
mod moments;
mod poses;
mod record;
mod sensors;
#[cfg(test)]
mod tests;
mod wheel_path;

pub use history::RunHistory;

/// What a finding is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FindingKind {
    /// The recorder dropped cycles.
    Dropped,
    /// The map of the floor is off.
    Drift,
    /// A pose far from the truth.
    Error,
    /// No image for longer than usual.
    Gap,
    /// The pose moved otherwise than the wheels.
    Leap,
    /// The light on the field changed.
    Light,
    /// The pose is unknown.
    Lost,
    /// A pose farther from the truth than its uncertainty allows.
    Overconfident,
    /// Wheel samples were skipped because of a collision or of slip.
    Slip,
    /// The stated uncertainty is large.
    Uncertain,
    /// An image could not be used.
    Unusable,
}

/// How much a finding matters to a player.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Worth knowing; the pose need not suffer.
    Note,
    /// The pose is worse than usual and says so, or a measurement is missing.
    Warning,
    /// The pose is wrong or unknown.
    Bad,
}

/// A moment of a run: what happened, how badly, and what was unusual.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What happened.
    pub kind: FindingKind,
    /// Stamp of its first image, seconds.
    pub start: f64,
    /// Stamp of the first image after it, seconds.
    pub stop: f64,
    /// Stamp of the image at which it was worst, seconds.
    pub worst: f64,
    /// Largest value in the moment, in the unit of its kind: metres, seconds for gaps, a ratio for light.
    pub size: f64,
    /// What differed from the rest of the run, the strongest first.
    pub causes: Vec<String>,
}

impl FindingKind {
    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            FindingKind::Dropped => "dropped",
            FindingKind::Drift => "drift",
            FindingKind::Error => "error",
            FindingKind::Gap => "gap",
            FindingKind::Leap => "leap",
            FindingKind::Light => "light",
            FindingKind::Lost => "lost",
            FindingKind::Overconfident => "overconfident",
            FindingKind::Slip => "slip",
            FindingKind::Uncertain => "uncertain",
            FindingKind::Unusable => "unusable",
        }
    }

    /// How much it matters.
    pub fn severity(self) -> Severity {
        match self {
            FindingKind::Error
            | FindingKind::Overconfident
            | FindingKind::Lost
            | FindingKind::Leap => Severity::Bad,
            FindingKind::Uncertain
            | FindingKind::Drift
            | FindingKind::Unusable
            | FindingKind::Gap
            | FindingKind::Dropped => Severity::Warning,
            FindingKind::Slip | FindingKind::Light => Severity::Note,
        }
    }
}

impl Severity {
    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            Severity::Note => "note",
            Severity::Warning => "warning",
            Severity::Bad => "bad",
        }
    }
}

impl Finding {
    /// The finding in one sentence.
    pub fn sentence(&self) -> String {
        let (size, cm) = (self.size, 100.0 * self.size);
        let seconds = self.stop - self.start;
        let what = match self.kind {
            FindingKind::Dropped => format!("recorder drops cycles for {size:.2} s"),
            FindingKind::Drift => format!("map is off by {cm:.1} cm at 3 m"),
            FindingKind::Error => format!("{cm:.0} cm wrong"),
            FindingKind::Gap => format!("no image for {size:.2} s"),
            FindingKind::Leap => format!("pose leaps by {cm:.0} cm"),
            FindingKind::Light => format!("light changes {size:.1}-fold"),
            FindingKind::Lost => format!("lost for {seconds:.2} s"),
            FindingKind::Overconfident => format!("{cm:.1} cm wrong, far more than stated"),
            FindingKind::Slip => format!("collision or slip for {seconds:.2} s"),
            FindingKind::Uncertain => format!("uncertain by {cm:.0} cm"),
            FindingKind::Unusable => "image cannot be used".to_owned(),
        };
        let at = format!("{what} at {:.2} s", self.worst);
        if self.causes.is_empty() {
            at
        } else {
            format!("{at}: {}", self.causes.join(", "))
        }
    }
}

//! What did the check of a set-up find? Figures, edits and warnings.

use localize::map_correction::DriveFit;
use localize::setup_check::Explanation;
use nalgebra::Matrix3;
use serde::Serialize;

use super::assess::{Assessment, Improvement};
use super::ranges::RangeFinding;
use crate::image_faults::ImageFaults;
use crate::recording::Table;
use crate::setup::{SensorSource, Setup};

/// How well the set-up explains its measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FitFigures {
    /// Keyframes that were compared.
    pub keyframes: usize,
    /// Share of the measurements that are explained: the shares below, multiplied.
    pub fit: f32,
    /// Share of the line points on markings.
    pub on_markings: f32,
    /// True if they lie there by a mount of the camera that the images tell, and not by the map as given.
    pub mount_learned: bool,
    /// Root mean square distance of these points from the markings, metres.
    pub residual_m: f32,
    /// How far the wheels' steps agree with those of the poses, at most 1. None without odometry.
    pub wheels_agree: Option<f32>,
    /// Share of the compass readings that agree with the poses. None without a compass.
    pub compass_agrees: Option<f32>,
}

impl FitFigures {
    pub(super) fn of(explanation: &Explanation) -> Self {
        FitFigures {
            keyframes: explanation.keyframes.len(),
            fit: explanation.fit(),
            on_markings: explanation.on_markings(),
            mount_learned: false,
            residual_m: explanation.residual(),
            wheels_agree: explanation.wheels_agree(),
            compass_agrees: explanation.compass_agrees(),
        }
    }

    /// The figures as one line.
    pub fn text(&self) -> String {
        let sensor = |name: &str, share: Option<f32>| {
            share.map_or_else(String::new, |share| {
                format!("; {name} {:.0} %", 100.0 * share)
            })
        };
        format!(
            "set-up: {:.0} % of the line points on markings{}, {:.1} cm off{}{}",
            100.0 * self.on_markings,
            if self.mount_learned {
                " by the mount that the images tell"
            } else {
                ""
            },
            100.0 * self.residual_m,
            sensor("wheels agree with", self.wheels_agree),
            sensor("compass with", self.compass_agrees),
        )
    }
}

/// An edit that makes the set-up explain the measurements better.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Suggestion {
    /// The edit to make.
    pub change: String,
    /// What is probably wrong.
    pub cause: String,
    /// False for a candidate: with it the measurements are explained better, but not well.
    pub firm: bool,
    /// Share of the measurements that are explained without it.
    pub fit_before: f32,
    /// Share of the measurements that are explained with it.
    pub fit_after: f32,
    /// Logarithm of the likelihood ratio. None where a table's range betrays the mistake.
    pub gain: Option<f32>,
    /// Both halves of the field look alike, so that this edit and the same one by half a turn more explain as much: only one of them
    /// puts the robot into its own half, and no measurement tells which.
    pub half_unknown: bool,
    /// Number of the change: those of one number are alternatives, higher numbers come on top.
    pub step: usize,
}

/// What to do about two edits of which only one puts the robot into its own half.
pub const HALF_HINT: &str = "Both halves of this field look alike, so that no measurement tells the two apart: look on which half \
                             the robot stands, and keep the edit with which its poses lie there";

impl Suggestion {
    /// What the edit explains, in words.
    pub fn explained_text(&self) -> String {
        explained_text(self.fit_before, self.fit_after)
    }
}

fn explained_text(before: f32, after: f32) -> String {
    let [before, after] = [before, after].map(|share| (100.0 * share).round());
    if after > before {
        format!("explains {after} % instead of {before} %")
    } else {
        "explains as much, more exactly".to_owned()
    }
}

/// What the check of a set-up found.
#[derive(Debug, Clone, Default, Serialize)]
pub struct SetupReport {
    /// Fit of the configured set-up. None if nothing could be compared.
    pub figures: Option<FitFigures>,
    /// One sentence per doubt; empty when all is well.
    pub warnings: Vec<String>,
    /// Those of the warnings for which no edit is known.
    pub doubts: Vec<String>,
    /// Images that cannot be used. None if not all were checked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image_faults: Option<ImageFaults>,
    /// Edits, the first one first.
    pub suggestions: Vec<Suggestion>,
    /// Covariance that the poses of this set-up have at least.
    #[serde(skip)]
    pub added_pose_covariance: Option<Matrix3<f32>>,
    /// Errors of the map that the images tell, such as localization expects them.
    #[serde(skip)]
    pub map_fit: Option<Box<DriveFit>>,
    /// Tables in a wrong unit, which are left out.
    #[serde(skip)]
    pub unusable: Vec<Table>,
    /// What measured.
    #[serde(skip)]
    pub sensors: SensorSource,
}

impl SetupReport {
    /// Adds the edits with which the measurements fit better, and a warning for the best one of each step.
    pub(super) fn add_improvements(&mut self, setup: &Setup, assessment: &Assessment) {
        let mut before = &assessment.configured;
        for (step, alternatives) in assessment.improvements.iter().enumerate() {
            let has_twin = |improvement: &Improvement| {
                let twin = improvement.change.half_turn_twin();
                twin.is_some_and(|twin| alternatives.iter().any(|other| other.change == twin))
            };
            self.suggestions
                .extend(alternatives.iter().map(|improvement| Suggestion {
                    change: improvement.change.text(setup, &improvement.after),
                    cause: improvement.change.cause().to_owned(),
                    firm: improvement.is_firm(),
                    fit_before: before.fit(),
                    fit_after: improvement.explanation.fit(),
                    gain: Some(improvement.comparison.gain),
                    half_unknown: has_twin(improvement),
                    step: step + 1,
                }));
            let Some(best) = alternatives.first() else {
                continue;
            };
            let perhaps = if best.is_firm() { "" } else { "perhaps " };
            let cause = best.change.cause();
            let other = alternatives
                .iter()
                .find(|other| other.change.cause() != cause)
                .map_or_else(String::new, |other| {
                    let (cause, text) =
                        (other.change.cause(), other.change.text(setup, &other.after));
                    format!(", or else {cause}: as well with `{text}`")
                });
            let twin = best.change.half_turn_twin();
            let twin = alternatives
                .iter()
                .find(|other| Some(&other.change) == twin.as_ref());
            let [twin, hint] = twin.map_or_else(Default::default, |twin| {
                let text = twin.change.text(setup, &twin.after);
                [format!(" or `{text}`"), format!(". {HALF_HINT}")]
            });
            self.warnings.push(format!(
                "{perhaps}{cause}: the measurements fit better with `{}`{twin} ({}){other}{hint}",
                best.change.text(setup, &best.after),
                explained_text(before.fit(), best.explanation.fit()),
            ));
            before = &best.explanation;
        }
    }

    /// Adds the images that cannot be used.
    pub(super) fn with_image_faults(mut self, faults: Option<ImageFaults>) -> Self {
        let sentences = faults.iter().flat_map(ImageFaults::sentences);
        sentences.for_each(|sentence| self.doubt(sentence));
        self.image_faults = faults;
        self
    }

    /// Adds what the path of the poses betrays. Another doubt about the set-up explains it.
    pub fn with_path_warnings(mut self, found: impl IntoIterator<Item = String>) -> Self {
        if self.warnings.is_empty() {
            found.into_iter().for_each(|sentence| self.doubt(sentence));
        }
        self
    }

    /// Adds what the ranges of the tables betray.
    pub(super) fn with_ranges(mut self, ranges: &[RangeFinding]) -> Self {
        for finding in ranges {
            self.warnings
                .push(format!("{} `{}`", finding.found, finding.change));
            self.suggestions.push(Suggestion {
                change: finding.change.clone(),
                cause: finding.found.clone(),
                firm: true,
                fit_before: finding.fit[0],
                fit_after: finding.fit[1],
                gain: None,
                half_unknown: false,
                step: self.suggestions.last().map_or(0, |last| last.step) + 1,
            });
            if finding.table != Table::Images {
                self.unusable.push(finding.table);
            }
        }
        self
    }
}

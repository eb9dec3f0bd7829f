//! How is an estimate converted to its message and back?

use anyhow::{Context as _, Result, bail};
use localize::Stamp;
use localize::advice::{Advice, MotionAdvice};
use localize::estimate::{Estimate, Fit, Mode, Reason};
use localize::global_search::branch_and_bound::{Certificate, Hypothesis};
use localize::map_correction::{MapCorrectionEstimate, TermEstimate, TermKind};
use localize::omni::Twist;
use nalgebra::Matrix3;

use super::super::wire;
use super::geometry::{matrix, pair, pose_from_wire, pose_to_wire};
use super::names::names;

names!(mode_name, mode_named: Mode { Tracking = "tracking", Global = "global", Lost = "lost" });
names!(reason_name, reason_named: Reason {
    FewPoints = "few points",
    PoorMatch = "poor match",
    BetterAlternative = "better alternative" | "rival",
    CompassConflict = "compass conflict" | "compass contradicts",
    DeadReckoningTimeout = "dead reckoning timeout" | "blind",
    NoMatch = "no match" | "nothing fits",
    Ambiguous = "ambiguous",
    OutOfOrder = "out of order" | "from the past",
    Searching = "searching",
    DoubtfulSetup = "doubtful set-up",
    CameraKnocked = "camera knocked",
});
pub(crate) fn estimate_to_wire(estimate: &Estimate) -> wire::Estimate {
    let Estimate {
        stamp,
        pose,
        covariance,
        repeated_covariance,
        mode,
        reason,
        inlier_rms: residual,
        inlier_share,
        line_points,
        tilt: lean,
        half_known,
        odometry_scales,
        odometry_correction,
        twist,
        collision,
        gyro_bias,
        latency,
        fit,
        map_correction,
        runners_up,
        certificate,
        advice,
    } = estimate;
    wire::Estimate {
        stamp_ns: stamp.0,
        pose: pose.map(pose_to_wire),
        covariance: covariance.transpose().iter().copied().collect(),
        mode: mode_name(*mode).to_owned(),
        reason: reason.map_or("", reason_name).to_owned(),
        residual: *residual,
        inlier_share: *inlier_share,
        line_points: *line_points as u32,
        lean: lean.to_vec(),
        half_known: *half_known,
        odometry_scales: odometry_scales.to_vec(),
        runners_up: runners_up.iter().map(hypothesis_to_wire).collect(),
        twist: twist.map_or_else(Vec::new, |twist| vec![twist.x, twist.y, twist.theta]),
        collision: *collision,
        gyro_bias: *gyro_bias,
        latency: *latency,
        fit: Some(wire::Fit {
            on_markings: fit.on_markings,
            residual: fit.inlier_rms,
            markings_seen: fit.markings_seen,
            wheels: fit.wheel_agreement,
            compass: fit.compass_agreement,
        }),
        map_correction: map_correction.as_ref().map(map_correction_to_wire),
        odometry_correction: odometry_correction.as_flattened().to_vec(),
        certificate: certificate.map(|certificate| wire::Certificate {
            points: certificate.points as u32,
            answer_share: certificate.answer_share,
            others_share_max: certificate.others_share_max,
            unlisted_share_max: certificate.unlisted_share_max,
            is_attained: certificate.is_attained,
        }),
        advice: advice.map(advice_to_wire),
        repeated_covariance: repeated_covariance.transpose().iter().copied().collect(),
    }
}

fn advice_to_wire(advice: Advice) -> wire::Advice {
    let (motion, expected_log_odds) = match advice {
        Advice::Move(MotionAdvice {
            motion,
            expected_log_odds,
        }) => (motion.to_vec(), expected_log_odds),
        Advice::ObserveHalf => (Vec::new(), 0.0),
    };
    wire::Advice {
        text: advice.text(),
        motion,
        expected_log_odds,
    }
}

fn advice_from_wire(advice: &wire::Advice) -> Result<Advice> {
    Ok(match advice.motion[..] {
        [] => Advice::ObserveHalf,
        [x, y, theta] => Advice::Move(MotionAdvice {
            motion: [x, y, theta],
            expected_log_odds: advice.expected_log_odds,
        }),
        _ => bail!("the advised motion of the log has not 3 entries"),
    })
}

pub(crate) fn estimate_from_wire(estimate: wire::Estimate) -> Result<Estimate> {
    Ok(Estimate {
        stamp: Stamp(estimate.stamp_ns),
        pose: estimate.pose.as_ref().map(pose_from_wire),
        covariance: matrix(&estimate.covariance)?,
        repeated_covariance: match estimate.repeated_covariance[..] {
            [] => Matrix3::zeros(),
            ref values => matrix(values)?,
        },
        mode: mode_named(&estimate.mode)?,
        reason: match estimate.reason.as_str() {
            "" => None,
            reason => Some(reason_named(reason)?),
        },
        inlier_rms: estimate.residual,
        inlier_share: estimate.inlier_share,
        line_points: estimate.line_points as usize,
        tilt: pair(&estimate.lean)?,
        half_known: estimate.half_known,
        odometry_correction: odometry_correction(&estimate)?,
        odometry_scales: pair(&estimate.odometry_scales)?,
        runners_up: estimate
            .runners_up
            .into_iter()
            .map(hypothesis_from_wire)
            .collect::<Result<_>>()?,
        twist: match estimate.twist[..] {
            [x, y, theta] => Some(Twist { x, y, theta }),
            _ => None,
        },
        collision: estimate.collision,
        gyro_bias: estimate.gyro_bias,
        latency: estimate.latency,
        fit: estimate.fit.map_or_else(Fit::default, |fit| Fit {
            on_markings: fit.on_markings,
            inlier_rms: fit.residual,
            markings_seen: fit.markings_seen,
            wheel_agreement: fit.wheels,
            compass_agreement: fit.compass,
        }),
        map_correction: estimate
            .map_correction
            .map(map_correction_from_wire)
            .transpose()?,
        certificate: estimate.certificate.map(|certificate| Certificate {
            points: certificate.points as usize,
            answer_share: certificate.answer_share,
            others_share_max: certificate.others_share_max,
            unlisted_share_max: certificate.unlisted_share_max,
            is_attained: certificate.is_attained,
        }),
        advice: estimate.advice.as_ref().map(advice_from_wire).transpose()?,
    })
}

/// Logs of earlier versions have the scales alone.
fn odometry_correction(estimate: &wire::Estimate) -> Result<[[f32; 3]; 3]> {
    let [distance, yaw] = pair(&estimate.odometry_scales)?;
    Ok(match estimate.odometry_correction[..] {
        [] => [[distance, 0.0, 0.0], [0.0, distance, 0.0], [0.0, 0.0, yaw]],
        [a, b, c, d, e, f, g, h, i] => [[a, b, c], [d, e, f], [g, h, i]],
        _ => bail!("the odometry's correction of the log has not 9 entries"),
    })
}

pub(crate) fn map_correction_to_wire(map: &MapCorrectionEstimate) -> wire::MapCorrection {
    wire::MapCorrection {
        names: map
            .terms
            .iter()
            .map(|term| term.kind.name().to_owned())
            .collect(),
        values: map.terms.iter().map(|term| term.value).collect(),
        stds: map.terms.iter().map(|term| term.std).collect(),
        images: map.images,
        knocks: map.knocks,
        displacement_at_3_m: map.displacement_at_3_m,
        displacement_std_at_3_m: map.displacement_std_at_3_m,
    }
}

fn map_correction_from_wire(map: wire::MapCorrection) -> Result<MapCorrectionEstimate> {
    let values = map.values.into_iter().zip(map.stds);
    let terms = map.names.iter().zip(values).map(|(name, (value, std))| {
        let kind = TermKind::from_name(name)
            .with_context(|| format!("an unknown of the map with the unknown name {name:?}"))?;
        Ok(TermEstimate { kind, value, std })
    });
    Ok(MapCorrectionEstimate {
        terms: terms.collect::<Result<_>>()?,
        images: map.images,
        knocks: map.knocks,
        displacement_at_3_m: map.displacement_at_3_m,
        displacement_std_at_3_m: map.displacement_std_at_3_m,
    })
}

fn hypothesis_to_wire(hypothesis: &Hypothesis) -> wire::Hypothesis {
    let Hypothesis {
        pose,
        covariance,
        probability,
        score,
        inlier_share,
        inlier_rms: residual,
        tilt: lean,
    } = hypothesis;
    wire::Hypothesis {
        pose: pose_to_wire(*pose),
        covariance: covariance.transpose().iter().copied().collect(),
        probability: *probability,
        score: *score,
        inlier_share: *inlier_share,
        residual: *residual,
        lean: lean.to_vec(),
    }
}

fn hypothesis_from_wire(hypothesis: wire::Hypothesis) -> Result<Hypothesis> {
    Ok(Hypothesis {
        pose: pose_from_wire(&hypothesis.pose),
        covariance: matrix(&hypothesis.covariance)?,
        probability: hypothesis.probability,
        score: hypothesis.score,
        inlier_share: hypothesis.inlier_share,
        inlier_rms: hypothesis.residual,
        tilt: pair(&hypothesis.lean)?,
    })
}

/// The estimate's reason as text; empty if the pose is simply tracked.
pub fn reason_text(estimate: &Estimate) -> &'static str {
    estimate.reason.map_or("", reason_name)
}

/// The estimate's mode and reason as text, with the advice for an ambiguous pose.
pub fn mode_and_advice(estimate: &Estimate) -> String {
    let text = mode_and_reason(estimate);
    match &estimate.advice {
        Some(advice) => format!("{text} ({})", advice.text()),
        None => text,
    }
}

/// The estimate's mode and reason as text.
pub fn mode_and_reason(estimate: &Estimate) -> String {
    let mode = mode_name(estimate.mode);
    estimate.reason.map_or_else(
        || mode.to_owned(),
        |reason| format!("{mode}: {}", reason_name(reason)),
    )
}

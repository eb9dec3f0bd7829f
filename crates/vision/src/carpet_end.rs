//! How far does the carpet reach in each direction? Along radial lines, up to what is neither carpet nor line.

use crate::colours::Class;
use crate::config::LineConfig;
use crate::line_points::Reading;
use crate::scan::ScanKind;

/// Where the carpet ends along each radial line, metres; infinite where no end (or no carpet at all) is seen.
///
/// A cable, a shadow or a ball is passed over: only what covers more of the ground than `gap_max` plus `gap_share` of
/// its distance ends the carpet. A direction whose nearest samples are covered (own body, a rod) starts where its
/// first carpet is.
pub(crate) fn carpet_end(reading: &Reading<'_>, config: &LineConfig, ends: &mut Vec<f32>) {
    ends.clear();
    ends.resize(reading.pattern.radial_lines, f32::INFINITY);
    let mut carpet_until: Vec<Option<f32>> = vec![None; reading.pattern.radial_lines];
    for piece in &reading.pattern.pieces {
        if piece.kind != ScanKind::Radial {
            continue;
        }
        let line = piece.line as usize;
        for index in piece.start as usize..piece.end as usize {
            let range = reading.pattern.samples[index].range;
            match (reading.classes[index], carpet_until[line]) {
                (Class::CARPET, _) => {
                    if ends[line].is_finite() {
                        break;
                    }
                    carpet_until[line] = Some(range);
                }
                (_, Some(until)) if range - until > config.gap_max + config.gap_share * until => {
                    ends[line] = ends[line].min(until);
                }
                _ => {}
            }
        }
    }
}

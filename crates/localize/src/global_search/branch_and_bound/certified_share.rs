//! What does the exact search prove about other poses?

/// Bounds on what other poses of the field explain. All shares are Σ c²/(c² + d²) over the number of points compared.
///
/// The proof is about the poses of the search's grid (`cell`, `heading_step_deg`). A pose between them differs by the
/// rounding of its points. Poses closer than `separation_min` with a heading within `separation_min_deg` are one pose. On
/// a field that a half turn maps onto itself, a pose searched without a compass stands for its half turn too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Points compared.
    pub points: usize,
    /// Share that the first hypothesis explains.
    pub answer_share: f32,
    /// No pose other than the first hypothesis explains more.
    pub others_share_max: f32,
    /// No pose explains more that is not among the hypotheses.
    pub unlisted_share_max: f32,
    /// A pose explains exactly `others_share_max`: the bound cannot be lowered.
    pub is_attained: bool,
}

//! Synthetic drives and experiments: generated test data, and scores of the estimators on it.

pub mod air_ball;
pub mod certainty;
pub mod certificates;
pub mod consistency;
pub mod cooperative;
pub mod drive;
pub mod evaluation;
pub mod field_mapping;
pub mod flying_ball;
pub mod rough_drive;
pub mod starts;
pub mod team_ball;

//! Synthetic drives and experiments: generated test data, and scores of the estimators on it.

pub mod drive;
pub mod evaluation;
pub mod team_ball;

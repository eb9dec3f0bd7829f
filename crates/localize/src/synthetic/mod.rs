//! Synthetic drives and experiments: what generates test data, and what scores an estimator on it.

pub mod drive;
pub mod evaluation;
pub mod team_ball;

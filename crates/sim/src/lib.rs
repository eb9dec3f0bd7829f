//! A field in motion, and every sensor of the robot.

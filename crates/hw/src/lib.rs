//! How do devices deliver samples and take commands? Drivers; each sample is stamped.
//!
//! Each device has a thread that opens it as soon as it is present and pushes its samples into one bounded [`EventQueue`].
//! Stamps are CLOCK_MONOTONIC.

pub mod base;
mod burst;
pub mod camera;
mod can_socket;
mod clock;
pub mod config;
mod device_clock;
mod devices;
mod error;
mod event_queue;
mod health;
pub mod inertial;
mod monitor;
pub mod realtime;
mod serial;
mod serial_line;
pub mod signals;
mod stamped_socket;
pub mod wire;
mod worker;

pub use base::{BaseDriver, BaseHandle};
pub use camera::CameraDriver;
pub use can_socket::CanSocket;
pub use clock::now;
pub use config::HardwareConfig;
pub use devices::{DetectedDevice, Devices, list_devices};
pub use error::HwError;
pub use event_queue::{DeviceEvent, DroppedInputs, EventQueue};
pub use health::{HealthReport, HealthState};
pub use inertial::InertialDriver;
pub use serial::SerialPort;
pub use stamped_socket::{ReceivedDatagram, StampedSocket, realtime_offset_ns};

//! What do the devices of a robot say, and what are they told? Drivers; what arrives is a stamped sample.
//!
//! Each device has a thread that opens it whenever it is there, and puts what it says into one bounded [`Inbox`]. Stamps are
//! CLOCK_MONOTONIC.

pub mod base;
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
pub mod realtime;
mod serial;
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

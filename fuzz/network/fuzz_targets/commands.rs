//! Any datagram to the gate of commands. `tools/fuzz 60 commands`
#![no_main]

use app::net::CommandConfig;
use app::net::commands::Gate;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let config = CommandConfig {
        key: None,
        ..CommandConfig::default()
    };
    let Ok(mut gate) = Gate::new(&config) else { return };
    if let Ok(order) = gate.pass(bytes, 0.0) {
        assert!(order.valid.as_millis() <= 100);
        assert!(order.drive.is_none_or(|drive| drive.x.abs() <= config.speed_max));
        // The same again is a copy.
        assert!(gate.pass(bytes, 0.0).is_err());
    }
});

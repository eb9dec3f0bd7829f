//! Fuzzes the filter of remote commands with datagrams. Run: `tools/fuzz_coverage 60 commands`
#![no_main]

use app::{CommandConfig, CommandFilter, RobotIdentity};
use localize::Stamp;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let config = CommandConfig {
        key: None,
        ..CommandConfig::default()
    };
    let Ok(mut filter) = CommandFilter::new(&config, RobotIdentity { robot: 1, boot: 1 }) else {
        return;
    };
    if let Ok(command) = filter.accept(bytes, None, Stamp(0)) {
        assert!(command.valid_for.as_millis() <= 100);
        assert!(
            command
                .drive
                .is_none_or(|drive| drive.x.abs() <= config.speed_max)
        );
        // The same datagram again is a replay.
        assert!(filter.accept(bytes, None, Stamp(0)).is_err());
    }
});

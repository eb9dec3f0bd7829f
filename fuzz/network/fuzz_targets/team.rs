//! Fuzzes the receiver of team messages with datagrams. Run: `tools/fuzz_coverage 60 team`
#![no_main]

use localize::Stamp;
use localize::team::{TeamConfig, TeamModel};
use pipeline::datagram::{TeamLink, TeamLinkConfig};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let config = TeamLinkConfig::default();
    let Ok(mut link) = TeamLink::new(&config, 1) else {
        return;
    };
    if let Ok(report) = link.receive(bytes, Stamp(0)) {
        assert!(report.robot != config.robot && report.stamp <= Stamp(0));
        assert!(link.receive(bytes, Stamp(0)).is_err());
        let mut team = TeamModel::new(TeamConfig::default());
        team.receive(&report);
    }
});

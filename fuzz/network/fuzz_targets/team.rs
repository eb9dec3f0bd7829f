//! Any datagram to the team's talk. `tools/fuzz 60 team`
#![no_main]

use pipeline::datagram::LinkConfig;
use pipeline::datagram::Talk;
use localize::Stamp;
use localize::team::{TeamConfig, TeamModel};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Ok(mut talk) = Talk::new(&LinkConfig::default(), 1) else { return };
    if let Ok(report) = talk.hear(bytes, Stamp(0)) {
        assert!(report.robot != LinkConfig::default().robot && report.stamp <= Stamp(0));
        assert!(talk.hear(bytes, Stamp(0)).is_err());
        let mut team = TeamModel::new(TeamConfig::default());
        team.hear(&report);
    }
});

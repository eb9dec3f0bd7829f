//! Bytes as a header of the camera socket. `tools/fuzz 60 frames`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "one protocol of seven")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| oracle::frames(bytes));

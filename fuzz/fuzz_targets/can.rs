//! Bytes as a frame of a CAN bus. `tools/fuzz 60 can`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "one protocol of seven")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| oracle::can(bytes));

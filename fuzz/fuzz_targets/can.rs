//! Fuzzes the decoders of CAN frames. Run: `tools/fuzz_coverage 60 can`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "the checks of the other protocols")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| oracle::check_can(bytes));

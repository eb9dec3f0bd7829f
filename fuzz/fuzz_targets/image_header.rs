//! Fuzzes the header decoder of the camera socket. Run: `tools/fuzz_coverage 60 image_header`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "the checks of the other protocols")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| oracle::check_image_header(bytes));

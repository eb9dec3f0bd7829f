//! Fuzzes the decoder `vesc`: the first byte is the size of the pieces, the rest the stream. Run: `tools/fuzz_coverage 60 vesc`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "the checks of the other protocols")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some((cut, stream)) = bytes.split_first() {
        oracle::check_vesc(stream, &[]);
        oracle::check_vesc(stream, &[*cut]);
    }
});

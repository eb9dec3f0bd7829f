//! Fuzzes the decoder `board`: the first byte is the size of the pieces, the rest the stream. Run: `tools/fuzz_coverage 60 board`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "the checks of the other protocols")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some((cut, stream)) = bytes.split_first() {
        oracle::check_board(stream, &[]);
        oracle::check_board(stream, &[*cut]);
    }
});

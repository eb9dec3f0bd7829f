//! Bytes into the decoder of `slcan`; the first says in which pieces. `tools/fuzz 60 slcan`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "one protocol of seven")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some((cut, stream)) = bytes.split_first() {
        oracle::slcan(stream, &[]);
        oracle::slcan(stream, &[*cut]);
    }
});

//! Bytes into the decoder of `bno085`; the first says in which pieces. `tools/fuzz 60 bno085`
#![no_main]

#[path = "../../crates/hw/tests/oracle/mod.rs"]
#[expect(dead_code, reason = "one protocol of seven")]
mod oracle;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some((cut, stream)) = bytes.split_first() {
        oracle::bno085(stream, &[]);
        oracle::bno085(stream, &[*cut]);
    }
});

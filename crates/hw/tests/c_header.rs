//! Does the firmware's C header match the wire format?

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// Compiles a program (Rust's linker is a C compiler) and returns its output for `input`.
fn compile_and_run(source: &Path, include: &Path, input: &str) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("program");
    let compiled = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-I"])
        .arg(include)
        .arg("-o")
        .args([&program, source])
        .output()
        .expect("cc runs");
    let diagnostics = String::from_utf8_lossy(&compiled.stderr);
    assert!(compiled.status.success(), "{diagnostics}");
    let mut child = Command::new(&program)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program runs");
    child
        .stdin
        .take()
        .expect("its input")
        .write_all(input.as_bytes())
        .expect("written");
    let output = child.wait_with_output().expect("the program ends");
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn c_header_decodes_and_encodes_every_test_vector() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let docs = root.join("../../docs");
    let table = std::fs::read_to_string(docs.join("wire_vectors.csv")).expect("the table");
    let frames: Vec<_> = table
        .lines()
        .skip(1)
        .filter_map(|row| row.split(',').nth(1))
        .collect();
    // A wrong checksum, another version, and a frame that is too long.
    let bad = [
        "0701010101946300",
        "030201010358da00",
        &("05".repeat(200) + "00"),
    ];
    let input = [&frames[..], &bad[..]].concat().join("\n") + "\n";
    let output = compile_and_run(&root.join("tests/c/base_frames.c"), &docs, &input);
    let output: Vec<_> = output.lines().collect();
    assert_eq!(output[..frames.len()], frames);
    assert_eq!(output[frames.len()..], ["refused"; 3]);
}

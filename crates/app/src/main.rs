//! Mirrorball: eyes and a sense of place for soccer robots with an omnidirectional mirror.

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(target_arch = "x86_64")]
    if !std::is_x86_feature_detected!("avx2") || !std::is_x86_feature_detected!("fma") {
        eprintln!("mirrorball: this processor has no AVX2: build again without .cargo/config.toml");
        return ExitCode::FAILURE;
    }
    std::panic::set_hook(Box::new(|panic| {
        let reason = panic.payload_as_str().unwrap_or("no reason given");
        match reason.strip_prefix("failed printing to stdout: ") {
            // Whoever read our output has seen enough.
            Some(error) if error.contains("Broken pipe") => {}
            Some(error) => eprintln!("mirrorball: cannot write to standard output: {error}"),
            None => {
                let place = panic
                    .location()
                    .map(ToString::to_string)
                    .unwrap_or_default();
                eprintln!("mirrorball: a fault of its own, please report it: {reason} ({place})");
            }
        }
    }));
    std::panic::catch_unwind(app::cli::run).unwrap_or(ExitCode::FAILURE)
}

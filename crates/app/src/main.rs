//! Mirrorball: vision and localization for RoboCup MSL robots with an omnidirectional camera.

#![deny(clippy::print_stderr)]

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(target_arch = "x86_64")]
    if !std::is_x86_feature_detected!("avx2") || !std::is_x86_feature_detected!("fma") {
        app::print_stderr(format_args!(
            "mirrorball: unsupported processor: no AVX2 or FMA. Build without .cargo/config.toml"
        ));
        return ExitCode::FAILURE;
    }
    std::panic::set_hook(Box::new(|panic| {
        let reason = panic.payload_as_str().unwrap_or("no reason given");
        match reason.strip_prefix("failed printing to stdout: ") {
            // The reader of the output has closed the pipe.
            Some(error) if error.contains("Broken pipe") => {}
            Some(error) => app::print_stderr(format_args!(
                "mirrorball: cannot write to standard output: {error}"
            )),
            None => {
                let location = panic
                    .location()
                    .map(ToString::to_string)
                    .unwrap_or_default();
                app::print_stderr(format_args!(
                    "mirrorball: internal error: {reason} ({location}). Please report it"
                ));
            }
        }
    }));
    std::panic::catch_unwind(app::run).unwrap_or(ExitCode::FAILURE)
}

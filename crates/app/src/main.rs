//! Mirrorball: eyes and a sense of place for soccer robots with an omnidirectional mirror.

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(target_arch = "x86_64")]
    if !std::is_x86_feature_detected!("avx2") || !std::is_x86_feature_detected!("fma") {
        eprintln!("mirrorball: this processor has no AVX2: build again without .cargo/config.toml");
        return ExitCode::FAILURE;
    }
    app::cli::run()
}

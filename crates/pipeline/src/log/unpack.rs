//! How is the set-up of a log loaded? From its own files, in a temporary folder.

use anyhow::{Context, Result, anyhow};
use tempfile::TempDir;

use super::header::Header;
use crate::config::{PIPELINE_FILE, PipelineConfig};
use crate::message_text::error_message;
use crate::setup::Setup;

/// The set-up that a log or a live stream holds.
pub struct UnpackedSetup {
    /// The robot on its field. Its paths point into `folder`.
    pub setup: Setup,
    /// The files of the header. Dropping it removes them.
    pub folder: TempDir,
}

impl UnpackedSetup {
    /// Unpacks the files and loads robot.toml with what it names.
    pub fn load(header: &Header) -> Result<Self> {
        let folder =
            tempfile::tempdir().context("cannot make a temporary folder for the log's files")?;
        header.write_files(folder.path())?;
        let setup = Setup::load(&folder.path().join("robot.toml"), None)
            .map_err(|error| name_log(&error, &folder))?;
        Ok(UnpackedSetup { setup, folder })
    }

    /// The settings of the run's start; the defaults if the header holds none.
    pub fn config(&self) -> Result<PipelineConfig> {
        let settings = self.folder.path().join(PIPELINE_FILE);
        PipelineConfig::load("default", settings.exists().then_some(&*settings))
            .map_err(|error| name_log(&error, &self.folder))
    }
}

/// The files are in the log; the temporary folder means nothing to the user.
fn name_log(error: &anyhow::Error, folder: &TempDir) -> anyhow::Error {
    let unpacked = format!("{}/", folder.path().display());
    anyhow!(error_message(error).replace(&unpacked, "the log's "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problem_of_the_logs_files_is_stated_once() {
        let header = Header::new("test", None);
        let error = UnpackedSetup::load(&header).err().expect("no robot.toml");
        let error = format!("{error:#}");
        assert!(error.contains("the log's robot.toml"), "{error}");
        assert_eq!(error.matches("No such file").count(), 1, "{error}");
        let mut config = crate::testing::field().config;
        config.length = f32::NAN;
        let field = toml::to_string(&config).expect("a field");
        let header = header
            .with_file("robot.toml", "field = \"field.toml\"\n")
            .with_file("field.toml", field);
        let error = UnpackedSetup::load(&header).err().expect("no length");
        let error = format!("{error:#}");
        assert_eq!(error.matches("must be").count(), 1, "{error}");
    }
}

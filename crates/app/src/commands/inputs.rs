//! Which files does a command read? No output may replace one of them: what was measured or written by hand would be lost.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Result;
use localize::input_file;
use pipeline::csv_table::CsvTable;
use pipeline::recording::INPUT_FILES;

use super::arguments::UsageError;

/// Further names of a folder's inputs: those of a strip, and the devices and the network of a robot.
const OTHER_INPUT_FILES: [&str; 4] = ["strip.toml", "strip.csv", "hardware.toml", "network.toml"];
/// Tables that list images in their column `file`.
const IMAGE_TABLES: [&str; 2] = ["frames.csv", "strip.csv"];

/// The inputs of a command, and all files that they name.
#[derive(Debug, Default)]
pub(crate) struct Inputs {
    /// Recordings and robots. The names of their inputs are reserved, whether there is such a file or not.
    folders: Vec<PathBuf>,
    files: BTreeSet<InputFile>,
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct InputFile {
    /// Without links, so that every spelling of a path is equal.
    path: PathBuf,
    /// What the file that names it calls it: `map`, `mask`, …; of an included calibration the name of its section.
    part: String,
}

impl Inputs {
    /// Files, and folders of recordings or robots. Missing and unreadable ones are left to the command, which reports them.
    pub(crate) fn of<'a>(paths: impl IntoIterator<Item = &'a Path>) -> Self {
        let mut inputs = Inputs::default();
        for path in paths {
            if !path.is_dir() {
                inputs.add_file(path, "");
                continue;
            }
            inputs.folders.extend(path.canonicalize());
            for name in INPUT_FILES.iter().chain(&OTHER_INPUT_FILES) {
                inputs.add_file(&path.join(name), "");
            }
            for table in IMAGE_TABLES {
                inputs.add_images(&path.join(table));
            }
        }
        inputs
    }

    /// Adds a file, if there is one, that is this part of the robot.
    pub(crate) fn with_file(mut self, path: Option<&Path>, part: &str) -> Self {
        if let Some(path) = path {
            self.add_file(path, part);
        }
        self
    }

    /// Adds the files that the values of a table name, relative to `folder`.
    pub(crate) fn with_table(mut self, table: &toml::Table, folder: &Path) -> Self {
        for (key, value) in table {
            self.add_value(key, value, folder);
        }
        self
    }

    /// All inputs but one part of the robot, which a new calibration may replace.
    pub(crate) fn without(&self, part: &str) -> Self {
        let kept = self.files.iter().filter(|file| file.part != part);
        Inputs {
            folders: self.folders.clone(),
            files: kept.cloned().collect(),
        }
    }

    /// Rejects outputs that would replace an input.
    pub(crate) fn ensure_kept<'a>(
        &self,
        outputs: impl IntoIterator<Item = Option<&'a Path>>,
    ) -> Result<()> {
        for path in outputs.into_iter().flatten() {
            let whose = if self.is_reserved(path) {
                "the recording"
            } else if self.contains(path) {
                "this command"
            } else {
                continue;
            };
            let path = path.display();
            let text = format!("{path} is an input of {whose}: choose another name");
            return Err(UsageError(text).into());
        }
        Ok(())
    }

    fn is_reserved(&self, path: &Path) -> bool {
        let folder = path.parent().map(|folder| {
            let is_here = folder.as_os_str().is_empty();
            if is_here { Path::new(".") } else { folder }
        });
        let folder = folder.and_then(|folder| folder.canonicalize().ok());
        let name = path.file_name().unwrap_or_default();
        folder.is_some_and(|folder| self.folders.contains(&folder))
            && INPUT_FILES.iter().any(|input| name == *input)
    }

    /// A hard link is another file: outputs take a name and leave the earlier content.
    fn contains(&self, path: &Path) -> bool {
        path.canonicalize()
            .is_ok_and(|path| self.files.iter().any(|file| file.path == path))
    }

    fn add_file(&mut self, path: &Path, part: &str) {
        // A pipe has no content that an output could replace, and can be read once only.
        let Some(canonical) = path.canonicalize().ok().filter(|path| path.is_file()) else {
            return;
        };
        let is_toml = path.extension().is_some_and(|ending| ending == "toml");
        let table = is_toml.then(|| input_file::read_text(path).ok()).flatten();
        let table = table.and_then(|text| text.parse::<toml::Table>().ok());
        if part == "labels" {
            self.add_images(path);
        }
        let section = match &table {
            Some(table) if part == "include" && table.len() == 1 => table.keys().next(),
            _ => None,
        };
        let file = InputFile {
            path: canonical,
            part: section.map_or(part, String::as_str).to_owned(),
        };
        if self.files.insert(file)
            && let Some(table) = &table
        {
            let folder = path.parent().unwrap_or(Path::new(""));
            for (key, value) in table {
                self.add_value(key, value, folder);
            }
        }
    }

    /// Any text that names a file is taken for one, whatever its key: `key` is that of the top level.
    fn add_value(&mut self, key: &str, value: &toml::Value, folder: &Path) {
        match value {
            toml::Value::String(name) if !name.is_empty() => self.add_file(&folder.join(name), key),
            toml::Value::Array(values) => {
                for value in values {
                    self.add_value(key, value, folder);
                }
            }
            toml::Value::Table(table) => {
                for value in table.values() {
                    self.add_value(key, value, folder);
                }
            }
            _ => {}
        }
    }

    fn add_images(&mut self, table: &Path) {
        if !table.is_file() {
            return;
        }
        let Ok(rows) = CsvTable::read(table, &["file"]) else {
            return;
        };
        let folder = table.parent().unwrap_or(Path::new(""));
        for row in rows.rows() {
            if let Ok(name) = row.text("file") {
                self.add_file(&folder.join(name), "");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(folder: &Path, files: &[(&str, &str)]) {
        for (name, text) in files {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("created");
            std::fs::write(path, text).expect("written");
        }
    }

    fn is_refused(inputs: &Inputs, path: &Path) -> bool {
        inputs.ensure_kept([None, Some(path)]).is_err()
    }

    #[test]
    fn outputs_that_would_replace_inputs_of_a_recording_are_rejected() {
        let folder = tempfile::tempdir().expect("a folder");
        write(
            folder.path(),
            &[
                ("drive/frames.csv", "stamp_s,file\n0,frames/a.png\n"),
                ("drive/frames/a.png", ""),
                ("other/x", ""),
            ],
        );
        let (drive, other) = (folder.path().join("drive"), folder.path().join("other"));
        let inputs = Inputs::of([&*drive]);
        let around = other.join("../drive/frames.csv");
        let message = inputs
            .ensure_kept([Some(&*around)])
            .expect_err("an input")
            .to_string();
        assert!(
            message.contains("frames.csv is an input of the recording"),
            "{message}"
        );
        for name in ["odometry.csv", "frames/a.png", "frames/../frames/a.png"] {
            assert!(is_refused(&inputs, &drive.join(name)), "{name}");
        }
        assert!(!is_refused(&inputs, &drive.join("poses.csv")));
        assert!(!is_refused(&inputs, &other.join("frames.csv")));
    }

    #[test]
    fn files_that_a_scenario_and_its_robot_name_are_inputs() {
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path();
        write(
            root,
            &[
                ("s.toml", "robot = \"r/robot.toml\""),
                (
                    "r/robot.toml",
                    "field = \"../field.toml\"\ninclude = [\"wheels.toml\"]\n[map]\nfile = \"map.npz\"",
                ),
                ("r/wheels.toml", "[odometry]\nmatrix = []"),
                ("r/map.npz", ""),
                ("field.toml", "length = 1"),
                ("other.toml", ""),
            ],
        );
        let inputs = Inputs::of([&*root.join("s.toml")]);
        for name in [
            "s.toml",
            "r/robot.toml",
            "r/wheels.toml",
            "r/map.npz",
            "field.toml",
        ] {
            assert!(is_refused(&inputs, &root.join(name)), "{name}");
        }
        assert!(!is_refused(&inputs, &root.join("other.toml")));
        let changes = toml::Table::from_iter([("field".to_owned(), "other.toml".into())]);
        assert!(is_refused(
            &inputs.without("field").with_table(&changes, root),
            &root.join("other.toml")
        ));
    }

    #[test]
    fn new_calibration_may_replace_the_earlier_one_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path();
        write(
            root,
            &[
                (
                    "robot.toml",
                    "include = [\"wheels.toml\", \"imu.toml\"]\nmask = \"mask.png\"",
                ),
                ("wheels.toml", "[odometry]\nmatrix = []"),
                ("imu.toml", "[imu.calibration]\n"),
                ("mask.png", ""),
            ],
        );
        let inputs = Inputs::of([root]).without("odometry");
        assert!(!is_refused(&inputs, &root.join("wheels.toml")));
        for name in ["robot.toml", "imu.toml", "mask.png"] {
            assert!(is_refused(&inputs, &root.join(name)), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn link_to_an_input_is_the_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path();
        write(root, &[("drive/robot.toml", "")]);
        std::os::unix::fs::symlink(root.join("drive"), root.join("link")).expect("linked");
        std::os::unix::fs::symlink(root.join("drive/robot.toml"), root.join("to.toml"))
            .expect("linked");
        let inputs = Inputs::of([&*root.join("link")]);
        assert!(is_refused(&inputs, &root.join("drive/robot.toml")));
        assert!(is_refused(&inputs, &root.join("to.toml")));
    }
}

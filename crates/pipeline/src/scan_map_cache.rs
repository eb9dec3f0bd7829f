//! Is there a stored scan map of this field and pattern? Built maps are kept in a folder from run to run.

use std::path::{Path, PathBuf};

use localize::config::LocalizeConfig;
use localize::field::Field;
use localize::global_search::scan_map::{ScanMap, ScanMapConfig};
use localize::localizer::Localizer;
use vision::output_file::write_file;

/// Where a localizer's scan map came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CacheStatus {
    /// Read from the file.
    Loaded,
    /// Built and written: there was no file.
    Built,
    /// Built and written: the file was damaged or of another version, field or pattern.
    Rebuilt,
    /// Built but not kept, with the reason why the file could not be read or written.
    NotStored(String),
}

/// A localizer whose scan map is read from `folder`, or built and written there.
///
/// A cache that cannot be read or written is no error. The status is None if the configuration needs no scan map.
pub fn build_localizer(
    field: &Field,
    config: LocalizeConfig,
    folder: &Path,
) -> (Localizer, Option<CacheStatus>) {
    if !Localizer::needs_scan_map(&config) {
        return (Localizer::new(field, config), None);
    }
    let pattern = &config.global_search.scan_map;
    let path = folder.join(file_name(field, pattern));
    let (stored, mut status) = read(&path, field, pattern);
    let localizer = Localizer::with_scan_map(field, config, stored);
    if let (CacheStatus::Built | CacheStatus::Rebuilt, Some(map)) = (&status, localizer.scan_map())
        && let Err(error) = write(&path, &map.to_bytes(field))
    {
        status = CacheStatus::NotStored(format!("cannot write {}: {error}", path.display()));
    }
    (localizer, Some(status))
}

/// One file per field and pattern.
fn file_name(field: &Field, config: &ScanMapConfig) -> PathBuf {
    let fingerprint = ScanMap::fingerprint(field, config);
    PathBuf::from(format!("scan_map_{fingerprint:016x}.bin"))
}

fn read(path: &Path, field: &Field, config: &ScanMapConfig) -> (Option<ScanMap>, CacheStatus) {
    match std::fs::read(path) {
        Ok(bytes) => match ScanMap::from_bytes(&bytes, field, config) {
            Some(map) => (Some(map), CacheStatus::Loaded),
            None => (None, CacheStatus::Rebuilt),
        },
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => (None, CacheStatus::Built),
        Err(error) => {
            let reason = format!("cannot read {}: {error}", path.display());
            (None, CacheStatus::NotStored(reason))
        }
    }
}

/// Writes under a temporary name first, so that a reader never finds a partial file.
fn write(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    write_file(path, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use localize::global_search::GlobalSearchMethod;

    #[test]
    fn scan_map_cache_rebuilds_damaged_and_tolerates_unwritable_files() {
        let fields = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
        let field = Field::load(&fields.join("msl_2001.toml")).expect("a field");
        let mut config = LocalizeConfig::default();
        config.global_search.method = GlobalSearchMethod::ScanMap;
        config.global_search.scan_map.cell = 0.5;
        let fresh = Localizer::new(&field, config.clone());
        let folder = tempfile::tempdir().expect("a folder");
        let cached = |folder: &Path| {
            let (localizer, status) = build_localizer(&field, config.clone(), folder);
            assert_eq!(localizer.scan_map(), fresh.scan_map());
            status.expect("a scan map is needed")
        };
        // A missing folder is created.
        let inside = folder.path().join("maps");
        assert_eq!(cached(&inside), CacheStatus::Built);
        assert_eq!(cached(&inside), CacheStatus::Loaded);
        let files: Vec<_> = std::fs::read_dir(&inside).expect("files").collect();
        let [file] = &files[..] else {
            panic!("expected one file: {files:?}")
        };
        let file = file.as_ref().expect("a file").path();
        std::fs::write(&file, b"MBSCAN, but cut off").expect("written");
        assert_eq!(cached(&inside), CacheStatus::Rebuilt);
        assert_eq!(cached(&inside), CacheStatus::Loaded);
        // A file in place of the folder.
        let CacheStatus::NotStored(reason) = cached(&file) else {
            panic!("a map was stored below a file")
        };
        assert!(reason.contains("scan_map_"), "{reason}");
    }

    #[test]
    fn localizer_without_scan_map_leaves_the_cache_alone() {
        let fields = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
        let field = Field::load(&fields.join("msl_2001.toml")).expect("a field");
        let folder = tempfile::tempdir().expect("a folder");
        let inside = folder.path().join("maps");
        let (_, status) = build_localizer(&field, LocalizeConfig::default(), &inside);
        assert_eq!((status, inside.exists()), (None, false));
    }
}

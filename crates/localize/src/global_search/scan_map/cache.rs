//! A map once built is kept in a file: is it of this version, field and pattern, and undamaged?

use std::path::{Path, PathBuf};

use super::{ScanMap, ScanMapConfig};
use crate::field::Field;
use crate::matching::distance_field::DistanceField;

/// Version of the stored file; another one is built anew.
const VERSION: u32 = 2;
const MAGIC: &[u8; 8] = b"MBSCAN\0\0";

/// Where a map came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CacheStatus {
    /// Read from the file.
    Loaded,
    /// Built and written to the file: there was none.
    Built,
    /// Built and written: what the file held is of another version, field or pattern, or damaged.
    Rebuilt,
    /// Built but not kept: the system's word why the file could not be read or written.
    NotStored(String),
}

/// The file of a field's map among others'.
fn file_name(field: &Field, config: &ScanMapConfig) -> PathBuf {
    PathBuf::from(format!("scan_map_{:016x}.bin", fingerprint(field, config)))
}

impl ScanMap {
    /// Reads the map of this field and pattern from `folder`, or builds it and writes it there; the map is there in
    /// any case, and it is said how.
    pub fn load_or_build(
        folder: &Path,
        field: &Field,
        distances: &DistanceField,
        config: ScanMapConfig,
    ) -> (Self, CacheStatus) {
        let path = folder.join(file_name(field, &config));
        let origin = match std::fs::read(&path) {
            Ok(bytes) => match ScanMap::from_bytes(&bytes, field, &config) {
                Some(map) => return (map, CacheStatus::Loaded),
                None => CacheStatus::Rebuilt,
            },
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => CacheStatus::Built,
            Err(error) => {
                CacheStatus::NotStored(format!("cannot read {}: {error}", path.display()))
            }
        };
        let map = ScanMap::new(field, distances, config);
        if matches!(origin, CacheStatus::NotStored(_)) {
            return (map, origin);
        }
        match write(&path, &map.to_bytes(field)) {
            Ok(()) => (map, origin),
            Err(error) => {
                let reason = format!("cannot write {}: {error}", path.display());
                (map, CacheStatus::NotStored(reason))
            }
        }
    }

    /// The stored form: magic, version, fingerprint of field and pattern, checksum, distances.
    pub fn to_bytes(&self, field: &Field) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.cells.len() + 28);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&fingerprint(field, &self.config).to_le_bytes());
        bytes.extend_from_slice(&checksum(&self.cells).to_le_bytes());
        bytes.extend_from_slice(&self.cells);
        bytes
    }

    /// A stored map, none if it is of another version, field or pattern, or damaged.
    pub fn from_bytes(bytes: &[u8], field: &Field, config: &ScanMapConfig) -> Option<Self> {
        let (magic, rest) = bytes.split_first_chunk::<8>()?;
        let (version, rest) = rest.split_first_chunk::<4>()?;
        let (made_for, rest) = rest.split_first_chunk::<8>()?;
        let (sum, cells) = rest.split_first_chunk::<8>()?;
        let fits = magic == MAGIC
            && u32::from_le_bytes(*version) == VERSION
            && u64::from_le_bytes(*made_for) == fingerprint(field, config)
            && u64::from_le_bytes(*sum) == checksum(cells);
        if !fits {
            return None;
        }
        ScanMap::from_cells(field, config.clone(), cells.to_vec())
    }
}

/// Under another name first, so that a reader never meets half a file.
fn write(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let unfinished = path.with_extension(format!("{}.part", std::process::id()));
    std::fs::write(&unfinished, bytes)?;
    std::fs::rename(&unfinished, path)
}

/// Over what the distances depend on.
fn fingerprint(field: &Field, config: &ScanMapConfig) -> u64 {
    checksum(format!("{:?} {config:?}", field.markings).as_bytes())
}

/// FNV-1a, eight bytes at a time: every step is a bijection, so that no single damage goes unseen.
fn checksum(bytes: &[u8]) -> u64 {
    let mix = |sum: u64, value: u64| (sum ^ value).wrapping_mul(0x0100_0000_01b3);
    let (words, rest) = bytes.as_chunks::<8>();
    let words = words.iter().map(|word| u64::from_le_bytes(*word));
    let rest = rest.iter().map(|&byte| u64::from(byte));
    words.chain(rest).fold(0xcbf2_9ce4_8422_2325, mix)
}

//! The scan map as bytes: are they of this version, field and pattern, and undamaged?

use super::{ScanMap, ScanMapConfig};
use crate::field::Field;

/// Version of the format; a map of another version is built again.
const VERSION: u32 = 2;
const MAGIC: &[u8; 8] = b"MBSCAN\0\0";

impl ScanMap {
    /// Checksum of the field's markings and the pattern: maps with equal fingerprints are equal.
    pub fn fingerprint(field: &Field, config: &ScanMapConfig) -> u64 {
        checksum(format!("{:?} {config:?}", field.markings).as_bytes())
    }

    /// The stored form: magic, version, fingerprint of field and pattern, checksum, distances.
    pub fn to_bytes(&self, field: &Field) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.cells.len() + 28);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&ScanMap::fingerprint(field, &self.config).to_le_bytes());
        bytes.extend_from_slice(&checksum(&self.cells).to_le_bytes());
        bytes.extend_from_slice(&self.cells);
        bytes
    }

    /// The map from its stored form; None if that is damaged or of another version, field or pattern.
    pub fn from_bytes(bytes: &[u8], field: &Field, config: &ScanMapConfig) -> Option<Self> {
        let (magic, rest) = bytes.split_first_chunk::<8>()?;
        let (version, rest) = rest.split_first_chunk::<4>()?;
        let (made_for, rest) = rest.split_first_chunk::<8>()?;
        let (sum, cells) = rest.split_first_chunk::<8>()?;
        let fits = magic == MAGIC
            && u32::from_le_bytes(*version) == VERSION
            && u64::from_le_bytes(*made_for) == ScanMap::fingerprint(field, config)
            && u64::from_le_bytes(*sum) == checksum(cells);
        if !fits {
            return None;
        }
        ScanMap::from_cells(field, config.clone(), cells.to_vec())
    }
}

/// FNV-1a, eight bytes at a time: every step is a bijection, so that every change of a single block is detected.
fn checksum(bytes: &[u8]) -> u64 {
    let mix = |sum: u64, value: u64| (sum ^ value).wrapping_mul(0x0100_0000_01b3);
    let (words, rest) = bytes.as_chunks::<8>();
    let words = words.iter().map(|word| u64::from_le_bytes(*word));
    let rest = rest.iter().map(|&byte| u64::from(byte));
    words.chain(rest).fold(0xcbf2_9ce4_8422_2325, mix)
}

//! Catalog and attributes: which volumes a file holds and what each of them is.

use super::layout::*;
use super::record::Ref;
use super::spec::VolumeSpec;
use super::value::{KeyRange, bits_of, bits_of_key, f64_of, is_nan, is_valid, key_of};
use crate::lattice::{Affine, Box3, Grid, Units};
use crate::sample::{Kind, SampleType};

const UNITS: [Units; 5] = [
    Units::Unknown,
    Units::Millimetre,
    Units::Micrometre,
    Units::Metre,
    Units::Nanometre,
];

/// One volume in the catalog.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    pub(crate) attributes: Ref,
    pub(crate) history: Ref,
    pub(crate) root: Ref,
    pub(crate) root_level: u8,
    /// 0: a volume of its own. n: `parent` with 2^n times its spacing.
    pub(crate) lod: u8,
    pub(crate) parent: u16,
    pub(crate) name: String,
}

/// Counts over a whole volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) bricks: u64,
    pub(crate) tiles: u64,
    pub(crate) tile_bricks: u64,
    pub(crate) pages: u64,
    pub(crate) stored: u64,
    /// Slabs that a running import has committed, and the checksum of their source bytes.
    pub(crate) slabs: u32,
    pub(crate) source_crc: u32,
}

/// The catalog payload.
pub(crate) fn encode_catalog(entries: &[Entry]) -> Vec<u8> {
    let mut bytes = vec![0; CATALOG_HEAD];
    put_u16(&mut bytes, CATALOG_VERSION, CATALOG_VERSION_NOW);
    put_u16(&mut bytes, CATALOG_COUNT, entries.len() as u16);
    for entry in entries {
        let at = bytes.len();
        bytes.resize(at + ENTRY_BYTES, 0);
        entry.attributes.put(&mut bytes, at + ENTRY_ATTRIBUTES);
        entry.history.put(&mut bytes, at + ENTRY_HISTORY);
        entry.root.put(&mut bytes, at + ENTRY_ROOT);
        bytes[at + ENTRY_ROOT_LEVEL] = entry.root_level;
        bytes[at + ENTRY_LOD] = entry.lod;
        put_u16(&mut bytes, at + ENTRY_PARENT, entry.parent);
        put_u16(&mut bytes, at + ENTRY_NAME, entry.name.len() as u16);
        bytes.extend_from_slice(entry.name.as_bytes());
        bytes.resize(bytes.len().next_multiple_of(RECORD_ALIGN), 0);
    }
    bytes
}

/// The volumes of a catalog payload.
///
/// # Errors
/// What is wrong, as a phrase.
pub(crate) fn decode_catalog(bytes: &[u8]) -> Result<Vec<Entry>, String> {
    if bytes.len() < CATALOG_HEAD || get_u16(bytes, CATALOG_VERSION) != CATALOG_VERSION_NOW {
        return Err("the catalog has an unknown version".into());
    }
    let count = get_u16(bytes, CATALOG_COUNT);
    if count > MAX_VOLUMES || usize::from(count) * ENTRY_BYTES > bytes.len() {
        return Err(format!("the catalog says {count} volumes"));
    }
    let mut entries = Vec::with_capacity(usize::from(count));
    let mut rest = &bytes[CATALOG_HEAD..];
    for _ in 0..count {
        let (head, after) = rest
            .split_at_checked(ENTRY_BYTES)
            .ok_or("the catalog is cut off")?;
        let name_len = usize::from(get_u16(head, ENTRY_NAME));
        let (name, after) = after
            .split_at_checked(name_len.next_multiple_of(RECORD_ALIGN))
            .filter(|_| name_len <= MAX_NAME)
            .ok_or("the catalog is cut off in a name")?;
        let name = std::str::from_utf8(&name[..name_len]).map_err(|_| "a name is not UTF-8")?;
        entries.push(Entry {
            attributes: Ref::get(head, ENTRY_ATTRIBUTES),
            history: Ref::get(head, ENTRY_HISTORY),
            root: Ref::get(head, ENTRY_ROOT),
            root_level: head[ENTRY_ROOT_LEVEL],
            lod: head[ENTRY_LOD],
            parent: get_u16(head, ENTRY_PARENT),
            name: name.into(),
        });
        rest = after;
    }
    if !rest.is_empty() {
        return Err("the catalog has bytes left over".into());
    }
    for (n, entry) in entries.iter().enumerate() {
        let parent = usize::from(entry.parent);
        let fits = if entry.lod == 0 {
            parent == 0
        } else {
            parent < n && entries[parent].lod == 0
        };
        if !fits {
            return Err(format!(
                "volume {n} is a level of detail of volume {parent}"
            ));
        }
    }
    Ok(entries)
}

/// The attributes payload.
pub(crate) fn encode_attributes(spec: &VolumeSpec, range: KeyRange, counts: &Counts) -> Vec<u8> {
    let mut bytes = vec![0; ATTR_BYTES];
    put_u16(&mut bytes, ATTR_VERSION, CATALOG_VERSION_NOW);
    bytes[ATTR_SAMPLE] = position(&SampleType::ALL, &spec.sample);
    bytes[ATTR_CHANNELS] = 1;
    bytes[ATTR_KIND] = position(&Kind::ALL, &spec.kind);
    bytes[ATTR_UNITS] = position(&UNITS, &spec.grid.units);
    bytes[ATTR_EDGE_LOG2] = spec.brick_edge.ilog2() as u8;
    put_u32(
        &mut bytes,
        ATTR_BACKGROUND,
        bits_of(spec.sample, spec.background),
    );
    put_u32(&mut bytes, ATTR_BAND, 0f32.to_bits());
    put_u32(&mut bytes, ATTR_MIN, bits_of_key(spec.sample, range.low));
    put_u32(&mut bytes, ATTR_MAX, bits_of_key(spec.sample, range.high));
    put_u32(&mut bytes, ATTR_HAS_NAN, u32::from(range.has_nan));
    let domain = spec.grid.domain;
    for a in 0..3 {
        put_i64(&mut bytes, ATTR_ORIGIN + 8 * a, i64::from(domain.min[a]));
        put_u32(&mut bytes, ATTR_SIZE + 4 * a, domain.size()[a]);
    }
    for (n, value) in spec.grid.index_to_world.rows.iter().flatten().enumerate() {
        put_f64(&mut bytes, ATTR_MATRIX + 8 * n, *value);
    }
    put_u64(&mut bytes, ATTR_BRICKS, counts.bricks);
    put_u64(&mut bytes, ATTR_TILES, counts.tiles);
    put_u64(&mut bytes, ATTR_TILE_BRICKS, counts.tile_bricks);
    put_u64(&mut bytes, ATTR_PAGES, counts.pages);
    put_u64(&mut bytes, ATTR_STORED, counts.stored);
    put_u32(&mut bytes, ATTR_SLABS, counts.slabs);
    put_u32(&mut bytes, ATTR_SOURCE_CRC, counts.source_crc);
    bytes
}

fn position<T: PartialEq>(all: &[T], one: &T) -> u8 {
    all.iter()
        .position(|t| t == one)
        .expect("the table lists every value") as u8
}

/// The spec (without history and name), range and counts of an attributes payload.
///
/// # Errors
/// What is wrong, as a phrase.
pub(crate) fn decode_attributes(bytes: &[u8]) -> Result<(VolumeSpec, KeyRange, Counts), String> {
    if bytes.len() != ATTR_BYTES || get_u16(bytes, ATTR_VERSION) != CATALOG_VERSION_NOW {
        return Err("the attributes have an unknown version or length".into());
    }
    fn pick<T: Copy>(all: &[T], n: u8, what: &str) -> Result<T, String> {
        all.get(usize::from(n))
            .copied()
            .ok_or_else(|| format!("{what} number {n} is unknown"))
    }
    let sample = pick(&SampleType::ALL, bytes[ATTR_SAMPLE], "sample type")?;
    if bytes[ATTR_CHANNELS] != 1 || bytes[ATTR_POSITION] != 0 || bytes[ATTR_EDGE_LOG2] > 6 {
        return Err("channels, sample position or brick edge are not supported".into());
    }
    let value = |at: usize, what: &str| {
        let bits = get_u32(bytes, at);
        if is_valid(sample, bits) {
            Ok(bits)
        } else {
            Err(format!("{what} {bits:#x} is no sample"))
        }
    };
    let origin: [i64; 3] = std::array::from_fn(|a| get_i64(bytes, ATTR_ORIGIN + 8 * a));
    let size: [u32; 3] = std::array::from_fn(|a| get_u32(bytes, ATTR_SIZE + 4 * a));
    let domain = Box3::new(corner(origin, [0; 3])?, corner(origin, size)?);
    let entry = |n: usize| get_f64(bytes, ATTR_MATRIX + 8 * n);
    let spec = VolumeSpec {
        grid: Grid {
            domain,
            index_to_world: Affine {
                rows: std::array::from_fn(|r| std::array::from_fn(|c| entry(4 * r + c))),
            },
            units: pick(&UNITS, bytes[ATTR_UNITS], "unit")?,
        },
        sample,
        kind: pick(&Kind::ALL, bytes[ATTR_KIND], "kind")?,
        background: f64_of(sample, value(ATTR_BACKGROUND, "the background")?),
        brick_edge: 1 << bytes[ATTR_EDGE_LOG2],
        history: String::new(),
        name: String::new(),
    };
    spec.validate().map_err(|e| e.to_string())?;
    let end = |at: usize, what: &str| match value(at, what)? {
        bits if is_nan(sample, bits) => Err(format!("{what} is NaN")),
        bits => Ok(key_of(sample, bits)),
    };
    let has_nan = get_u32(bytes, ATTR_HAS_NAN);
    if has_nan > 1 {
        return Err(format!("the mark of NaN is {has_nan}, neither 0 nor 1"));
    }
    let range = KeyRange {
        low: end(ATTR_MIN, "the minimum")?,
        high: end(ATTR_MAX, "the maximum")?,
        has_nan: has_nan != 0,
    };
    let counts = Counts {
        bricks: get_u64(bytes, ATTR_BRICKS),
        tiles: get_u64(bytes, ATTR_TILES),
        tile_bricks: get_u64(bytes, ATTR_TILE_BRICKS),
        pages: get_u64(bytes, ATTR_PAGES),
        stored: get_u64(bytes, ATTR_STORED),
        slabs: get_u32(bytes, ATTR_SLABS),
        source_crc: get_u32(bytes, ATTR_SOURCE_CRC),
    };
    Ok((spec, range, counts))
}

fn corner(origin: [i64; 3], size: [u32; 3]) -> Result<[i32; 3], String> {
    let mut point = [0; 3];
    for a in 0..3 {
        point[a] = origin[a]
            .checked_add(i64::from(size[a]))
            .and_then(|v| i32::try_from(v).ok())
            .ok_or("the domain lies beyond 32-bit lattice coordinates")?;
    }
    Ok(point)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> VolumeSpec {
        let mut spec = VolumeSpec::new(
            Grid::new(Box3::new([-3, 4, 0], [100, 20, 7])),
            SampleType::I16,
        );
        spec.grid.index_to_world = Affine::from_spacing([0.5, -2.0, 1.25], [1.0, 2.0, 3.0]);
        spec.grid.units = Units::Millimetre;
        spec.kind = Kind::Label;
        spec.background = -1024.0;
        spec
    }

    #[test]
    fn attributes_round_trip() {
        let range = KeyRange {
            low: key_of(SampleType::I16, 0xffff),
            high: key_of(SampleType::I16, 9),
            has_nan: false,
        };
        let counts = Counts {
            bricks: 1,
            tiles: 2,
            tile_bricks: 3,
            pages: 4,
            stored: 5,
            slabs: 6,
            source_crc: 7,
        };
        let bytes = encode_attributes(&spec(), range, &counts);
        assert_eq!(decode_attributes(&bytes), Ok((spec(), range, counts)));
        let empty = KeyRange::empty(SampleType::I16);
        let bytes = encode_attributes(&spec(), empty, &counts);
        assert_eq!(decode_attributes(&bytes).map(|a| a.1), Ok(empty));
    }

    #[test]
    fn attributes_every_truncation_extra_bytes_and_bit_flip() {
        let bytes = encode_attributes(
            &spec(),
            KeyRange::empty(SampleType::I16),
            &Counts::default(),
        );
        for end in 0..bytes.len() {
            assert!(decode_attributes(&bytes[..end]).is_err());
        }
        assert!(decode_attributes(&[&bytes[..], &[0]].concat()).is_err());
        for bit in 0..bytes.len() * 8 {
            let mut bad = bytes.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            if let Ok((spec, ..)) = decode_attributes(&bad) {
                assert!(spec.validate().is_ok());
            }
        }
    }

    #[test]
    fn catalog_round_trip_truncation_and_huge_declared_size() {
        let entry = Entry {
            attributes: Ref {
                offset: 16384,
                length: 212,
                crc: 7,
            },
            history: Ref::default(),
            root: Ref {
                offset: 20000,
                length: 900,
                crc: 8,
            },
            root_level: 2,
            lod: 0,
            parent: 0,
            name: "zähne".into(),
        };
        let coarse = Entry {
            lod: 3,
            name: String::new(),
            ..entry.clone()
        };
        let two = [entry.clone(), coarse.clone()];
        assert_eq!(decode_catalog(&encode_catalog(&two)), Ok(two.to_vec()));
        assert!(
            decode_catalog(&encode_catalog(&[coarse])).is_err(),
            "its own parent"
        );
        let mut bytes = encode_catalog(std::slice::from_ref(&entry));
        assert_eq!(decode_catalog(&bytes), Ok(vec![entry]));
        for end in 0..bytes.len() {
            assert!(decode_catalog(&bytes[..end]).is_err());
        }
        put_u16(&mut bytes, CATALOG_COUNT, u16::MAX);
        assert!(decode_catalog(&bytes).is_err());
        put_u16(&mut bytes, CATALOG_COUNT, 1);
        put_u16(&mut bytes, CATALOG_VERSION, 9);
        assert!(decode_catalog(&bytes).is_err());
        assert!(decode_catalog(&[]).is_err());
    }
}

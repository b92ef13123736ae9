//! One commit: the changed pages of every volume, their attributes, the catalog, the root.

use super::catalog::{Counts, Entry, encode_attributes, encode_catalog};
use super::layout::{RECORD_HEADER, record_bytes};
use super::log::Publish;
use super::meta;
use super::open::Opened;
use super::record::{Head, RecordKind, Ref};
use super::tree::{Base, Changes};
use super::value::KeyRange;
use super::writer::{Part, VolumeWriter};
use crate::error::Result;
use std::sync::PoisonError;

/// What the last commit has.
pub(crate) struct Saved {
    pub(crate) file: Opened,
    /// Volumes that are committed; those added since follow them in the writer.
    pub(crate) parts: Vec<SavedPart>,
}

/// What the last commit has of one volume.
#[derive(Clone)]
pub(crate) struct SavedPart {
    pub(crate) entry: Entry,
    pub(crate) range: KeyRange,
    pub(crate) counts: Counts,
}

impl SavedPart {
    fn new(part: &Part) -> Self {
        Self {
            entry: Entry {
                attributes: Ref::default(),
                history: Ref::default(),
                root: Ref::default(),
                root_level: 0,
                lod: part.lod,
                parent: part.parent,
                name: part.spec.name.clone(),
            },
            range: KeyRange::of_bits(part.rules.sample, part.rules.background),
            counts: Counts::default(),
        }
    }
}

/// Offsets of the first and after the last node page of a commit.
struct Span(u64, u64);

impl VolumeWriter {
    /// Commits with this writer id in the superblock.
    pub(super) fn publish(&self, writer: u64) -> Result<u64> {
        let _alone = self.gate.write().unwrap_or_else(PoisonError::into_inner);
        let mut saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        let result = self.log.check().and_then(|()| {
            let changed = saved.file.root.generation == 0
                || saved.parts.len() < self.parts.len()
                || (0..self.parts.len()).any(|n| self.is_changed(n, &saved));
            if changed {
                self.write_commit(&mut saved, writer)?;
            }
            Ok(saved.file.root.generation)
        });
        if result.is_err() {
            self.parts.iter().for_each(Part::forget);
            self.log.forget();
        }
        result
    }

    fn is_changed(&self, volume: usize, saved: &Saved) -> bool {
        let counts = &saved.parts[volume].counts;
        !self.parts[volume].tree().is_empty()
            || self.parts[volume].is_built()
            || self.parts[volume].mark() != (counts.slabs, counts.source_crc)
    }

    fn write_commit(&self, saved: &mut Saved, writer: u64) -> Result<()> {
        let generation = self.log.generation();
        let mut span = Span(u64::MAX, 0);
        let mut dropped = 0;
        let mut parts = Vec::with_capacity(self.parts.len());
        let mut touched = Vec::with_capacity(self.parts.len());
        for (volume, part) in self.parts.iter().enumerate() {
            let mut now = match saved.parts.get(volume) {
                Some(before) => before.clone(),
                None => SavedPart::new(part),
            };
            let mut tree = part.tree();
            touched.push(!tree.is_empty());
            if touched[volume] {
                let base = Base {
                    file: &saved.file,
                    volume: volume as u16,
                    root: now.entry.root,
                    root_level: now.entry.root_level,
                };
                let Changes {
                    root,
                    range,
                    counts,
                    dropped: bytes,
                } = tree.commit(base, now.counts, generation, &mut |head, record| {
                    let reference = self.log.append(head, record)?;
                    let end = reference.offset + record_bytes(reference.length);
                    span = Span(span.0.min(reference.offset), end);
                    Ok(reference)
                })?;
                (now.entry.root, now.range, now.counts) = (root, range, counts);
                now.entry.root_level = if root.is_none() {
                    0
                } else {
                    part.spec.root_level()
                };
                dropped += bytes;
            }
            parts.push(now);
        }
        for (volume, part) in self.parts.iter().enumerate() {
            let parent_crc = parts[usize::from(part.parent)].entry.root.crc;
            let now = &mut parts[volume];
            let append = |kind: RecordKind, payload: Vec<u8>| {
                self.append_payload(kind, volume as u16, payload)
            };
            if let Some(before) = saved.parts.get(volume) {
                if !touched[volume] && !self.is_changed(volume, saved) {
                    continue;
                }
                dropped += record_bytes(before.entry.attributes.length);
            } else if !part.spec.history.is_empty() {
                now.entry.history = append(RecordKind::History, meta::encode(&part.spec.history)?)?;
            }
            // A level is known to fit by the root page that it was built from. One that is not all
            // there must never be taken for whole.
            (now.counts.slabs, now.counts.source_crc) = match part.lod {
                0 => part.mark(),
                _ if part.is_built() => (0, parent_crc),
                _ => (0, !parent_crc),
            };
            let payload = encode_attributes(&part.spec, now.range, &now.counts);
            now.entry.attributes = append(RecordKind::Attributes, payload)?;
        }
        if saved.file.root.generation > 0 {
            dropped += record_bytes(saved.file.root.catalog.length);
        }
        let entries: Vec<Entry> = parts.iter().map(|p| p.entry.clone()).collect();
        let catalog = self.append_payload(RecordKind::Catalog, 0, encode_catalog(&entries))?;
        // Pages of an earlier commit may still be in use.
        let index = if generation == 1 && span.1 > 0 {
            [span.0, span.1 - span.0]
        } else {
            [0, 0]
        };
        saved.file.root = self.log.commit(&Publish {
            catalog,
            index,
            dropped,
            writer,
            sealed: self.sealed,
        })?;
        for (part, now) in self.parts.iter().zip(&parts) {
            part.set_mark((now.counts.slabs, now.counts.source_crc));
            part.set_built(false);
        }
        saved.parts = parts;
        Ok(())
    }

    fn append_payload(&self, kind: RecordKind, volume: u16, payload: Vec<u8>) -> Result<Ref> {
        let mut record = vec![0; RECORD_HEADER];
        record.extend(payload);
        let head = Head::new(kind, self.log.generation(), volume);
        self.log.append(&head, record)
    }
}

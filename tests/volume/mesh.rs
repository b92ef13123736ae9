//! Meshes of volume files against meshes of the same samples in memory.

use super::{file, raw_of, read_all, stored};
use crate::extraction::{dense, mesh_of};
use crate::support::fields::{Content, random, sampled};
use crate::support::rng::Rng;
use crate::support::scratch::Scratch;
use brickmarch::iso::Extract;
use brickmarch::store::{Volume, VolumeSpec};
use brickmarch::{Box3, Budget, Field, Grid, Kind, SampleType};

#[test]
fn a_volume_has_the_samples_and_the_mesh_of_its_array() {
    let scratch = Scratch::new("volume-mesh");
    let mut rng = Rng::new(71);
    let domain = Box3::new([-7, 3, 100], [38, 44, 133]);
    for (n, sample) in SampleType::ALL.into_iter().enumerate() {
        for edge in [8, 16, 32, 64] {
            let content = match sample {
                SampleType::F32 => rng.pick(&[Content::Noise, Content::Smooth, Content::Infinite]),
                SampleType::Bit | SampleType::I8 => Content::Plateaus,
                _ => Content::Bytes,
            };
            let values = random(content, domain, &mut rng);
            let iso = if sample == SampleType::Bit {
                0.5
            } else {
                content.iso()
            };
            let mut spec = VolumeSpec::new(Grid::new(domain), sample);
            spec.brick_edge = edge;
            let path = file(&scratch, &format!("{n}-{edge}.bvol"), &spec, &values);
            let what = format!("{sample:?} {content:?} bricks of {edge}");

            let budget = Budget::mib(24);
            let volume = Volume::open(&path, &budget).unwrap_or_else(|e| panic!("{what}: {e}"));
            let raw = read_all(&volume, domain).expect("readable");
            assert!(
                raw == raw_of(sample, &values),
                "{what}: other samples come out"
            );
            let options = Extract {
                iso,
                normals: true,
                ..Extract::default()
            };
            let (ours, _) =
                mesh_of(&volume, &options, &budget).unwrap_or_else(|e| panic!("{what}: {e}"));
            let array = dense(domain, stored(sample, &values), volume.block_edge());
            let (want, _) = mesh_of(&array, &options, &Budget::mib(256)).expect("the same surface");
            assert!(ours == want, "{what}: another mesh");
        }
    }
}

#[test]
fn the_surface_of_a_label_is_that_of_its_mask() {
    let scratch = Scratch::new("volume-label");
    let domain = Box3::from_size([40, 33, 30]);
    // Ids that differ only beyond the 24 bits of a single.
    let ids = [0u32, 16_777_216, 16_777_217, 16_777_218, 4_294_967_295];
    let mut rng = Rng::new(72);
    let picks: Vec<u32> = (0..5 * 5 * 5).map(|_| rng.pick(&ids)).collect();
    let id_at = |p: [i32; 3]| picks[((p[0] / 8) + 5 * (p[1] / 8) + 25 * (p[2] / 8)) as usize];
    let mut spec = VolumeSpec::new(Grid::new(domain), SampleType::U32);
    spec.kind = Kind::Label;
    let path = scratch.path("labels.bvol");
    let budget = Budget::mib(64);
    let writer =
        brickmarch::store::VolumeWriter::create(&path, &spec, &budget).expect("a new file");
    let edge = spec.brick_edge as i32;
    let [bx, by, bz] = writer.bricks().map(|b| b as i32);
    for b in (0..bx * by * bz).map(|n| [n % bx, n / bx % by, n / bx / by]) {
        let point = |n: i32| {
            let at = [n % edge, n / edge % edge, n / edge / edge];
            std::array::from_fn(|a| b[a] * edge + at[a])
        };
        let id = |p: [i32; 3]| if domain.contains(p) { id_at(p) } else { 0 };
        let raw: Vec<u8> = (0..edge.pow(3))
            .flat_map(|n| id(point(n)).to_le_bytes())
            .collect();
        writer
            .put_brick(b.map(|v| v as u32), &raw)
            .expect("the brick is new");
    }
    writer.finish().expect("it can be committed");

    let volume = Volume::open(&path, &budget).expect("a volume");
    let options = Extract {
        iso: 0.5,
        ..Extract::default()
    };
    for id in ids {
        let mask = sampled(domain, |p| {
            f64::from(u8::from(id_at(p.map(|v| v as i32)) == id))
        });
        let array = dense(domain, mask, volume.block_edge());
        let (want, _) = mesh_of(&array, &options, &budget).expect("the id occurs");
        let (ours, _) = mesh_of(&volume.label(id), &options, &budget).expect("the id occurs");
        assert!(ours == want, "label {id}");
    }
}

#[test]
fn a_seed_decodes_no_brick_of_another_sphere() {
    let scratch = Scratch::new("volume-seed");
    let domain = Box3::from_size([200, 64, 64]);
    let centres = [30.0, 170.0];
    let values = sampled(domain, |p| {
        let one = |c: f64| {
            ((p[0] - c).powi(2) + (p[1] - 32.0).powi(2) + (p[2] - 32.0).powi(2)).sqrt() - 20.3
        };
        one(centres[0]).min(one(centres[1]))
    });
    let mut spec = VolumeSpec::new(Grid::new(domain), SampleType::F32);
    spec.kind = Kind::Distance;
    spec.brick_edge = 16;
    let path = file(&scratch, "two.bvol", &spec, &values);
    for centre in centres {
        let budget = Budget::mib(64);
        let volume = Volume::open(&path, &budget).expect("a volume");
        let options = Extract {
            seeds: vec![[centre as i32 + 20, 32, 32], [centre as i32 - 21, 32, 32]],
            ..Extract::default()
        };
        let (mesh, stats) = mesh_of(&volume, &options, &budget).expect("the seeds are crossed");
        assert!(
            mesh.positions
                .iter()
                .all(|p| (f64::from(p[0]) - centre).abs() < 21.0)
        );
        // The bricks that hold a sample within one of the sphere, and no other.
        let near = |brick: i32| {
            let (low, high) = (f64::from(brick * 16), f64::from(brick * 16 + 16));
            low < centre + 23.0 && high > centre - 23.0
        };
        let most = (0..13).filter(|&b| near(b)).count() as u64 * 4 * 4;
        assert!(
            stats.blocks_decoded > 0 && stats.blocks_decoded <= most,
            "{stats:?}, most {most}"
        );
        assert_eq!(stats.blocks_decoded, volume.blocks_decoded());
    }
}

//! Faults of a reader.

use super::*;

#[test]
fn a_fault_at_any_call_of_a_reader_is_an_error_and_the_next_try_succeeds() {
    let content = content();
    let disk = Arc::new(Disk::failing(Vec::new(), Plan::default(), 0));
    write(disk.clone(), &content).expect("nothing fails");
    let image = disk.image();
    let reader = Arc::new(Disk::failing(image.clone(), Plan::default(), 0));
    read(reader.clone(), &Budget::mib(16)).expect("nothing fails");
    let (calls, _) = reader.calls();
    let (mut runs, mut said) = (0, 0);
    for fault in [Fault::Io, Fault::Interrupted, Fault::Short] {
        for at in (0..calls).step_by(if cfg!(debug_assertions) { 13 } else { 1 }) {
            let what = format!("{fault:?} at call {at} of a reader");
            let plan = Plan {
                at: Some((at, fault)),
                ..Plan::default()
            };
            let disk = Arc::new(Disk::failing(image.clone(), plan, 0));
            let budget = Budget::mib(16);
            let opened = Volume::open_in(disk.clone(), Path::new(NAME), &budget);
            let mut out = vec![0; content.samples.len()];
            let error = match opened {
                Err(e) => Some(e),
                Ok(volume) => {
                    let error = volume.read_raw(DOMAIN, &mut out).err();
                    // A fault while reading ahead concerns nobody: what was asked for is read alone.
                    let right = out == content.samples;
                    assert!(
                        error.is_some() || right,
                        "{what}: other samples, and nothing was said"
                    );
                    // The same open volume reads on once the disk does.
                    disk.heal();
                    volume.read_raw(DOMAIN, &mut out).expect("healed");
                    assert!(out == content.samples, "{what}: other samples came out");
                    error
                }
            };
            if let Some(e) = error {
                assert_clear(&e, &what);
                said += 1;
            }
            runs += 1;
        }
    }
    assert!(2 * said > runs, "{said} of {runs} faults came to light");
    figure(&format!(
        "faults of a reader: {runs} runs of {calls} calls, each an error or the right samples"
    ));
}

/// Volumes of a file, all their samples, and the number of bricks along each axis.
struct Truth {
    name: &'static str,
    level: u8,
    domain: Box3,
    samples: Vec<u8>,
}

fn bytes_of(volume: &Volume, region: Box3) -> Result<Vec<u8>> {
    let mut out = vec![0; region.count() as usize * volume.spec().sample.bytes()];
    volume.read_raw(region, &mut out).map(|()| out)
}

/// The part of a volume that a brick is.
fn box_of(truth: &Truth, brick: [u32; 3]) -> Box3 {
    let min: [i32; 3] = std::array::from_fn(|a| truth.domain.min[a] + 8 * brick[a] as i32);
    Box3::new(min, min.map(|v| v + 8)).intersect(&truth.domain)
}

impl Truth {
    fn part(&self, region: Box3) -> Vec<u8> {
        let width = self.samples.len() / self.domain.count() as usize;
        let mut out = Vec::new();
        for k in region.min[2]..region.max[2] {
            for j in region.min[1]..region.max[1] {
                let at = width * self.domain.offset_of([region.min[0], j, k]);
                let row = width * region.size()[0] as usize;
                out.extend_from_slice(&self.samples[at..at + row]);
            }
        }
        out
    }

    fn bricks(&self) -> Vec<[u32; 3]> {
        let [x, y, z] = self.domain.size().map(|n| n.div_ceil(8));
        let all = (0..x * y * z).map(|n| [n % x, n / x % y, n / x / y]);
        all.collect()
    }
}

/// The second volume of the file.
const OTHER: Box3 = Box3::from_size([20, 24, 28]);

/// A file of two volumes with a coarser level of the first, before and after changes, and what it holds.
fn two_states() -> [(Vec<u8>, Vec<Truth>); 2] {
    let content = content();
    let mut rng = Rng::new(301);
    let disk = Arc::new(Disk::new(Vec::new()));
    let budget = Budget::mib(16).with_threads(1);
    let writer = VolumeWriter::create_in(disk.clone(), Path::new(NAME), &spec(), &budget);
    let mut writer = writer.expect("starts");
    let other = VolumeSpec {
        brick_edge: 8,
        name: "other".into(),
        ..VolumeSpec::new(Grid::new(OTHER), SampleType::U16)
    };
    let number = writer.add_volume(&other).expect("a good spec");
    let mut first = content.samples.clone();
    let mut second = vec![0; 2 * OTHER.count() as usize];
    let mut change = |writer: &mut VolumeWriter, some: u64| {
        for (brick, raw) in &content.bricks {
            let raw: Vec<u8> = match some {
                1 => raw.clone(),
                _ if rng.chance(some) => raw.iter().map(|v| v ^ 0x55).collect(),
                _ => continue,
            };
            writer.put_brick(*brick, &raw).expect("puts");
            for (at, &value) in raw.iter().enumerate() {
                let p: [i32; 3] = std::array::from_fn(|a| {
                    8 * brick[a] as i32 + [at % 8, at / 8 % 8, at / 64][a] as i32
                });
                first[DOMAIN.offset_of(p)] = value;
            }
        }
        for n in 0..3 * 3 * 4u32 {
            if some > 1 && !rng.chance(some) {
                continue;
            }
            let brick = [n % 3, n / 3 % 3, n / 9];
            let raw: Vec<u8> = (0..1024).map(|_| rng.next() as u8).collect();
            writer.put_brick_in(number, brick, &raw).expect("puts");
            for at in 0..512 {
                let p: [i32; 3] = std::array::from_fn(|a| {
                    8 * brick[a] as i32 + [at % 8, at / 8 % 8, at / 64][a] as i32
                });
                if OTHER.contains(p) {
                    let to = 2 * OTHER.offset_of(p);
                    second[to..to + 2].copy_from_slice(&raw[2 * at..2 * at + 2]);
                }
            }
        }
        writer.build_levels(1).expect("builds");
        let half = Box3::from_size([24, 24, 32]);
        let truth = |name, level, domain, samples| Truth {
            name,
            level,
            domain,
            samples,
        };
        let coarse = edit::coarser(&first, [48, 48, 64]).0;
        vec![
            truth("", 0, DOMAIN, first.clone()),
            truth("other", 0, OTHER, second.clone()),
            truth("", 1, half, coarse),
        ]
    };
    let before = change(&mut writer, 1);
    let image = disk.image();
    let after = change(&mut writer, 3);
    [(image, before), (disk.image(), after)]
}

/// Something that is read with a fault somewhere in it: what it gives, at the second try if an error came
/// at the first.
fn tried<T>(disk: &Disk, what: &str, said: &mut u64, mut read: impl FnMut() -> Result<T>) -> T {
    read().unwrap_or_else(|e| {
        assert_clear(&e, what);
        assert_eq!(e.kind(), ErrorKind::Io, "{what}: {e}");
        *said += 1;
        disk.heal();
        read().unwrap_or_else(|e| panic!("{what}: the next try fails too: {e}"))
    })
}

/// Opens all volumes, reads their bricks in `order`, then what a writer has made of the file meanwhile.
/// Gives the number of errors.
fn read_in(
    disk: &Arc<Disk>,
    states: &[(Vec<u8>, Vec<Truth>); 2],
    order: &[(usize, [u32; 3])],
    what: &str,
) -> u64 {
    let budget = Budget::mib(16).with_threads(1);
    let mut said = 0;
    let mut volumes: Vec<Volume> = Vec::new();
    for truth in &states[0].1 {
        volumes.push(tried(disk, what, &mut said, || {
            let storage = disk.clone();
            let name = Path::new(NAME);
            let volume = match truth.name {
                "" => Volume::open_in(storage, name, &budget)?,
                other => Volume::open_named_in(storage, name, other, &budget)?,
            };
            match truth.level {
                0 => Ok(volume),
                level => volume.level(level),
            }
        }));
    }
    for (round, (image, truths)) in states.iter().enumerate() {
        if round > 0 {
            disk.becomes(image.clone());
            for (volume, (old, new)) in volumes.iter_mut().zip(states[0].1.iter().zip(truths)) {
                let before = volume.generation();
                let refreshed = volume.refresh();
                if let Err(e) = refreshed {
                    assert_clear(&e, what);
                    said += 1;
                    disk.heal();
                    // It is as it was.
                    assert_eq!(volume.generation(), before, "{what}");
                    let seen = bytes_of(volume, old.domain).expect("healed");
                    assert!(seen == old.samples, "{what}: a failed refresh changed it");
                    assert!(volume.refresh().expect("healed"), "{what}");
                }
                assert!(volume.generation() > before, "{what}");
                assert_eq!(volume.spec().grid.domain, new.domain);
            }
        }
        for &(volume, brick) in order {
            let truth = &truths[volume];
            let region = box_of(truth, brick);
            let seen = tried(disk, what, &mut said, || bytes_of(&volumes[volume], region));
            assert!(
                seen == truth.part(region),
                "{what}: round {round}, volume {volume}, brick {brick:?}: other samples came out"
            );
        }
    }
    disk.heal();
    for (volume, truth) in volumes.iter().zip(&states[1].1) {
        let seen = bytes_of(volume, truth.domain).expect("healed");
        assert!(seen == truth.samples, "{what}: other samples came out");
    }
    drop(volumes);
    assert_eq!(budget.used_bytes(), 0, "{what}");
    said
}

#[test]
fn a_fault_at_any_call_of_a_reader_in_any_order_is_an_error_or_no_matter() {
    let states = two_states();
    let mut rng = Rng::new(302);
    let mut order: Vec<(usize, [u32; 3])> = (0..3)
        .flat_map(|v| states[0].1[v].bricks().into_iter().map(move |b| (v, b)))
        .collect();
    for n in (1..order.len()).rev() {
        order.swap(n, rng.below(n as u64 + 1) as usize);
    }
    let disk = Arc::new(Disk::failing(states[0].0.clone(), Plan::default(), 0));
    assert_eq!(read_in(&disk, &states, &order, "no fault"), 0);
    let (calls, syncs) = disk.calls();
    assert!(calls >= 300, "{calls} calls");
    // What a full disk and a failed sync could stop is never called.
    assert_eq!(syncs, 0);
    assert!(disk.image() == states[1].0, "a reader wrote");
    let (mut runs, mut said) = (0, 0);
    for fault in Fault::ALL {
        for at in (0..calls).step_by(if cfg!(debug_assertions) { 29 } else { 1 }) {
            for stays in [false, true] {
                let what = format!("{fault:?} at call {at}, stays: {stays}");
                let plan = Plan {
                    at: Some((at, fault)),
                    stays,
                    capacity: None,
                };
                let disk = Arc::new(Disk::failing(states[0].0.clone(), plan, 0));
                let errors = read_in(&disk, &states, &order, &what);
                if matches!(fault, Fault::NoSpace | Fault::Sync) {
                    assert_eq!((errors, disk.failed()), (0, 0), "{what}");
                    // Once is enough to see that.
                    break;
                }
                if disk.failed() == 0 {
                    // The length is told whole or not at all.
                    assert!(fault == Fault::Short && errors == 0, "{what}: no fault");
                    continue;
                }
                runs += 1;
                said += errors;
            }
            if matches!(fault, Fault::NoSpace | Fault::Sync) {
                break;
            }
        }
    }
    assert!(4 * said > 3 * runs, "{said} of {runs} faults came to light");
    figure(&format!(
        "faults of a reader in random order: {runs} runs of {calls} calls, {said} errors, never other samples"
    ));
}

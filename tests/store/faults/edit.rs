//! Faults of a writer that changes a file which exists: what was committed stays.

use super::*;
use brickmarch::store::verify_in;

/// 3 x 3 x 4 bricks of edge 8; two coarser levels.
const SIZE: [usize; 3] = [24, 24, 32];
const DOMAIN: Box3 = Box3::from_size([24, 24, 32]);
const BRICKS: usize = 36;

type Brick = ([u32; 3], Vec<u8>);

/// What is done with the file, each with a commit.
enum Step {
    Bricks(Vec<Brick>),
    Levels(u8),
}

/// What a generation holds.
#[derive(Clone)]
struct State {
    samples: Vec<u8>,
    /// Coarser levels, where the generation is one that the script ends a step with.
    levels: Option<u8>,
}

/// A file of one commit with levels, what is done with it, and what each generation holds.
struct Story {
    image: Vec<u8>,
    script: Vec<Step>,
    states: Vec<State>,
    /// The generation after each step.
    ends: Vec<u64>,
    calls: u64,
    syncs: u64,
}

fn brick(n: usize) -> [u32; 3] {
    [n % 3, n / 3 % 3, n / 9].map(|p| p as u32)
}

/// `count` bricks, none like another: smooth, noise, constant, background.
fn bricks(count: usize, rng: &mut Rng) -> Vec<Brick> {
    let first = rng.below(BRICKS as u64) as usize;
    let one = |n: usize, rng: &mut Rng| {
        let (base, kind) = (rng.next() as u8, rng.below(8));
        let value = |at: usize, rng: &mut Rng| match kind {
            0 => 0,
            1 => base,
            2..5 => base.wrapping_add((at % 8 * n + at / 64) as u8),
            _ => rng.next() as u8,
        };
        let raw = (0..512).map(|at| value(at, rng)).collect();
        (brick((first + 5 * n) % BRICKS), raw)
    };
    (0..count).map(|n| one(n, rng)).collect()
}

fn set(samples: &mut [u8], bricks: &[Brick]) {
    for (brick, raw) in bricks {
        for (at, &value) in raw.iter().enumerate() {
            let p = [at % 8, at / 8 % 8, at / 64];
            let p: [usize; 3] = std::array::from_fn(|a| 8 * brick[a] as usize + p[a]);
            samples[p[0] + SIZE[0] * (p[1] + SIZE[1] * p[2])] = value;
        }
    }
}

/// The level of half the size: means of eight, halves to even.
pub(super) fn coarser(samples: &[u8], size: [usize; 3]) -> (Vec<u8>, [usize; 3]) {
    let half = size.map(|n| n / 2);
    let mean = |n: usize| {
        let p = [n % half[0], n / half[0] % half[1], n / half[0] / half[1]];
        let eight = (0..8).map(|c| {
            let q: [usize; 3] = std::array::from_fn(|a| 2 * p[a] + (c >> a & 1));
            f64::from(samples[q[0] + size[0] * (q[1] + size[1] * q[2])])
        });
        (eight.sum::<f64>() / 8.0).round_ties_even() as u8
    };
    ((0..half.iter().product()).map(mean).collect(), half)
}

fn budget() -> Budget {
    Budget::mib(16).with_threads(1)
}

fn open(storage: Arc<dyn Storage>) -> Result<VolumeWriter> {
    VolumeWriter::open_in(storage, Path::new(NAME), &budget())
}

fn put(writer: &VolumeWriter, bricks: &[Brick]) -> Result<u64> {
    for (brick, raw) in bricks {
        writer.put_brick(*brick, raw)?;
    }
    writer.commit()
}

/// Does the steps; `ends` gets the generation after each that is done.
fn run(writer: &mut VolumeWriter, script: &[Step], ends: &mut Vec<u64>) -> Result<()> {
    for step in script {
        ends.push(match step {
            Step::Bricks(bricks) => put(writer, bricks)?,
            Step::Levels(count) => {
                writer.build_levels(*count)?;
                writer.commit()?
            }
        });
    }
    Ok(())
}

fn story() -> Story {
    let mut rng = Rng::new(77);
    let disk = Arc::new(Disk::new(Vec::new()));
    let spec = VolumeSpec {
        brick_edge: 8,
        ..VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8)
    };
    let writer = VolumeWriter::create_in(disk.clone(), Path::new(NAME), &spec, &budget());
    let first = bricks(BRICKS, &mut rng);
    put(&writer.expect("starts"), &first).expect("commits");
    let mut samples = vec![0; DOMAIN.count() as usize];
    set(&mut samples, &first);

    let script = vec![
        Step::Bricks(bricks(30, &mut rng)),
        Step::Levels(2),
        Step::Bricks(bricks(36, &mut rng)),
        Step::Bricks(bricks(5, &mut rng)),
        Step::Levels(1),
        Step::Bricks(bricks(24, &mut rng)),
        Step::Levels(2),
    ];
    let image = disk.image();
    let disk = Arc::new(Disk::failing(image.clone(), Plan::default(), 0));
    let mut ends = Vec::new();
    run(&mut open(disk.clone()).expect("opens"), &script, &mut ends).expect("nothing fails");
    let (calls, syncs) = disk.calls();

    let unknown = |samples: &[u8]| State {
        samples: samples.to_vec(),
        levels: None,
    };
    // Generation 0 and the one that is there.
    let mut states = vec![unknown(&[]), unknown(&samples)];
    for (step, &end) in script.iter().zip(&ends) {
        let levels = match step {
            Step::Bricks(bricks) => {
                set(&mut samples, bricks);
                0
            }
            Step::Levels(count) => *count,
        };
        states.resize(end as usize + 1, unknown(&samples));
        states[end as usize].levels = Some(levels);
    }
    Story {
        image,
        script,
        states,
        ends,
        calls,
        syncs,
    }
}

/// Reads all that is on a disk: a generation that may be there, whole, with its levels. Gives it.
#[track_caller]
fn judge(image: Vec<u8>, states: &[State], acked: u64, begun: u64, what: &str) -> u64 {
    let storage: Arc<dyn Storage> = Arc::new(Disk::new(image));
    let volume = Volume::open_in(storage, Path::new(NAME), &budget());
    let volume = volume.unwrap_or_else(|e| panic!("{what}: what was committed is lost: {e}"));
    let generation = volume.generation();
    assert!(
        (acked..=begun).contains(&generation),
        "{what}: generation {generation}, not {acked} to {begun}"
    );
    let state = &states[generation as usize];
    let (mut want, mut size) = (state.samples.clone(), SIZE);
    for level in 0..=volume.levels() {
        let shown = volume.level(level).expect("a level that fits");
        let domain = shown.spec().grid.domain;
        let mut out = vec![0; want.len()];
        let read = shown.read_raw(domain, &mut out);
        read.unwrap_or_else(|e| panic!("{what}: generation {generation} is damaged: {e}"));
        assert!(
            out == want,
            "{what}: generation {generation} shows other samples at level {level}"
        );
        (want, size) = coarser(&want, size);
    }
    if let Some(levels) = state.levels {
        assert_eq!(volume.levels(), levels, "{what}: generation {generation}");
    }
    generation
}

/// One brick more, after `before`, by `writer`.
fn go_on(writer: &VolumeWriter, before: &State) -> Result<(State, u64)> {
    let change = [(brick(7), (0..512).map(|n| (n * 3 % 251) as u8).collect())];
    let generation = put(writer, &change)?;
    let mut state = before.clone();
    set(&mut state.samples, &change);
    state.levels = Some(0);
    Ok((state, generation))
}

/// What a run with a fault came to.
struct Outcome {
    refused: bool,
    /// The same writer could not go on.
    ended: bool,
}

fn try_one(story: &Story, plan: Plan, loss: u64, what: &str) -> Outcome {
    let disk = Arc::new(Disk::failing(story.image.clone(), plan, loss));
    let mut ends = Vec::new();
    let mut opened = open(disk.clone());
    let result = match &mut opened {
        Ok(writer) => run(writer, &story.script, &mut ends),
        Err(e) => {
            assert_clear(e, what);
            Ok(())
        }
    };
    let acked = ends.last().copied().unwrap_or(1);
    let begun = match (&opened, &result) {
        (Err(_), _) => 1,
        (_, Ok(())) => acked,
        (_, Err(e)) => {
            assert_clear(e, what);
            story.ends[ends.len()]
        }
    };
    assert_eq!(ends, story.ends[..ends.len()], "{what}");
    // A crash here leaves the one or the other, or what is between them.
    let (image, synced) = (disk.image(), disk.synced());
    let seen = judge(image.clone(), &story.states, acked, begun, what);
    if synced != image {
        judge(synced, &story.states, acked, begun, what);
    }

    // Another writer goes on.
    let next: Arc<Disk> = Arc::new(Disk::new(image));
    let writer = open(next.clone()).unwrap_or_else(|e| panic!("{what}: cannot be opened: {e}"));
    let (state, generation) = go_on(&writer, &story.states[seen as usize])
        .unwrap_or_else(|e| panic!("{what}: another writer: {e}"));
    drop(writer);
    assert_eq!(generation, seen + 1, "{what}");
    let mut states = story.states[..=seen as usize].to_vec();
    states.push(state);
    judge(next.image(), &states, generation, generation, what);
    let report = verify_in(next, Path::new(NAME), &budget()).expect("reads");
    assert!(report.is_intact(), "{what}: {report:#?}");

    // So does the same one, unless nobody knows what the medium holds.
    let mut ended = false;
    if let (Ok(writer), Err(_)) = (&opened, &result) {
        disk.heal();
        // Says once that the commit which failed is given up.
        let given_up = writer.commit().err();
        match go_on(writer, &story.states[seen as usize]) {
            Ok((state, generation)) => {
                // What the first commit may have found to do is the generation before.
                let mut states = story.states[..generation as usize].to_vec();
                states.push(state);
                judge(disk.image(), &states, generation, generation, what);
            }
            Err(e) => {
                assert_eq!(e.kind(), ErrorKind::Poisoned, "{what}: {given_up:?}; {e}");
                ended = true;
            }
        }
    }
    Outcome {
        refused: opened.is_err() || result.is_err(),
        ended,
    }
}

#[test]
fn a_fault_at_any_call_of_an_edit_keeps_what_was_committed() {
    let story = story();
    assert!(story.calls >= 300, "{} calls", story.calls);
    let step = if cfg!(debug_assertions) { 23 } else { 1 };
    let (mut runs, mut refused, mut ended) = (0, 0, 0);
    for fault in Fault::ALL {
        let (last, step, losses) = match fault {
            Fault::Sync => (story.syncs, 1, 8),
            _ => (story.calls, step, 1),
        };
        for at in (0..last).step_by(step) {
            // Once, and from then on; by turns where it is the same to a writer.
            let stays: &[bool] = match (fault, at % 2) {
                (Fault::Interrupted | Fault::Short, 0) => &[false],
                (Fault::Interrupted | Fault::Short, _) => &[true],
                _ => &[false, true],
            };
            for &stays in stays {
                for loss in 0..losses {
                    let what = format!("{fault:?} at call {at}, stays: {stays}, loss {loss}");
                    let plan = Plan {
                        at: Some((at, fault)),
                        stays,
                        capacity: None,
                    };
                    let outcome = try_one(&story, plan, loss, &what);
                    refused += u64::from(outcome.refused);
                    ended += u64::from(outcome.ended);
                    runs += 1;
                }
            }
        }
    }
    assert!(2 * refused > runs && ended > 0 && ended < refused);
    figure(&format!(
        "faults of a writer of an existing file: {runs} runs of {} calls, {refused} refused ({ended} times for good), every commit kept",
        story.calls
    ));
}

/// The next commit had the part of a level that there was, as if it were whole.
#[test]
fn a_level_that_was_not_finished_is_not_shown() {
    let story = story();
    let whole = story.image.len() as u64;
    for more in [0, 200, 600, 2000] {
        let what = format!("room for {more} bytes");
        let plan = Plan {
            capacity: Some(whole + more),
            ..Plan::default()
        };
        let disk = Arc::new(Disk::failing(story.image.clone(), plan, 0));
        let mut writer = open(disk.clone()).expect("opens");
        let error = writer.build_levels(2).expect_err("no room");
        assert_clear(&error, &what);
        disk.heal();
        let (state, generation) = go_on(&writer, &story.states[1]).expect("goes on");
        assert_eq!(generation, 2, "{what}");
        let mut states = vec![story.states[0].clone(), story.states[1].clone(), state];
        judge(disk.image(), &states, 2, 2, &what);
        // And it is built when there is room.
        writer.build_levels(2).expect("builds");
        states.extend([states[2].clone(), states[2].clone()]);
        (states[3].levels, states[4].levels) = (Some(1), Some(2));
        judge(disk.image(), &states, 4, 4, &what);
    }
}

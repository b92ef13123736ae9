//! Eight clients at one time: answers equal to the file, memory within the budget.

use super::client::{Keeper, Server};
use crate::cli::words;
use crate::support::program::{brickmarch, data_gen};
use crate::support::report::figure;
use crate::support::rng::Rng;
use crate::support::scratch::Scratch;
use brickmarch::store::Volume;
use brickmarch::{Box3, Budget, Field};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

const CLIENTS: u64 = 8;
const MEM: u64 = 64 << 20;
/// What the program takes beside its budget.
const OVERHEAD: u64 = 48 << 20;

/// `BRICKMARCH_SERVE_REQUESTS`: the long form, against a volume of 1024^3.
fn size() -> (u32, u64) {
    match std::env::var("BRICKMARCH_SERVE_REQUESTS") {
        Ok(text) => (
            1024,
            text.parse().expect("BRICKMARCH_SERVE_REQUESTS is a number"),
        ),
        Err(_) => (160, 200),
    }
}

#[test]
fn eight_clients_inside_one_budget() {
    let (n, requests) = size();
    let scratch = Scratch::new("serve-load");
    let path = scratch.path("g.bvol");
    let text = path.to_string_lossy().into_owned();
    data_gen(["level-set", "gyroid", "--n", &n.to_string(), "--out", &text]).success();
    let server = Server::start(&scratch, &format!("@g.bvol --mem {MEM}"));
    let times = Mutex::new(Vec::new());
    let begun = Instant::now();
    std::thread::scope(|scope| {
        for client in 0..CLIENTS {
            let (server, times, path, scratch) = (&server, &times, &path, &scratch);
            scope.spawn(move || {
                let volume = Volume::open(path, &Budget::mib(32)).expect("opens");
                let mut rng = Rng::new(100 + client);
                let mut keeper = Keeper::new(server);
                for request in 0..requests / CLIENTS {
                    let region = region(&mut rng, volume.grid().domain);
                    let list = |v: [i32; 3]| format!("{},{},{}", v[0], v[1], v[2]);
                    let query = format!("min={}&max={}", list(region.min), list(region.max));
                    let begun = Instant::now();
                    let reply = keeper.get(&format!("/api/volumes/g/region?{query}")).ok();
                    times
                        .lock()
                        .expect("no client panicked")
                        .push(begun.elapsed());
                    let mut expected = vec![0; reply.body.len()];
                    volume.read_raw(region, &mut expected).expect("reads");
                    assert!(reply.body == expected, "{query}");
                    if request == 0 {
                        let (min, max) = (region.min, region.max);
                        let roi: Vec<_> =
                            (0..3).map(|a| format!("{}:{}", min[a], max[a])).collect();
                        let line =
                            format!("export @g.bvol @{client}.raw -q --roi {}", roi.join(","));
                        brickmarch(words(scratch, &line)).success();
                        let exported = std::fs::read(scratch.path(&format!("{client}.raw")));
                        assert!(reply.body == exported.expect("written"), "{query}");
                    }
                }
            });
        }
    });
    let took = begun.elapsed();
    let mut times = times.into_inner().expect("no client panicked");
    times.sort();
    assert_eq!(times.len() as u64, requests / CLIENTS * CLIENTS);
    let at = |part: usize| milliseconds(times[(times.len() - 1) * part / 100]);
    let peak = server.memory("VmHWM");
    figure(&format!(
        "serve: {} random regions of {n}^3 by {CLIENTS} clients: median {}, 99th percentile {}, \
         {:.0} requests/s, peak {} MiB of {} + {}",
        times.len(),
        at(50),
        at(99),
        times.len() as f64 / took.as_secs_f64(),
        peak.map_or("unknown".to_string(), |p| (p >> 20).to_string()),
        MEM >> 20,
        OVERHEAD >> 20,
    ));
    if let Some(peak) = peak {
        assert!(peak <= MEM + OVERHEAD, "peak {peak}");
    }
}

/// Surfaces, slices and regions at one time, in the smallest budget: each is answered or told to come
/// again, and the memory holds.
#[test]
fn all_kinds_of_requests_at_one_time() {
    let scratch = super::gyroid("serve-kinds", 64);
    let server = Server::start(&scratch, &format!("@g.bvol @flat.bvol --mem {MEM}"));
    let rounds = if size().0 == 1024 { 12 } else { 2 };
    let kinds = [
        "/api/volumes/g/preview?iso=0.5",
        "/api/volumes/g/mesh?iso=-0.5&level=1&format=stl",
        "/api/volumes/flat/mesh?iso=0",
        "/api/volumes/flat/preview?iso=1&size=600x500&view=200,-40",
        "/api/volumes/g/slice?axis=x&at=40&scale=7&map=inferno",
        "/api/volumes/flat/slice?axis=y&at=3",
        "/api/volumes/g/slice?axis=z&level=2&scale=9",
        "/api/volumes/flat/region?min=0,0,0&max=64,64,64",
        "/api/volumes/g/region?min=1,1,1&max=32,31,30&level=1&format=npy",
        "/api/volumes/g/value?at=1,2,3&level=2",
        "/api/volumes/flat",
    ];
    let expected = kinds.map(|path| server.get(path).ok().body);
    let busy = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for client in 0..CLIENTS {
            let (server, busy, expected) = (&server, &busy, &expected);
            scope.spawn(move || {
                let mut rng = Rng::new(900 + client);
                let mut keeper = Keeper::new(server);
                for _ in 0..rounds {
                    let kind = rng.below(kinds.len() as u64) as usize;
                    let begun = Instant::now();
                    loop {
                        let reply = keeper.get(kinds[kind]);
                        if reply.status == 503 {
                            assert_eq!(reply.header("retry-after"), Some("1"));
                            busy.fetch_add(1, Ordering::Relaxed);
                            let waited = begun.elapsed();
                            assert!(waited < Duration::from_secs(60), "{} never", kinds[kind]);
                            std::thread::sleep(Duration::from_millis(50));
                            continue;
                        }
                        assert!(reply.ok().body == expected[kind], "{}", kinds[kind]);
                        break;
                    }
                }
            });
        }
    });
    let peak = server.memory("VmHWM");
    figure(&format!(
        "serve: all kinds of requests by {CLIENTS} clients: {} times told to come again, peak {} MiB of {} + {}",
        busy.into_inner(),
        peak.map_or("unknown".to_string(), |p| (p >> 20).to_string()),
        MEM >> 20,
        OVERHEAD >> 20,
    ));
    if let Some(peak) = peak {
        assert!(peak <= MEM + OVERHEAD, "peak {peak}");
    }
}

/// A box with edges up to 64; one in sixteen is a long one.
fn region(rng: &mut Rng, domain: Box3) -> Box3 {
    let size = domain.size();
    let long = rng.chance(16).then(|| rng.below(3) as usize);
    let mut min = [0; 3];
    let mut max = [0; 3];
    for a in 0..3 {
        let most = if long == Some(a) {
            size[a]
        } else {
            size[a].min(64)
        };
        let edge = rng.between(1, most as i32 + 1);
        min[a] = domain.min[a] + rng.between(0, size[a] as i32 - edge + 1);
        max[a] = min[a] + edge;
    }
    Box3 { min, max }
}

fn milliseconds(time: Duration) -> String {
    format!("{:.1} ms", time.as_secs_f64() * 1e3)
}

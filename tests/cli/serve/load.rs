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

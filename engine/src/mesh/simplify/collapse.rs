//! Collapse of edges: a vertex goes onto one of its neighbours, the cheapest first, by quadric errors
//! (Garland and Heckbert 1997), where the surface stays a manifold of the same topology (the link
//! condition of Dey, Edelsbrunner, Guha and Nekhayev 1999) and no triangle turns over.
//!
//! Every triangle knows the vertices that went near it, and a collapse that would leave one of them
//! too far away is refused.

use super::near::{cross, dot, mean_side, square_to, sub};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

type Point = [f64; 3];

/// What a vertex costs that goes along an edge in a plane, as a share of the square of its length, so
/// that short ones go first.
const LENGTH: f64 = 1e-7;

/// Where any error will do: the first, in mean sides, and how often it is doubled.
const FIRST: f64 = 0.1;
const ROUNDS: usize = 20;

/// Least cosine between the normals of a triangle after and of the surface before.
const TURN: f64 = 0.2;

/// Height over longest side below which a triangle is a sliver; none is made that is worse than those
/// that were there.
const SLIVER: f64 = 0.02;

/// The triangles while they get fewer.
struct Net<'a> {
    positions: &'a [[f32; 3]],
    /// Subtracted from positions.
    middle: Point,
    triangles: Vec<[u32; 3]>,
    /// Triangles at each vertex.
    around: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    /// How often the surroundings of a vertex changed.
    changes: Vec<u32>,
    /// Vertices that went near each triangle.
    gone: Vec<Vec<u32>>,
    queue: BinaryHeap<Reverse<(u64, u32, u32)>>,
    /// Square of the distance that is allowed.
    limit: f64,
}

/// Sum of squares of distances from planes, weighted by area: `p A p + 2 b p + c`.
#[derive(Clone, Copy, Default)]
struct Quadric {
    a: [f64; 6],
    b: Point,
    c: f64,
}

impl Quadric {
    fn add(&mut self, other: &Self) {
        (0..6).for_each(|i| self.a[i] += other.a[i]);
        (0..3).for_each(|i| self.b[i] += other.b[i]);
        self.c += other.c;
    }

    fn plane(n: Point, at: Point, weight: f64) -> Self {
        let d = -dot(n, at);
        let [x, y, z] = n;
        Self {
            a: [x * x, x * y, x * z, y * y, y * z, z * z].map(|v| v * weight),
            b: n.map(|v| v * d * weight),
            c: d * d * weight,
        }
    }

    fn at(&self, p: Point) -> f64 {
        let [x, y, z] = p;
        let a = &self.a;
        let square = a[0] * x * x + a[3] * y * y + a[5] * z * z;
        let mixed = a[1] * x * y + a[2] * x * z + a[4] * y * z;
        square + 2.0 * (mixed + dot(self.b, p)) + self.c
    }
}

/// Collapses edges of `triangles` until `target` are left or nothing can go; vertices that are
/// `locked` stay, and so do all triangles at a vertex without a closed ring of triangles when its
/// neighbours are locked too. Every vertex that goes stays within `error` of the result; where that is
/// infinite, an error that doubles when nothing else can go.
pub(super) fn collapse(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    locked: &[bool],
    target: usize,
    error: f64,
) -> Vec<[u32; 3]> {
    let endless = error.is_infinite();
    let first = match endless {
        true => FIRST * mean_side(positions, triangles),
        false => error,
    };
    let mut net = Net::new(positions, triangles, first);
    let mut left = triangles.len();
    for _ in 0..if endless { ROUNDS } else { 1 } {
        net.go(locked, target, &mut left);
        net.limit *= 4.0;
    }
    net.triangles.retain(|t| t[0] != u32::MAX);
    net.triangles
}

impl<'a> Net<'a> {
    /// Collapses what can be within the limit.
    fn go(&mut self, locked: &[bool], target: usize, left: &mut usize) {
        let net = self;
        if *left <= target {
            return;
        }
        for u in 0..net.positions.len() as u32 {
            if !locked[u as usize] {
                net.push(u);
            }
        }
        let (mut choice, mut ring) = (Vec::new(), Vec::new());
        while *left > target {
            let Some(Reverse((_, u, change))) = net.queue.pop() else {
                break;
            };
            if net.changes[u as usize] != change || net.around[u as usize].is_empty() {
                continue;
            }
            net.ring(u, &mut ring);
            choice.clear();
            choice.extend(ring.iter().map(|&v| (net.cost(u, v), v)));
            choice.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for &(_, v) in choice.iter().filter(|c| c.0.is_finite()) {
                if net.is_sound(u, v, &ring) && net.carry(u, v) {
                    *left -= 2;
                    net.ring(v, &mut ring);
                    net.changes[v as usize] += 1;
                    for &w in ring.iter().chain([&v]) {
                        net.changes[w as usize] += 1;
                        if !locked[w as usize] {
                            net.push(w);
                        }
                    }
                    break;
                }
            }
        }
    }

    fn new(positions: &'a [[f32; 3]], triangles: &[[u32; 3]], error: f64) -> Self {
        let first = triangles.first().map_or(0, |t| t[0] as usize);
        let mut net = Self {
            positions,
            middle: positions.get(first).map_or([0.0; 3], |p| p.map(f64::from)),
            triangles: triangles.to_vec(),
            around: vec![Vec::new(); positions.len()],
            quadrics: vec![Quadric::default(); positions.len()],
            changes: vec![0; positions.len()],
            gone: vec![Vec::new(); triangles.len()],
            queue: BinaryHeap::new(),
            limit: error * error,
        };
        for (n, t) in triangles.iter().enumerate() {
            let corners = t.map(|v| net.at(v));
            let normal = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]));
            let doubled = dot(normal, normal).sqrt();
            for &v in t {
                net.around[v as usize].push(n as u32);
                if doubled > 0.0 {
                    let plane =
                        Quadric::plane(normal.map(|x| x / doubled), corners[0], doubled / 6.0);
                    net.quadrics[v as usize].add(&plane);
                }
            }
        }
        net
    }

    fn at(&self, v: u32) -> Point {
        sub(self.positions[v as usize].map(f64::from), self.middle)
    }

    /// The neighbours of a vertex, each once where its triangles form a ring.
    fn ring(&self, u: u32, ring: &mut Vec<u32>) {
        ring.clear();
        for &n in &self.around[u as usize] {
            ring.push(after(self.triangles[n as usize], u)[0]);
        }
    }

    fn cost(&self, u: u32, v: u32) -> f64 {
        let (p, q) = (self.at(u), self.at(v));
        let way = sub(p, q);
        let mut quadric = self.quadrics[u as usize];
        quadric.add(&self.quadrics[v as usize]);
        let length = dot(way, way);
        let off = quadric.at(q).max(0.0);
        let [xx, _, _, yy, _, zz] = quadric.a;
        if off > self.limit * (xx + yy + zz) {
            // The mean is too far away.
            return f64::INFINITY;
        }
        off + LENGTH * length * length
    }

    fn push(&mut self, u: u32) {
        let around = self.around[u as usize].iter();
        let costs = around.map(|&n| self.cost(u, after(self.triangles[n as usize], u)[0]));
        let least = costs.fold(f64::INFINITY, f64::min);
        if least.is_finite() {
            let change = self.changes[u as usize];
            // Numbers from 0 on are ordered as their bits are.
            self.queue.push(Reverse((least.to_bits(), u, change)));
        }
    }

    /// Whether the surface is one without turned triangles when `u` goes onto `v`, one of its `ring`.
    fn is_sound(&self, u: u32, v: u32, ring: &[u32]) -> bool {
        let (of_u, of_v) = (&self.around[u as usize], &self.around[v as usize]);
        if of_u.len() == 3 && of_v.len() == 3 {
            return false;
        }
        // Neighbours of both, and nobody else, are across the edge.
        let mut common = 0;
        for &n in of_v {
            let pair = after(self.triangles[n as usize], v);
            common += u32::from(ring.contains(&pair[0]));
        }
        let shared = of_u
            .iter()
            .filter(|&&n| self.triangles[n as usize].contains(&v))
            .count();
        if common != 2 || shared != 2 {
            return false;
        }
        let mut out = [0.0; 3];
        let mut worst: f64 = 1.0;
        let place = |w: u32| self.at(w);
        for &n in of_u {
            let (normal, shape) = normal_and_shape(self.triangles[n as usize].map(place));
            (0..3).for_each(|a| out[a] += normal[a]);
            worst = worst.min(shape);
        }
        let size = dot(out, out).sqrt();
        of_u.iter().all(|&n| {
            let t = self.triangles[n as usize];
            if t.contains(&v) {
                return true;
            }
            let (was, shape_was) = normal_and_shape(t.map(place));
            let (normal, shape) = normal_and_shape(t.map(|w| place(if w == u { v } else { w })));
            let length = dot(normal, normal).sqrt();
            let turned = |from: Point, size: f64| dot(normal, from) <= TURN * length * size;
            let tells = shape_was > SLIVER;
            length > 0.0
                && !turned(out, size)
                && !(tells && turned(was, dot(was, was).sqrt()))
                && (shape > SLIVER || shape > worst)
        })
    }

    /// Lets `u` go onto `v`, unless a vertex would be too far away.
    fn carry(&mut self, u: u32, v: u32) -> bool {
        let star = std::mem::take(&mut self.around[u as usize]);
        let (lost, kept): (Vec<u32>, Vec<u32>) = star
            .iter()
            .partition(|&&n| self.triangles[n as usize].contains(&v));
        if !self.hand_over(u, v, &star, &kept) {
            self.around[u as usize] = star;
            return false;
        }
        for &n in &lost {
            let t = std::mem::replace(&mut self.triangles[n as usize], [u32::MAX; 3]);
            for w in t.into_iter().filter(|&w| w != u) {
                self.around[w as usize].retain(|&m| m != n);
            }
        }
        for &n in &kept {
            let t = &mut self.triangles[n as usize];
            *t = t.map(|w| if w == u { v } else { w });
            self.around[v as usize].push(n);
        }
        let quadric = self.quadrics[u as usize];
        self.quadrics[v as usize].add(&quadric);
        true
    }

    /// Gives the vertices that went near `star`, and `u`, to the nearest of the `kept` triangles as
    /// they become; false, with nothing changed, when that is too far for one.
    fn hand_over(&mut self, u: u32, v: u32, star: &[u32], kept: &[u32]) -> bool {
        let moved = |n: &u32| {
            let t = self.triangles[*n as usize];
            t.map(|w| self.at(if w == u { v } else { w }))
        };
        let corners: Vec<[Point; 3]> = kept.iter().map(moved).collect();
        let mut places = Vec::new();
        for &n in star {
            // Mostly the triangle that it was near to is still good enough.
            let own = kept.iter().position(|&k| k == n).unwrap_or(0);
            let gone = self.gone[n as usize].iter();
            let this = (n == star[0]).then_some(&u);
            for &g in gone.chain(this) {
                let p = self.at(g);
                let near = |i: &usize| square_to(p, corners[*i]) <= self.limit;
                let others = (0..kept.len()).filter(|&i| i != own);
                match std::iter::once(own).chain(others).find(near) {
                    Some(i) => places.push((g, kept[i])),
                    None => return false,
                }
            }
        }
        // What is new must also be near to what it takes the place of.
        let old: Vec<[Point; 3]> = star
            .iter()
            .map(|&n| self.triangles[n as usize].map(|w| self.at(w)))
            .collect();
        for t in &corners {
            let between = |i: usize, j: usize| std::array::from_fn(|a| (t[i][a] + t[j][a]) / 2.0);
            let centre = std::array::from_fn(|a| (t[0][a] + t[1][a] + t[2][a]) / 3.0);
            for p in [centre, between(0, 1), between(1, 2), between(2, 0)] {
                if old.iter().all(|o| square_to(p, *o) > self.limit) {
                    return false;
                }
            }
        }
        for &n in star {
            self.gone[n as usize].clear();
        }
        for (g, n) in places {
            self.gone[n as usize].push(g);
        }
        true
    }
}

/// The two corners after `u`.
fn after(t: [u32; 3], u: u32) -> [u32; 2] {
    match t.iter().position(|&w| w == u) {
        Some(0) => [t[1], t[2]],
        Some(1) => [t[2], t[0]],
        _ => [t[0], t[1]],
    }
}

/// Normal of twice the area's length, and height over longest side.
fn normal_and_shape([a, b, c]: [Point; 3]) -> (Point, f64) {
    let (u, v, w) = (sub(b, a), sub(c, a), sub(c, b));
    let normal = cross(u, v);
    let longest = dot(u, u).max(dot(v, v)).max(dot(w, w));
    let shape = dot(normal, normal).sqrt() / longest.max(f64::MIN_POSITIVE);
    (normal, shape)
}

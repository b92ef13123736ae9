#!/usr/bin/env python3
"""Figures of `sample` and `ray`: speed beside SciPy, hits on thin shells and on an analytic sphere.

    python3 benches/query.py PROGRAM VOLUME [--sphere SPHERE] [--points N] [--rays N]

VOLUME is a large f32 volume (brickmarch-data-gen level-set gyroid --n 1024 --out VOLUME). SciPy gets a dense
copy of the middle 256^3 of it, then of the whole, and the same points; the program reads the volume in 64
MiB. Both read their points from a NumPy file and write points and values to another. Of each kind the
first million values are compared with trilinear interpolation in single precision, bit for bit. Times
are those of a core, so that other work on the machine counts little.
"""
import argparse
import json
import pathlib
import resource
import subprocess
import tempfile
import time

import numpy as np
from scipy.ndimage import map_coordinates


def run(program, *words):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = subprocess.run([program, *map(str, words), "--json", "-q"], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(out.stdout)
    report["cpu"] = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return report


def trilinear(values, points):
    """Trilinear interpolation in f32: along x, then y, then z; a neighbour without weight does not count."""
    base = np.floor(points).astype(np.int64)
    t = (points - base).astype(np.float32)
    step = (t > 0).astype(np.int64)

    def corner(dx, dy, dz):
        x, y, z = (base + step * [dx, dy, dz]).T
        return values[z, y, x]

    def mix(a, b, t):
        return np.where(t == 0, a, a + (b - a) * t)

    x, y, z = t.T
    low = mix(mix(corner(0, 0, 0), corner(1, 0, 0), x), mix(corner(0, 1, 0), corner(1, 1, 0), x), y)
    high = mix(mix(corner(0, 0, 1), corner(1, 0, 1), x), mix(corner(0, 1, 1), corner(1, 1, 1), x), y)
    return mix(low, high, z)


def points_figures(program, volume, count, folder, threads):
    rng = np.random.default_rng(1)
    size = run(program, "info", volume)["volume"]["size"][0]
    low, high = size // 2 - 128, size // 2 + 128
    walk = np.cumsum(rng.normal(scale=0.3, size=(count, 3)), axis=0)
    # A path that turns back at the walls.
    walk = np.abs((walk + 127) % 508 - 254)
    run(program, "export", volume, folder / "part.npy", "--roi", ",".join([f"{low}:{high}"] * 3))
    part = np.load(folder / "part.npy").astype(np.float32)
    compare(program, volume, part, low, walk, "coherent in 256^3", folder, threads)
    compare(program, volume, part, low, rng.uniform(0, 255, (count, 3)), "random in 256^3", folder, threads)
    (folder / "part.npy").unlink()
    run(program, "export", volume, folder / "whole.npy")
    whole = np.load(folder / "whole.npy", mmap_mode=None)
    (folder / "whole.npy").unlink()
    compare(program, volume, whole, 0, walk + low, "coherent in the whole", folder, threads)
    compare(program, volume, whole, 0, rng.uniform(0, size - 1, (count, 3)), "random in the whole", folder, threads)


def compare(program, volume, dense, low, inside, name, folder, threads):
    """Values at `inside`, positions in `dense`, whose lowest sample is at `low` of the volume."""
    np.save(folder / "points.npy", inside + low)
    report = run(program, "sample", volume, folder / "points.npy", "-o", folder / "out.npy", "--space", "index",
                 "--mem", "64MiB", "--threads", threads, "--overwrite")
    got = np.load(folder / "out.npy")[:, 3].astype(np.float32)
    start = time.process_time()
    inside = np.load(folder / "points.npy") - low
    reading = time.process_time()
    values = map_coordinates(dense, inside.T[::-1], order=1, output=np.float32)
    found = time.process_time()
    np.save(folder / "scipy.npy", np.column_stack([inside, values]))
    end = time.process_time()
    check = slice(0, min(len(inside), 1_000_000))
    wrong = int((got[check].view(np.uint32) != trilinear(dense, inside[check]).view(np.uint32)).sum())
    print(f"{name}: {len(inside)} points, {threads} threads, files included {report['cpu']:.2f} s of a core "
          f"({len(inside) / report['cpu'] / 1e6:.2f} M/s), SciPy {end - start:.2f} s "
          f"({len(inside) / (end - start) / 1e6:.2f} M/s), {found - reading:.2f} s without files; other bits than the "
          f"definition: {wrong}; peak {report['peak_rss_bytes'] / 2**20:.0f} MiB, "
          f"SciPy's array {dense.nbytes / 2**20:.0f} MiB", flush=True)


def cast(program, volume, rays, folder, threads, *words):
    np.save(folder / "rays.npy", rays)
    report = run(program, "ray", volume, folder / "rays.npy", "-o", folder / "hits.npy", "--space", "index",
                 "--threads", threads, "--mem", "64MiB", "--overwrite", *words)
    return np.load(folder / "hits.npy")[:, 1:4], report


def tell(name, hits, error, report, count):
    print(f"{name}: {count} rays, {int(np.isnan(hits[:, 0]).sum())} missed, farthest hit {np.nanmax(error):.2e} of a cell "
          f"from the surface, {report['cpu']:.2f} s of a core ({count / report['cpu'] / 1e6:.3f} M/s, files included), "
          f"peak {report['peak_rss_bytes'] / 2**20:.0f} MiB", flush=True)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1)[:, None]


def flat_shell(program, count, folder, threads):
    # A tent with its ridge on a lattice plane: trilinear interpolation is exact, and the shell above
    # -0.01 is a fiftieth of a cell thick.
    n = 192
    z = np.arange(n, dtype=np.float32)[:, None, None]
    np.save(folder / "tent.npy", np.broadcast_to(-np.abs(z - 96), (n, n, n)).astype(np.float32))
    run(program, "import", folder / "tent.npy", folder / "tent.bvol", "--kind", "density", "--overwrite")
    rng = np.random.default_rng(2)
    start, end = rng.uniform(1, n - 2, (2, count, 3))
    start[:, 2], end[:, 2] = rng.uniform(1, 90, count), rng.uniform(102, n - 2, count)
    flip = rng.random(count) < 0.5
    start[flip], end[flip] = end[flip].copy(), start[flip].copy()
    direction = unit(end - start)
    hits, report = cast(program, folder / "tent.bvol", np.hstack([start, direction]), folder, threads, "--iso", "-0.01")
    iso = float(np.float32(-0.01))
    expected = np.where(direction[:, 2] > 0, 96 + iso, 96 - iso)
    tell("flat shell, 0.02 of a cell thick", hits, np.abs(hits[:, 2] - expected), report, count)


def curved_shell(program, count, folder, threads):
    # The distance to a sphere without its sign, sampled and interpolated, is less than 0.6 everywhere on
    # the sphere (at most half a cell's diagonal is interpolated to 0.5 along an axis, less elsewhere): the
    # shell within has no hole. How exact hits are is seen by interpolation in double precision at them.
    n, radius = 192, 80.25
    center = np.array([95.3, 96.1, 94.7])
    grid = np.indices((n, n, n), dtype=np.float32)[::-1]
    values = np.abs(np.sqrt(sum((g - c) ** 2 for g, c in zip(grid, center))) - radius).astype(np.float32)
    np.save(folder / "shell.npy", values)
    run(program, "import", folder / "shell.npy", folder / "shell.bvol", "--kind", "distance", "--overwrite")
    rng = np.random.default_rng(3)
    start = center + unit(rng.normal(size=(count, 3))) * (radius + 4)
    # Through the shell, and steeply enough not to stay within the shell's own ripple.
    target = center + unit(rng.normal(size=(count, 3))) * rng.uniform(0, 0.98 * radius, (count, 1))
    direction = unit(target - start)
    hits, report = cast(program, folder / "shell.bvol", np.hstack([start, direction]), folder, threads, "--iso", "0.6")
    good = hits[~np.isnan(hits[:, 0])]
    base = np.floor(good).astype(np.int64)
    t = good - base
    value, slope = np.zeros(len(good)), np.zeros((len(good), 3))
    for corner in np.ndindex(2, 2, 2):
        x, y, z = (base + corner).T
        weights = np.where(corner, t, 1 - t)
        v = values[z, y, x].astype(np.float64)
        value += v * weights.prod(axis=1)
        for a in range(3):
            others = np.delete(weights, a, axis=1).prod(axis=1)
            slope[:, a] += v * others * (1 if corner[a] else -1)
    error = np.abs(value - float(np.float32(0.6))) / np.linalg.norm(slope, axis=1)
    tell("curved shell, 1.2 cells thick", hits, error, report, count)


def large_sphere(program, volume, count, folder, threads):
    # From outside to points well inside, so that all rays hit. Trilinear interpolation of a distance is
    # off by up to a quarter of a cell over the radius in cells.
    size = run(program, "info", volume)["volume"]["size"][0]
    center, radius = (size - 1) / 2, 0.4 * size
    rng = np.random.default_rng(4)
    start = center + unit(rng.normal(size=(count, 3))) * 0.49 * size
    target = center + unit(rng.normal(size=(count, 3))) * rng.uniform(0, 0.95 * radius, (count, 1))
    hits, report = cast(program, volume, np.hstack([start, unit(target - start)]), folder, threads, "--iso", "0")
    error = np.abs(np.linalg.norm(hits - center, axis=1) - radius)
    tell(f"analytic sphere, {size}^3", hits, error, report, count)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("volume", type=pathlib.Path)
    parser.add_argument("--sphere", type=pathlib.Path, help="brickmarch-data-gen level-set sphere, for rays")
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        flat_shell(args.program, args.rays, folder, args.threads)
        curved_shell(args.program, args.rays, folder, args.threads)
        if args.sphere:
            large_sphere(args.program, args.sphere, args.rays, folder, args.threads)
        points_figures(args.program, args.volume, args.points, folder, args.threads)


if __name__ == "__main__":
    main()

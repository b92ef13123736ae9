#!/usr/bin/env python3
"""Figures of `sample` and `ray`: speed beside SciPy, and hits on a thin shell.

    python3 benches/query.py PROGRAM VOLUME [--points N] [--rays N]

VOLUME is a large f32 volume (brickmarch-data-gen level-set gyroid --n 1024 --out VOLUME). SciPy gets a dense
copy of the middle 256^3 of it, and the same points; the program reads the whole volume in 64 MiB. Every
of the first million values is compared with trilinear interpolation in single precision, bit for bit.
Times are those of a core, so that other work on the machine counts little.
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
    middle = run(program, "info", volume)["volume"]["size"][0] // 2
    low, high = middle - 128, middle + 128
    run(program, "export", volume, folder / "part.npy", "--roi", ",".join([f"{low}:{high}"] * 3))
    part = np.load(folder / "part.npy").astype(np.float32)
    walk = np.cumsum(rng.normal(scale=0.3, size=(count, 3)), axis=0)
    # A path that turns back at the walls.
    walk = np.abs((walk + 127) % 508 - 254)
    for name, inside in [("random", rng.uniform(0, 255, (count, 3))), ("coherent", walk)]:
        np.save(folder / "points.npy", inside + low)
        inside = np.load(folder / "points.npy") - low
        report = run(program, "sample", volume, folder / "points.npy", "-o", folder / "out.npy", "--space", "index",
                     "--mem", "64MiB", "--threads", threads, "--overwrite")
        got = np.load(folder / "out.npy")[:, 3].astype(np.float32)
        start = time.process_time()
        map_coordinates(part, inside.T[::-1], order=1, output=np.float32)
        scipy = time.process_time() - start
        check = slice(0, min(count, 1_000_000))
        wrong = int((got[check].view(np.uint32) != trilinear(part, inside[check]).view(np.uint32)).sum())
        print(f"{name}: {count} points, {threads} threads, {report['cpu']:.2f} s of a core, files included "
              f"({count / report['cpu'] / 1e6:.2f} M/s); SciPy without files {scipy:.2f} s "
              f"({count / scipy / 1e6:.2f} M/s); other bits than the definition: {wrong}; "
              f"peak {report['peak_rss_bytes'] / 2**20:.0f} MiB")


def rays_figures(program, count, folder, threads):
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
    direction = end - start
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    np.save(folder / "rays.npy", np.hstack([start, direction]))
    report = run(program, "ray", folder / "tent.bvol", folder / "rays.npy", "-o", folder / "hits.npy", "--iso",
                 "-0.01", "--space", "index", "--threads", threads, "--overwrite")
    hits = np.load(folder / "hits.npy")
    missed = int(np.isnan(hits[:, 0]).sum())
    iso = float(np.float32(-0.01))
    expected = np.where(direction[:, 2] > 0, 96 + iso, 96 - iso)
    error = np.nanmax(np.abs(hits[:, 3] - expected))
    print(f"thin shell: {count} rays, {missed} missed, farthest hit {error:.2e} of a cell from the shell, "
          f"{report['cpu']:.2f} s of a core ({count / report['cpu'] / 1e6:.3f} M/s, files included)")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("volume", type=pathlib.Path)
    parser.add_argument("--points", type=int, default=10_000_000)
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rays_figures(args.program, args.rays, pathlib.Path(folder), args.threads)
        points_figures(args.program, args.volume, args.points, pathlib.Path(folder), args.threads)


if __name__ == "__main__":
    main()

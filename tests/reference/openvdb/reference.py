#!/usr/bin/python3
"""OpenVDB's side of the comparison. Arrays travel as raw little-endian f32, x fastest.

usage: reference.py make SCENE N OUT.raw OUT.vdb   a level set of half-width 3 made by OpenVDB
       reference.py mesh IN.raw N                   quads of the level set 0 of the array, as JSON
       reference.py load IN.raw N OUT.vdb           the array into a grid, into a file, and back; must be equal
       reference.py same IN.vdb IN.raw N            every voxel of the grid equals the array
"""
import json
import sys

import numpy as np

try:
    import pyopenvdb as vdb
except ImportError:
    import openvdb as vdb

HALF_WIDTH = 3.0


def read_raw(path, n):
    a = np.fromfile(path, dtype="<f4")
    assert a.size == n**3, f"{path}: {a.size} values, not {n}^3"
    return np.ascontiguousarray(a.reshape(n, n, n).transpose(2, 1, 0))


def write_raw(path, a):
    np.ascontiguousarray(a.transpose(2, 1, 0)).astype("<f4").tofile(path)


def to_grid(a):
    g = vdb.FloatGrid(HALF_WIDTH)
    g.copyFromArray(a, ijk=(0, 0, 0), tolerance=0.0)
    g.gridClass = vdb.GridClass.LEVEL_SET
    g.name = "field"
    return g


def to_array(g, n):
    a = np.empty((n, n, n), dtype=np.float32)
    g.copyToArray(a, ijk=(0, 0, 0))
    return a


def scene(name, n):
    """A closed level set inside 0..n."""
    c = (n - 1) / 2
    if name == "sphere":
        return vdb.createLevelSetSphere(radius=0.4 * n, center=(c, c, c), voxelSize=1.0, halfWidth=HALF_WIDTH)
    x, y, z = np.meshgrid(*[np.arange(n) - c] * 3, indexing="ij")
    if name == "torus":
        d = np.hypot(np.hypot(x, y) - 0.28 * n, z) - 0.14 * n
    elif name == "gyroid":
        k = 2 * np.pi * 2 / n
        f = np.sin(k * x) * np.cos(k * y) + np.sin(k * y) * np.cos(k * z) + np.sin(k * z) * np.cos(k * x)
        # A smooth maximum: across a sharp crease two ways of meshing differ by more than 0.1 %.
        a, b, width = f / k, np.sqrt(x * x + y * y + z * z) - 0.42 * n, 16.0
        h = np.clip(width - np.abs(a - b), 0, None)
        d = np.maximum(a, b) + h * h / (4 * width)
    else:
        sys.exit(f"no scene {name}")
    return to_grid(np.clip(d, -HALF_WIDTH, HALF_WIDTH).astype(np.float32))


def bits(a):
    return np.ascontiguousarray(a).view(np.uint32)


def measure(points, quads):
    """Area, signed volume, and how many edges do not have two quads."""
    p = points.astype(np.float64)
    # The library's quads turn inward on level sets.
    q = quads[:, ::-1].astype(np.int64)
    area = volume = 0.0
    for corners in ((0, 1, 2), (0, 2, 3)):
        a, b, c = (p[q[:, i]] for i in corners)
        cross = np.cross(b - a, c - a)
        area += 0.5 * np.linalg.norm(cross, axis=1).sum()
        volume += (a * cross).sum() / 6
    edges = np.sort(np.stack([q, np.roll(q, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return dict(area=float(area), volume=float(volume), open_edges=int((count % 2 != 0).sum()))


def main(command, args):
    if command == "make":
        name, n, raw, path = args
        g = scene(name, int(n))
        g.name = "field"
        write_raw(raw, to_array(g, int(n)))
        vdb.write(path, grids=[g])
    elif command == "mesh":
        raw, n = args
        a = read_raw(raw, int(n))
        points, quads = to_grid(a).convertToQuads(isovalue=0.0)
        below = a < 0
        crossed = sum(int((below[1:] != below[:-1]).sum()) for below in (np.moveaxis(below, k, 0) for k in range(3)))
        version = ".".join(map(str, vdb.LIBRARY_VERSION))
        result = dict(version=version, quads=len(quads), points=len(points), crossed_edges=crossed)
        print(json.dumps(dict(result, **measure(points, quads))))
    elif command == "load":
        raw, n, path = args
        a = read_raw(raw, int(n))
        vdb.write(path, grids=[to_grid(a)])
        back = to_array(vdb.read(path, "field"), int(n))
        assert (bits(back) == bits(a)).all(), f"{int((bits(back) != bits(a)).sum())} voxels changed"
        print(json.dumps(dict(voxels=a.size)))
    elif command == "same":
        path, raw, n = args
        a = read_raw(raw, int(n))
        back = to_array(vdb.read(path, "field"), int(n))
        assert (bits(back) == bits(a)).all(), f"{int((bits(back) != bits(a)).sum())} voxels differ"
        print(json.dumps(dict(voxels=a.size)))
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2:])

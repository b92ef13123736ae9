#!/usr/bin/env python3
"""Meshes large volumes whole and in pieces, and checks that every mesh is sound and that the pieces join.

usage: benches/soundness.py [--data FOLDER] [--noise 512] [--mem 256MiB] [--only WORD] [--folder FOLDER]

Per volume, three times over:
  cap    the whole with --boundary cap: closed, 2-manifold, oriented, no degenerate triangle;
  cut    the whole with --boundary cut: the same but open;
  tiles  eight pieces with --roi, --boundary tile and --keys: each 2-manifold, oriented, without degenerate
         triangles; on every plane between pieces the same vertices with equal bits from both sides and the same
         sides of triangles, run in opposite directions; and together as many triangles as the capped whole.

Volumes: a band-limited random field of --noise^3 and the real scans of FOLDER (default: $BRICKMARCH_DATA or
../shared/data). Needs release builds of brickmarch and brickmarch-data-gen, and NumPy. Prints a Markdown table;
stops at the first thing that is wrong.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

from real_scans import PROGRAM, ROOT, SCANS

VERTEX = np.dtype([("place", "<u4", 3), ("point", "<i4", 3), ("axis", "u1")])
TRIANGLE = np.dtype([("count", "u1"), ("corners", "<u4", 3)])


def run(*words, codes=(0,)):
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
    if done.returncode not in codes:
        sys.exit(f"{' '.join(map(str, words))}\nexit {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout) if done.stdout.strip().startswith("{") else None


def judge(mesh, closed, common):
    """The report of a mesh that is sound, closed or not."""
    found = run(PROGRAM, "check", mesh, *common, codes=(0, 3))["report"]
    assert found["manifold"] and found["oriented"] and found["degenerate_triangles"] == 0, (mesh, found)
    assert found["closed"] or not closed, (mesh, found)
    return found


def read(path):
    """Vertices and triangles of a binary PLY with keys, left on disk."""
    with open(path, "rb") as file:
        counts = {}
        while (line := file.readline()) != b"end_header\n":
            words = line.split()
            if words[0] == b"element":
                counts[words[1]] = int(words[2])
        at = file.tell()
    vertices = np.memmap(path, VERTEX, "r", at, counts[b"vertex"])
    at += vertices.nbytes
    return vertices, np.memmap(path, TRIANGLE, "r", at, counts[b"face"])


def seam(path, axis, at):
    """What a piece has in the plane `at` of `axis`: vertices by key, and sides of triangles by keys."""
    vertices, triangles = read(path)
    flat = (vertices["axis"] < 3) & (vertices["axis"] != axis) & (vertices["point"][:, axis] == at)
    numbers = np.flatnonzero(flat)
    chosen = vertices[numbers]
    # A key as one number; a plane spans less than 2^20 samples an axis.
    others = [a for a in range(3) if a != axis]
    u, v = (chosen["point"][:, a].astype(np.int64) + 2**19 for a in others)
    names = (u << 22 | v << 2 | chosen["axis"]).astype(np.uint64)
    order = np.argsort(names)
    sides = []
    for begin in range(0, len(triangles), 1 << 22):
        corners = triangles[begin : begin + (1 << 22)]["corners"]
        for k in range(3):
            a, b = corners[:, k], corners[:, (k + 1) % 3]
            both = flat[a] & flat[b]
            sides.append(np.stack([a[both], b[both]], 1))
    sides = np.concatenate(sides) if sides else np.zeros((0, 2), np.uint32)
    named = names[np.searchsorted(numbers, sides)]
    return names[order], chosen["place"][order], named


def ordered(sides):
    return sides[np.lexsort((sides[:, 1], sides[:, 0]))]


def join(low, high, axis, at):
    """Sides on the plane between two pieces, which must be the same from both."""
    names, places, sides = seam(low, axis, at)
    other_names, other_places, other_sides = seam(high, axis, at)
    assert np.array_equal(names, other_names), (low, high, "other vertices on the plane between them")
    assert np.array_equal(places, other_places), (low, high, "vertices of one key in two places")
    assert np.array_equal(ordered(sides), ordered(other_sides[:, ::-1])), (low, high, "other sides")
    return len(sides)


def domain(volume):
    info = run(PROGRAM, "info", volume, "--json")["volume"]
    return info["domain"]["min"], info["domain"]["max"]


def tiles(volume, options, folder, common, checks, whole):
    """Meshes and joins eight pieces; returns the sides on the planes between them."""
    low, high = domain(volume)
    middle = [a + (b - a) // 2 for a, b in zip(low, high)]
    paths, triangles, borders = [], 0, 0
    for number in range(8):
        ends = [(middle[a], high[a]) if number >> a & 1 else (low[a], middle[a]) for a in range(3)]
        path = f"{folder}/piece{number}.ply"
        region = ",".join(f"{a}:{b}" for a, b in ends)
        run(PROGRAM, "mesh", volume, path, *options, f"--roi={region}", "--boundary", "tile", "--keys",
            "--allow-empty", *common)
        vertices, faces = read(path)
        paths.append(path)
        triangles += len(faces)
        if len(faces):
            borders += judge(path, False, checks)["border_edges"]
    sides = sum(
        join(paths[number], paths[number | 1 << axis], axis, middle[axis])
        for axis in range(3)
        for number in range(8)
        if not number >> axis & 1
    )
    assert borders == 2 * sides, ("borders that no other piece meets", borders, sides)
    assert triangles == whole["triangles"], (triangles, whole)
    return sides


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default=os.environ.get("BRICKMARCH_DATA", ROOT / "../shared/data"))
    parser.add_argument("--noise", type=int, default=512, help="samples per axis of the random field")
    parser.add_argument("--mem", default="256MiB")
    parser.add_argument("--check-mem", default="16GiB", help="for the checks, which hold a mesh in memory")
    parser.add_argument("--only", default="", help="only volumes with this word in their name")
    parser.add_argument("--folder", help="where the meshes go")
    args = parser.parse_args()
    quiet = ["--progress", "none", "--json", "--overwrite"]
    print("| volume | triangles | vertices | components | genus | degenerate | open sides (cut) | sides between 8 pieces |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    volumes = [(f"noise {args.noise}", None, ["--iso", "0"])] + [(name, how, mesh) for name, how, mesh in SCANS]
    for name, how_import, options in volumes:
        if args.only not in name:
            continue
        with tempfile.TemporaryDirectory(dir=args.folder) as folder:
            volume, mesh = f"{folder}/volume.bvol", f"{folder}/mesh.ply"
            if how_import is None:
                run(ROOT / "target/release/brickmarch-data-gen", "field", "noise", "--n", args.noise, "--out", volume)
            else:
                source = pathlib.Path(args.data) / "volumes" / name
                run(PROGRAM, "import", source, volume, *how_import, "--mem", args.mem, *quiet)
            common, checks = ["--mem", args.mem, *quiet], ["--mem", args.check_mem, *quiet[:3]]
            run(PROGRAM, "mesh", volume, mesh, *options, "--boundary", "cut", *common)
            cut = judge(mesh, False, checks)
            run(PROGRAM, "mesh", volume, mesh, *options, *common)
            whole = judge(mesh, True, checks)
            os.remove(mesh)
            sides = tiles(volume, options, folder, common, checks, whole)
        print(
            f"| {name} | {whole['triangles']:,} | {whole['vertices']:,} | {whole['components']:,} | {whole['genus']:,} "
            f"| {whole['degenerate_triangles']} | {cut['border_edges']:,} | {sides:,} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Time and peak memory from file to binary PLY against the size of the volume: a table and a plot.

usage: PYTHON benches/scaling.py --openvdb BENCH [--runs 3] [--largest 8192] [--folder FOLDER] [--out FOLDER] [--plot PNG]

PYTHON has numpy, vtk and matplotlib; BENCH is the program of peers.py. Level sets of half-width 3 (sphere: up to 8192, gyroid
of 8 periods: up to 4096) by brickmarch (`--mem 64MiB --threads 2`) and OpenVDB; the whole field in a raw file by a script
that reads it, runs VTK's Flying Edges with two threads and writes the PLY (`dense.py --vtk`). The others stop where they
would need more than 12 GiB. Whole processes in turn, medians; triangles are compared before times are printed.
Volume and PLY are in the page cache or a file system in memory. Nothing else should run meanwhile.
"""
import argparse
import datetime
import json
import math
import os
import pathlib
import statistics
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from peers import RELEASE, ROOT, timed, warm  # noqa: E402

LARGEST = {
    "sphere": {"brickmarch": 8192, "OpenVDB": 2048, "VTK": 1024},
    "gyroid": {"brickmarch": 4096, "OpenVDB": 1024, "VTK": 1024},
}


def commands(scene, n, folder, mesh, openvdb):
    """Of each program: the file it reads, the command that makes it, the command that is timed, and how triangles are said."""
    made = {name: folder / f"{scene}-{n}.{ending}" for name, ending in
            [("brickmarch", "bvol"), ("OpenVDB", "vdb"), ("VTK", "raw")]}
    gen = RELEASE / "brickmarch-data-gen"
    return {
        "brickmarch": (
            made["brickmarch"], [gen, "level-set", scene, "--n", n, "--out", made["brickmarch"]],
            [RELEASE / "brickmarch", "mesh", made["brickmarch"], mesh, "--boundary", "cut", "--mem", "64MiB",
             "--threads", 2, "--overwrite", "--json", "-q"], lambda said: said["triangles"]),
        "OpenVDB": (
            made["OpenVDB"], [openvdb, "build", scene, n, made["OpenVDB"]],
            [openvdb, "mesh", made["OpenVDB"], "eager", mesh], lambda said: 2 * said["quads"]),
        "VTK": (
            made["VTK"], [gen, "field", scene, "--n", n, "--out", made["VTK"]],
            [sys.executable, ROOT / "benches/dense.py", "--vtk", made["VTK"], json.dumps([n] * 3), "<f4", "0.0", mesh],
            lambda said: said["triangles"]),
    }


def row(scene, n, name, ready, make, command, triangles, runs, mesh):
    if not ready.exists():
        timed(make)
    warm(ready)
    took = []
    for _ in range(runs):
        one, said = timed(command, {"VDB_THREADS": "2"})
        took.append(one)
        count = triangles(json.loads(said.splitlines()[-1]))
        size = mesh.stat().st_size
        mesh.unlink()
    middle = {k: statistics.median(t[k] for t in took) for k in took[0]}
    ready.unlink()
    print(f"| {scene} | {n} | {name} | {count:,} | {middle['wall']:.2f} | {middle['user'] + middle['sys']:.2f} "
          f"| {middle['mib']:.0f} |", flush=True)
    return {"scene": scene, "n": n, "program": name, "triangles": count, "bytes": size, "runs": took, **middle}


def slope(rows, key="wall"):
    """Least squares in log-log."""
    xs, ys = [math.log(r["n"]) for r in rows], [math.log(r[key]) for r in rows]
    mx, my = statistics.mean(xs), statistics.mean(ys)
    return sum((x - mx) * (y - my) for x, y in zip(xs, ys)) / sum((x - mx) ** 2 for x in xs)


def plot(rows, path):
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    figure, axes = plt.subplots(2, 2, figsize=(9, 7), sharex=True, constrained_layout=True)
    for column, scene in enumerate(LARGEST):
        for line, (key, label) in enumerate([("wall", "seconds, file to PLY"), ("mib", "peak MiB")]):
            ax = axes[line][column]
            for name, style in [("brickmarch", "o-"), ("OpenVDB", "s--"), ("VTK", "^:")]:
                some = [r for r in rows if r["scene"] == scene and r["program"] == name]
                ax.plot([r["n"] for r in some], [r[key] for r in some], style, label=name)
            ax.set_xscale("log", base=2)
            ax.set_yscale("log")
            ax.set_ylabel(label)
            ax.grid(True, which="major", alpha=0.4)
            ticks = sorted({r["n"] for r in rows})
            ax.set_xticks(ticks, [str(t) for t in ticks])
            if line == 0:
                ax.set_title(f"{scene}, 2 threads")
                ax.legend()
            else:
                ax.set_xlabel("samples along a side")
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--openvdb", required=True, type=pathlib.Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--largest", type=int, default=8192)
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path("/dev/shm"), help="for the volumes")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("/dev/shm"), help="for the meshes")
    parser.add_argument("--plot", type=pathlib.Path, default=ROOT / "docs/img/scaling.png")
    args = parser.parse_args()
    rows = []
    print("| scene | N | program | triangles | wall s | CPU s | peak MiB |\n|---|---|---|---|---|---|---|")
    for scene, largest in LARGEST.items():
        n = 256
        while n <= min(args.largest, largest["brickmarch"]):
            # 1.3 thousand million triangles (25 GB) do not fit in memory: to the folder of the system's scratch files.
            mesh = (args.out if (scene, n) != ("gyroid", 4096) else pathlib.Path("/tmp")) / "scaling.ply"
            some = []
            for name, (ready, make, command, triangles) in commands(scene, n, args.folder, mesh, args.openvdb).items():
                if n <= largest[name]:
                    runs = args.runs if n <= 1024 else 1
                    some.append(row(scene, n, name, ready, make, command, triangles, runs, mesh))
            counts = [r["triangles"] for r in some]
            # OpenVDB also closes the gyroid against the clipped border.
            assert max(counts) < (1 + 12 / n) * min(counts), f"{scene} {n}: {counts} triangles"
            rows += some
            n *= 2
    for scene in LARGEST:
        ours = [r for r in rows if r["scene"] == scene and r["program"] == "brickmarch" and r["n"] >= 512]
        print(f"\n{scene}: slope of time from 512 to {ours[-1]['n']}: {slope(ours):.2f} (CPU {slope([{**r, 'cpu': r['user'] + r['sys']} for r in ours], 'cpu'):.2f}), "
              f"peak at most {max(r['mib'] for r in ours):.0f} MiB")
    date = datetime.date.today().isoformat()
    (ROOT / f"benches/record/{date}-scaling.json").write_text(json.dumps({"cores": os.cpu_count(), "rows": rows}, indent=1) + "\n")
    plot(rows, args.plot)


if __name__ == "__main__":
    main()

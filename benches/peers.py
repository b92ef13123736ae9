#!/usr/bin/env python3
"""Meshes narrow-band level sets by brickmarch and by OpenVDB in turn, and prints a Markdown table.

usage: benches/peers.py --openvdb BENCH [--n 1024] [--runs 5] [--folder FOLDER] [--out FOLDER] [--mem 64MiB]

BENCH is a program with the verbs `build SCENE N OUT.vdb` and `mesh FILE.vdb eager OUT.ply` that prints one
JSON line with `quads` (OpenVDB's read, volumeToMesh, binary PLY). Both sides read a file from the page
cache and write a binary PLY, as whole processes, in the order A B A B. What is printed is the median wall
time, user and system time, and peak memory. Counts are compared before times are printed. The record goes
to benches/record. Nothing else should run meanwhile.
"""
import argparse
import datetime
import json
import os
import pathlib
import platform
import statistics
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
RELEASE = ROOT / "target/release"


def timed(words, env=None):
    """Wall, user, system seconds, peak MiB and standard output of a process."""
    start = datetime.datetime.now()
    read, write = os.pipe()
    pid = os.posix_spawn(
        str(words[0]), [str(w) for w in words], {**os.environ, **(env or {})},
        file_actions=[(os.POSIX_SPAWN_DUP2, write, 1), (os.POSIX_SPAWN_CLOSE, read)],
    )
    os.close(write)
    said = b""
    while part := os.read(read, 1 << 16):
        said += part
    os.close(read)
    _, status, usage = os.wait4(pid, 0)
    wall = (datetime.datetime.now() - start).total_seconds()
    if status:
        sys.exit(f"{' '.join(map(str, words))}: status {status}")
    return {"wall": wall, "user": usage.ru_utime, "sys": usage.ru_stime, "mib": usage.ru_maxrss / 1024}, said.decode()


def median(runs):
    return {key: statistics.median(run[key] for run in runs) for key in runs[0]}


def warm(path):
    with open(path, "rb") as file:
        while file.read(1 << 24):
            pass


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--openvdb", required=True, type=pathlib.Path)
    parser.add_argument("--n", type=int, default=1024)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--mem", default="64MiB")
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path("/tmp"), help="for the volumes")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("/dev/shm"), help="for the meshes")
    args = parser.parse_args()
    two = {"VDB_THREADS": "2"}
    record = {
        "date": datetime.date.today().isoformat(), "machine": platform.processor() or platform.machine(),
        "cores": os.cpu_count(), "n": args.n, "runs": args.runs, "mem": args.mem, "scenes": {},
    }
    print("| scene | program | wall s | user s | system s | peak MiB | file MB | triangles or quads |")
    print("|---|---|---|---|---|---|---|---|")
    for scene in ["sphere", "gyroid"]:
        ours = args.folder / f"{scene}-{args.n}.bvol"
        theirs = args.folder / f"{scene}-{args.n}.vdb"
        if not ours.exists():
            timed([RELEASE / "brickmarch-data-gen", "level-set", scene, "--n", args.n, "--out", ours])
        if not theirs.exists():
            timed([args.openvdb, "build", scene, args.n, theirs])
        warm(ours), warm(theirs)
        mesh = args.out / "peers.ply"
        runs = {"brickmarch": [], "OpenVDB": []}
        for _ in range(args.runs):
            took, said = timed([
                RELEASE / "brickmarch", "mesh", ours, mesh, "--boundary", "cut", "--mem", args.mem, "--threads", "2",
                "--overwrite", "--json", "-q",
            ])
            runs["brickmarch"].append(took)
            made = json.loads(said)
            mesh.unlink()
            took, said = timed([args.openvdb, "mesh", theirs, "eager", mesh], two)
            runs["OpenVDB"].append(took)
            quads = json.loads(said)["quads"]
            mesh.unlink()
        # A quad is a crossed edge away from the border, which is one of our vertices.
        off = made["vertices"] / quads - 1
        assert abs(off) < 0.02, f"{scene}: {made['vertices']} vertices, {quads} quads"
        sizes = {"brickmarch": ours.stat().st_size, "OpenVDB": theirs.stat().st_size}
        counts = {"brickmarch": made["triangles"], "OpenVDB": quads}
        medians = {name: median(some) for name, some in runs.items()}
        record["scenes"][scene] = {"runs": runs, "medians": medians, "bytes": sizes, "counts": counts}
        for name, m in medians.items():
            print(
                f"| {scene} {args.n} | {name} | {m['wall']:.2f} | {m['user']:.2f} | {m['sys']:.2f} | {m['mib']:.0f} "
                f"| {sizes[name] / 1e6:.1f} | {counts[name]:,} |"
            )
        a, b = medians["brickmarch"], medians["OpenVDB"]
        print(
            f"\n{scene}: {b['wall'] / a['wall']:.1f} times faster, {b['mib'] / a['mib']:.0f} times less memory, "
            f"file {sizes['brickmarch'] / sizes['OpenVDB']:.2f} of theirs\n"
        )
    path = ROOT / f"benches/record/{record['date']}-peers-{args.n}.json"
    path.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()

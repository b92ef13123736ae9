#!/usr/bin/env python3
"""Volumes of the scenes of the gallery at growing resolution: share of bricks evaluated, time, peak memory.

Seconds are of the clock, CPU seconds of all threads: on a busy machine the second say more.

usage: benches/models.py PROGRAM [SCENE|all [LARGEST [SECONDS]]]     default: machine_part, 4096, 90

A scene stops at the resolution whose run would take more than SECONDS, by four times the run before.
The slope is that of the last doubling and of all: bricks larger than what they show are nearly all
evaluated, so only the last ones say how work grows.
"""
import json
import math
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

MIB = 1 / (1 << 20)


def rows_of(program, path, largest, seconds_max):
    """(N, bricks evaluated, share, bytes, seconds, peak bytes, CPU seconds) at 256, 512, ..."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "scene.bvol"
        n, last = 256, 0.0
        while n <= largest and 4 * last <= seconds_max:
            command = [program, "model", path, out, "--resolution", str(n), "--mem", "256MiB", "--json", "--overwrite"]
            before = cpu_seconds()
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            cpu = cpu_seconds() - before
            f = json.loads(done.stdout)
            last = f["seconds"]
            yield n, f["bricks_evaluated"], f["share_evaluated"], f["bytes_out"], last, f["peak_rss_bytes"] or 0, cpu
            n *= 2


def cpu_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def slope(first, last, column):
    return math.log(last[column] / first[column]) / math.log(last[0] / first[0])


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    given = dict(enumerate(sys.argv))
    scene, largest, seconds_max = given.get(2, "machine_part"), int(given.get(3, 4096)), float(given.get(4, 90))
    folder = Path(__file__).parent.parent / "data-gen" / "scenes"
    paths = sorted(folder.glob("*.toml")) if scene == "all" else [folder / f"{scene}.toml"]
    if scene == "all":
        print("| scene | N | bricks evaluated | of all | seconds | CPU s | peak MiB | slope of bricks: all, last | of CPU time: all, last |")
        print("|---|---|---|---|---|---|---|---|---|")
        for path in paths:
            rows = list(rows_of(sys.argv[1], path, largest, seconds_max))
            n, bricks, share, _, seconds, peak, cpu = rows[-1]
            slopes = [[f"{slope(rows[i], rows[-1], c):.2f}" for i in (0, -2)] for c in (1, 6)] if len(rows) > 1 else [["-"]] * 2
            print(
                f"| {path.stem} | {n} | {bricks:,} | {100 * share:.2f} % | {seconds:.1f} | {cpu:.1f} | {peak * MIB:.1f} "
                f"| {', '.join(slopes[0])} | {', '.join(slopes[1])} |",
                flush=True,
            )
        return
    print("| N | bricks evaluated | of all | file MiB | seconds | CPU s | peak MiB |\n|---|---|---|---|---|---|---|")
    rows = []
    for row in rows_of(sys.argv[1], paths[0], largest, seconds_max):
        rows.append(row)
        n, bricks, share, size, seconds, peak, cpu = row
        print(
            f"| {n} | {bricks:,} | {100 * share:.2f} % | {size * MIB:.1f} | {seconds:.2f} | {cpu:.2f} | {peak * MIB:.1f} |",
            flush=True,
        )
    if len(rows) > 1:
        print(f"slope in log-log: {slope(rows[0], rows[-1], 6):.2f} for CPU time, {slope(rows[0], rows[-1], 1):.2f} for bricks")


if __name__ == "__main__":
    main()

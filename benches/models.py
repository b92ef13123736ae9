#!/usr/bin/env python3
"""Volumes of the scenes of the gallery at growing resolution: share of bricks evaluated, time, peak memory.

usage: benches/models.py PROGRAM [SCENE|all [LARGEST [SECONDS]]]     default: machine_part, 4096, 90

N is 256, 512, ... to LARGEST; a scene stops before the run that would take more than SECONDS by four times the
run before. Runs below 2 seconds are made three times, and the one with the least CPU time counts. Seconds are of
the clock, CPU seconds of all threads, user and system: on a busy machine the second say more.

Prints a Markdown table: for one scene its runs, for `all` the largest run of each with the slopes over N in log-log:
of the line of least squares through all runs, and of the last doubling. Every run goes to
benches/record/DATE-models.json. Volumes are written to the folder for temporary files (TMPDIR) and deleted: 23 GB at most.
"""
import datetime
import json
import math
import os
import platform
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SHORT = 2.0
MIB = 1 / (1 << 20)


def cpu_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(command):
    before = cpu_seconds()
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    cpu = cpu_seconds() - before
    f = json.loads(done.stdout)
    return {
        "bricks_evaluated": f["bricks_evaluated"],
        "share_evaluated": f["share_evaluated"],
        "bytes": f["bytes_out"],
        "seconds": f["seconds"],
        "cpu_seconds": cpu,
        "peak_mib": (f["peak_rss_bytes"] or 0) * MIB,
    }


def runs_of(program, path, largest, seconds_max):
    """The runs at 256, 512, ..."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "scene.bvol"
        n, last = 256, 0.0
        while n <= largest and 4 * last <= seconds_max:
            command = [program, "model", path, out, "--resolution", str(n), "--mem", "256MiB", "--json", "--overwrite"]
            try:
                runs = [measured(command)]
            except subprocess.CalledProcessError as refused:
                # A run that fails is no figure, and the other scenes go on.
                print(f"{path.stem} at {n}: {refused.stderr.strip().splitlines()[-1]}", file=sys.stderr)
                return
            if runs[0]["cpu_seconds"] < SHORT:
                runs += [measured(command) for _ in range(2)]
            run = {"n": n, **min(runs, key=lambda run: run["cpu_seconds"])}
            last = run["seconds"]
            yield run
            n *= 2


def slopes(runs, key):
    """Of the line of least squares through all runs in log-log, and of the last two."""
    if len(runs) < 2:
        return "-"
    points = [(math.log(run["n"]), math.log(run[key])) for run in runs]
    middle = [sum(column) / len(points) for column in zip(*points)]
    fit = sum((x - middle[0]) * (y - middle[1]) for x, y in points) / sum((x - middle[0]) ** 2 for x, _ in points)
    (x0, y0), (x1, y1) = points[-2:]
    return f"{fit:.2f}, {(y1 - y0) / (x1 - x0):.2f}"


def row(run, name=None):
    cells = [name] if name else []
    cells += [str(run["n"]), f"{run['bricks_evaluated']:,}", f"{100 * run['share_evaluated']:.2f} %"]
    cells += [f"{run['bytes'] * MIB:.1f}", f"{run['seconds']:.2f}", f"{run['cpu_seconds']:.2f}", f"{run['peak_mib']:.1f}"]
    return cells


def table_row(cells):
    print(f"| {' | '.join(cells)} |", flush=True)


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    given = dict(enumerate(sys.argv))
    scene, largest, seconds_max = given.get(2, "machine_part"), int(given.get(3, 4096)), float(given.get(4, 90))
    folder = ROOT / "data-gen" / "scenes"
    paths = sorted(folder.glob("*.toml")) if scene == "all" else [folder / f"{scene}.toml"]
    head = ["N", "bricks evaluated", "of all", "file MiB", "seconds", "CPU s", "peak MiB"]
    if scene == "all":
        head = ["scene", *head, "slope of bricks: all, last", "of CPU time: all, last"]
    table_row(head)
    table_row(["---"] * len(head))
    scenes = {}
    for path in paths:
        runs = scenes[path.stem] = []
        for run in runs_of(sys.argv[1], path, largest, seconds_max):
            runs.append(run)
            if scene != "all":
                table_row(row(run))
        if not runs:
            continue
        both = [slopes(runs, key) for key in ("bricks_evaluated", "cpu_seconds")]
        if scene == "all":
            table_row([*row(runs[-1], path.stem), *both])
        else:
            print(f"\nslope in log-log (all, last doubling): bricks {both[0]}; CPU time {both[1]}")
    record = {
        "date": datetime.date.today().isoformat(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "mem": "256MiB",
        "scenes": scenes,
    }
    if scene == "all":
        path = ROOT / f"benches/record/{record['date']}-models.json"
        path.write_text(json.dumps(record, indent=1) + "\n")
        print(f"\nrecord: {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()

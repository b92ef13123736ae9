#!/usr/bin/env python3
"""Volumes of the scenes of the gallery at growing resolution: share of bricks evaluated, time, peak memory.

usage: benches/models.py PROGRAM [SCENE [LARGEST]]     default: machine_part, 4096
"""
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    scene = sys.argv[2] if len(sys.argv) > 2 else "machine_part"
    largest = int(sys.argv[3]) if len(sys.argv) > 3 else 4096
    path = Path(__file__).parent.parent / "data-gen" / "scenes" / f"{scene}.toml"
    print("| N | bricks evaluated | of all | file MiB | seconds | peak MiB |\n|---|---|---|---|---|---|")
    rows = []
    n = 256
    with tempfile.TemporaryDirectory() as folder:
        while n <= largest:
            out = Path(folder) / "scene.bvol"
            command = [sys.argv[1], "model", path, out, "--resolution", str(n), "--mem", "256MiB", "--json", "--overwrite"]
            figures = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            rows.append((n, figures["seconds"], figures["bricks_evaluated"]))
            mib = 1 / (1 << 20)
            print(
                f"| {n} | {figures['bricks_evaluated']:,} | {100 * figures['share_evaluated']:.2f} % "
                f"| {figures['bytes_out'] * mib:.1f} | {figures['seconds']:.2f} "
                f"| {(figures['peak_rss_bytes'] or 0) * mib:.1f} |",
                flush=True,
            )
            n *= 2
    if len(rows) > 1:
        (n0, t0, b0), (n1, t1, b1) = rows[0], rows[-1]
        slope = lambda a, b: math.log(b / a) / math.log(n1 / n0)
        print(f"slope in log-log: {slope(t0, t1):.2f} for time, {slope(b0, b1):.2f} for bricks")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Slices and renderings of real scans and of a large field in 256 MiB: seconds of a core and peak memory of each.

    python3 benches/pictures.py PROGRAM DATA FIELD FOLDER

DATA is the folder of scans, FIELD a large volume file with the surface at 0. Pictures go to FOLDER, to be
looked at.
"""
import argparse
import json
import pathlib
import resource
import subprocess

MEMORY = "256MiB"
SIZE = "800x600"
# Name, source, iso, window.
SCANS = [
    ("tooth", "tooth.nhdr", 700, "0:1300"),
    ("stent", "stent_128x128x256_u8.nrrd", 9, "0:60"),
    ("chest", "ct_abdomen_512x512x275_u8.nrrd", 70, "0:110"),
    ("embryo", "embryo_256.mha", 120, "0:255"),
    ("brain", "ch2.nii.gz", 60, "0:120"),
]
PICTURES = [
    ("slice", lambda iso, window: ["slice", "--window", window, "--iso", str(iso)]),
    ("oblique slice", lambda iso, window: ["slice", "--normal", "1,1,0.3", "--window", window, "--iso", str(iso)]),
    ("surface", lambda iso, window: ["render", "--iso", str(iso), "--size", SIZE]),
    ("fog", lambda iso, window: ["render", "--fog", "--window", window, "--map", "inferno", "--opacity", "0.15", "--size", SIZE]),
    ("largest", lambda iso, window: ["render", "--max", "--window", window, "--size", SIZE]),
]


def run(program, *words):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = subprocess.run([program, *map(str, words), "--json", "-q", "--mem", MEMORY], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(out.stdout)
    report["cpu"] = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return report


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("data", type=pathlib.Path)
    parser.add_argument("field", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    args = parser.parse_args()
    volumes = []
    for name, source, iso, window in SCANS:
        volume = args.folder / f"{name}.bvol"
        run(args.program, "import", args.data / source, volume, "--overwrite")
        volumes.append((name, volume, iso, window))
    volumes.append((args.field.stem, args.field, 0, "-3:3"))
    print("| volume | size | " + " | ".join(name for name, _ in PICTURES) + " |")
    print("|---|---|" + "---|" * len(PICTURES))
    for name, volume, iso, window in volumes:
        size = run(args.program, "info", volume)["volume"]["size"]
        cells = []
        for kind, words in PICTURES:
            picture = args.folder / f"{name}_{kind.replace(' ', '_')}.png"
            command, *options = words(iso, window)
            # Values that start with a minus are joined to their option.
            joined = []
            for word in options:
                if joined and joined[-1] in ("--window", "--iso"):
                    joined[-1] += "=" + word
                else:
                    joined.append(word)
            report = run(args.program, command, volume, picture, *joined, "--overwrite")
            cells.append(f"{report['cpu']:.1f} s, {report['peak_rss_bytes'] / 2**20:.0f} MiB")
        print(f"| {name} | {' x '.join(map(str, size))} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()

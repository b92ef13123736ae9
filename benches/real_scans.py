#!/usr/bin/env python3
"""Imports and meshes the real scans of the data folder, checks every mesh, prints a Markdown table.

usage: benches/real_scans.py [--data FOLDER] [--mem 64MiB] [--checker PLY_CHECK.py]

Needs a release build. FOLDER holds `volumes/` (default: $BRICKMARCH_DATA or ../shared/data). With
--checker every mesh is also judged by that program, run by /usr/bin/python3 (numpy and scipy), and
its answer must agree with `brickmarch check`. Times are one run each, wall clock of the command.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = ROOT / "target/release/brickmarch"

# file, options of import, options of mesh
SCANS = [
    ("ct_abdomen_512x512x275_u8.nrrd", [], ["--iso", "31.5"]),
    ("bentheimer_500_binary.nrrd", [], ["--iso", "0.5"]),
    ("em_labels_512_u32.nrrd", ["--kind", "label"], ["--label", "28336523"]),
    ("ch2.nii.gz", [], ["--iso", "49.5"]),
    ("aal.nii.gz", ["--kind", "label"], ["--label", "37"]),
    ("embryo_256.mha", [], ["--iso", "65"]),
    ("frogtissue.mhd", ["--kind", "label"], ["--label", "1"]),
    ("HeadMRVolume.mhd", [], ["--iso", "48"]),
    ("tooth.nhdr", [], ["--iso", "600"]),
    ("example4d.nii.gz", ["--volume", "0"], ["--iso", "252"]),
    ("someones_anatomy.nii.gz", [], ["--iso", "42.7"]),
    ("ct_abdomen_crop128_i16.nrrd", [], ["--iso", "200"]),
    ("stent_128x128x256_u8.nrrd", [], ["--iso", "6.5"]),
]


def run(*words, codes=(0,)):
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
    if done.returncode not in codes:
        sys.exit(f"{' '.join(map(str, words))}\nexit {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default=os.environ.get("BRICKMARCH_DATA", ROOT / "../shared/data"))
    parser.add_argument("--mem", default="64MiB")
    parser.add_argument("--checker")
    parser.add_argument("--json", action="store_true", help="one JSON object a scan instead of the table")
    args = parser.parse_args()
    common = ["--mem", args.mem, "--progress", "none", "--json", "--overwrite"]
    if not args.json:
        print("| scan | samples | type | import s, MiB | file MiB | mesh s, MiB | triangles | components | genus | volume |")
        print("|---|---|---|---|---|---|---|---|---|---|")
    for name, how_import, how_mesh in SCANS:
        with tempfile.TemporaryDirectory() as folder:
            volume, mesh = f"{folder}/scan.bvol", f"{folder}/scan.ply"
            stored = run(PROGRAM, "import", pathlib.Path(args.data) / "volumes" / name, volume, *how_import, *common)
            meshed = run(PROGRAM, "mesh", volume, mesh, *how_mesh, *common)
            ours = run(PROGRAM, "check", mesh, "--mem", "4GiB", "--json", "--progress", "none")["report"]
            assert ours["closed"] and ours["manifold"] and ours["oriented"], (name, ours)
            assert ours["degenerate_triangles"] == 0 and ours["volume"] > 0, (name, ours)
            if args.checker:
                theirs = run("/usr/bin/python3", args.checker, mesh, "--json")
                assert theirs["closed"] and theirs["manifold"] and theirs["oriented"] and not theirs["degenerate"], (name, theirs)
                for ours_name, theirs_name in [("components",) * 2, ("euler",) * 2, ("triangles",) * 2, ("vertices",) * 2]:
                    assert ours[ours_name] == theirs[theirs_name], (name, ours_name)
                assert abs(theirs["volume"] / ours["volume"] - 1) < 1e-6, (name, theirs)
            info = run(PROGRAM, "info", volume, "--json")
            if args.json:
                print(json.dumps({"scan": name, "import": stored, "mesh": meshed, "check": ours, "info": info}))
                continue
            mib = 1 << 20
            print(
                f"| {name} | {describe(info)} | {stored['seconds']:.2f}, {stored['peak_rss_bytes'] / mib:.0f} "
                f"| {os.path.getsize(volume) / mib:.1f} | {meshed['seconds']:.2f}, {meshed['peak_rss_bytes'] / mib:.0f} "
                f"| {meshed['triangles']:,} | {ours['components']:,} | {ours['genus']:,} | {ours['volume']:.6g} |",
                flush=True,
            )


def describe(info):
    return " x ".join(map(str, info["volume"]["size"])) + " | " + info["volume"]["sample"]


if __name__ == "__main__":
    main()

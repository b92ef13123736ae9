#!/usr/bin/env python3
"""Stores, meshes and checks the scenes whose answers are known, and prints a Markdown table.

usage: benches/known_answers.py [--sizes 256,512,1024] [--mem 64MiB] [--folder FOLDER]

Needs release builds of brickmarch and brickmarch-data-gen. The answers (crossed lattice edges,
Euler characteristic, components by counting on the lattice; area and volume by formula or
quadrature) come from data-gen, which does not use the engine. Counts must agree exactly.
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

BIN = pathlib.Path(__file__).resolve().parent.parent / "target/release"


def run(program, *words):
    done = subprocess.run([str(BIN / program), *map(str, words)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{program} {' '.join(map(str, words))}\nexit {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="256,512,1024")
    parser.add_argument("--mem", default="64MiB")
    parser.add_argument("--folder")
    args = parser.parse_args()
    quiet = ["--progress", "none", "--json"]
    print("| scene | N | vertices = crossed edges | triangles | genus | area error | volume error | mesh s, MiB |")
    print("|---|---|---|---|---|---|---|---|")
    for scene in ["sphere", "torus", "gyroid"]:
        for n in map(int, args.sizes.split(",")):
            with tempfile.TemporaryDirectory(dir=args.folder) as folder:
                volume, mesh = f"{folder}/scene.bvol", f"{folder}/scene.ply"
                run("brickmarch-data-gen", "field", scene, "--n", n, "--out", volume, "--mem", args.mem)
                truth = json.loads(run("brickmarch-data-gen", "exact", scene, "--n", n, "--json"))
                made = json.loads(run("brickmarch", "mesh", volume, mesh, "--iso", "0", "--mem", args.mem, *quiet))
                found = json.loads(run("brickmarch", "check", mesh, "--mem", "8GiB", *quiet))["report"]
            capped, exact = truth["lattice"]["capped"], truth["exact"]
            assert truth["lattice"]["unambiguous"], "no face of these scenes is ambiguous"
            assert found["vertices"] == capped["crossed_edges"], (found, capped)
            assert found["triangles"] == capped["triangles"] and found["euler"] == capped["mesh_euler"], (found, capped)
            assert found["closed"] and found["manifold"] and found["oriented"], found
            assert found["genus"] == capped["genus"], (found, capped)
            area = found["area"] / (exact["area"] + (exact.get("cap_area") or 0)) - 1
            size = found["volume"] / exact["volume"] - 1
            print(
                f"| {scene} | {n} | {found['vertices']:,} | {found['triangles']:,} | {found['genus']:,} | {area:+.2e} "
                f"| {size:+.2e} | {made['seconds']:.2f}, {made['peak_rss_bytes'] / (1 << 20):.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

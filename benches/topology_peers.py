#!/usr/bin/env python3
"""Random grids, meshed by brickmarch and by other programs, all judged by one that knows the exact topology.

usage: benches/topology_peers.py VERIFIER [--share 1.0] [--seed 1]

Prints a Markdown table: per kind of grid how many meshes of each program have the wrong topology, are not
watertight after welding equal positions, and have triangles that cross. VERIFIER is the program `topoverify`;
tests/topology/batches builds it at target/topoverify/target/release/topoverify. Needs a release build of the
example topology_batch, and NumPy; takes those of scikit-image, VTK and PyMCubes that it can import.
"""
import argparse
import pathlib
import re
import struct
import subprocess
import sys
import tempfile

import numpy as np

BATCH = pathlib.Path(__file__).resolve().parent.parent / "target/release/examples/topology_batch"
KINDS = {  # kind of grid, number, whether the topology is judged (elsewhere saddles lie at the isovalue)
    "cell": (100_000, True),
    "r5": (10_000, True),
    "k5": (3_000, True),
    "r9": (200, True),
    "s33": (60, True),
    "r33": (20, True),
    "u17": (100, False),
    "i9": (300, False),
}


def read(path):
    data = pathlib.Path(path).read_bytes()
    (count,), at = struct.unpack_from("<i", data), 4
    for _ in range(count):
        nx, ny, nz, iso = struct.unpack_from("<3if", data, at)
        at += 16
        values = np.frombuffer(data, "<f4", nx * ny * nz, at).reshape(nz, ny, nx).copy()
        at += 4 * values.size
        yield values, iso


def skimage():
    from skimage import __version__
    from skimage.measure import marching_cubes

    def mesh(values, iso):
        try:
            points, triangles, _, _ = marching_cubes(values, iso)
        except (ValueError, RuntimeError) as error:  # that is how it says that there is no surface
            assert "range" in str(error) or "No surface" in str(error), error
            return None
        return points[:, ::-1], triangles

    return f"scikit-image {__version__}", mesh


def vtk():
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    def mesh(values, iso):
        image = vtk.vtkImageData()
        image.SetDimensions(*values.shape[::-1])
        scalars = numpy_to_vtk(np.ascontiguousarray(values).ravel())
        image.GetPointData().SetScalars(scalars)
        edges = vtk.vtkFlyingEdges3D()
        edges.SetInputData(image)
        edges.SetValue(0, iso)
        edges.ComputeNormalsOff()
        edges.Update()
        out = edges.GetOutput()
        if out.GetNumberOfPoints() == 0:
            return None
        triangles = vtk_to_numpy(out.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        return vtk_to_numpy(out.GetPoints().GetData()), triangles

    return f"VTK {vtk.vtkVersion.GetVTKVersion()} Flying Edges", mesh


def pymcubes():
    import mcubes

    def mesh(values, iso):
        points, triangles = mcubes.marching_cubes(values.astype(np.float64), iso)
        return points[:, ::-1], triangles

    return "PyMCubes", mesh


def write(path, meshes):
    with open(path, "wb") as out:
        for mesh in meshes:
            points, triangles = mesh or (np.zeros((0, 3)), np.zeros((0, 3)))
            out.write(struct.pack("<2i", len(points), len(triangles)))
            out.write(np.ascontiguousarray(points, "<f8").tobytes())
            out.write(np.ascontiguousarray(triangles, "<i4").tobytes())


def run(*words):
    return subprocess.run([str(w) for w in words], check=True, capture_output=True, text=True).stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("verifier")
    parser.add_argument("--share", type=float, default=1.0, help="of the numbers of grids")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    programs = [("brickmarch", None)]
    for peer in (skimage, vtk, pymcubes):
        try:
            programs.append(peer())
        except ImportError as missing:
            print(f"SKIPPED: {missing}", file=sys.stderr)
    rows = {name: [] for name, _ in programs}
    head = []
    with tempfile.TemporaryDirectory() as folder:
        grids, meshes = f"{folder}/grids", f"{folder}/meshes"
        for kind, (count, judged) in KINDS.items():
            count = max(1, round(count * args.share))
            run(BATCH, "grids", kind, count, args.seed, grids)
            head.append(f"{kind} x {count:,}")
            for name, mesh in programs:
                if mesh is None:
                    run(BATCH, "mesh", grids, meshes)
                else:
                    write(meshes, (mesh(values, iso) for values, iso in read(grids)))
                said = run(args.verifier, "check", grids, meshes)
                torn, wrong = re.search(r"not-watertight (\d+) wrong-topology (\d+)", said).groups()
                assert " missing 0 " in said, said
                cross = re.search(r"with crossings (\d+)", run(args.verifier, "selfint", grids, meshes)).group(1)
                rows[name].append(f"{wrong if judged else '-'}, {torn}, {cross}")
    print(f"| wrong, torn, crossing | {' | '.join(head)} |")
    print("|---" * (len(head) + 1) + "|")
    for name, cells in rows.items():
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()

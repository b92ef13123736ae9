#!/usr/bin/env python3
"""Dense fields beside stores of chunked arrays and VTK: write, read, boxes of 64^3, volume to PLY. Prints Markdown tables.

usage: PYTHON benches/dense.py --data FOLDER [--fields sphere,ct,sandstone] [--n 1024] [--runs 3] [--folder FOLDER]

PYTHON has numpy, zarr, zarrs, tensorstore, blosc2, h5py, hdf5plugin and vtk; FOLDER of --data has bentheimer_500_binary.nrrd. All
run in turn with two threads, files in the page cache. Of the others only the call that stores or gives samples is
timed, slab by slab of 64 planes from and to memory: neither Python's start nor the reading of the source. Of brickmarch
it is the whole process of `import` and `mesh`, and in the library (`cargo bench -- dense`, `-- region`) the same slabs
and boxes. Chunks are 64^3, LZ4 with shuffled bytes, blosc2 with blocks of 16^3. Medians. What is read is compared
with the source before a time is printed. The record goes to benches/record. Nothing else should run meanwhile.
"""
import argparse
import datetime
import json
import os
import pathlib
import re
import resource
import shutil
import statistics
import subprocess
import sys
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from peers import RELEASE, ROOT, warm  # noqa: E402

TOOLS = ["zarr", "zarrs", "tensorstore", "blosc2", "hdf5"]
BOXES = 200
C = 64


class Zarr:
    def __init__(self, rust):
        import zarr
        zarr.config.set({"async.concurrency": 8, "threading.max_workers": 2})
        if rust:
            import zarrs  # noqa: F401, registers the pipeline
            zarr.config.set({"codec_pipeline.path": "zarrs.ZarrsCodecPipeline"})
        self.zarr = zarr

    def create(self, path, shape, dtype):
        codec = self.zarr.codecs.BloscCodec(cname="lz4", clevel=5, shuffle="shuffle")
        return self.zarr.create_array(path, shape=shape, chunks=(C,) * 3, dtype=dtype, compressors=codec, overwrite=True)

    def open(self, path):
        return self.zarr.open_array(path, mode="r")


class TensorStore:
    def __init__(self):
        import tensorstore
        self.ts = tensorstore

    def context(self):
        limits = {"data_copy_concurrency": {"limit": 2}, "file_io_concurrency": {"limit": 4}, "cache_pool": {"total_bytes_limit": 0}}
        return self.ts.Context(limits)

    def create(self, path, shape, dtype):
        spec = self.spec(path)
        spec["metadata"] = {
            "shape": list(shape), "chunks": [C] * 3, "dtype": np.dtype(dtype).str, "dimension_separator": "/",
            "compressor": {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 1},
        }
        store = self.ts.open(spec, create=True, delete_existing=True, context=self.context()).result()
        return Waits(store)

    def open(self, path):
        return Waits(self.ts.open(self.spec(path), open=True, read=True, context=self.context()).result())

    def spec(self, path):
        return {"driver": "zarr", "kvstore": {"driver": "file", "path": str(path)}}


class Waits:
    def __init__(self, store):
        self.store = store

    def __setitem__(self, where, values):
        self.store[where].write(values).result()

    def __getitem__(self, where):
        return self.store[where].read().result()


class Blosc2:
    def __init__(self):
        import blosc2
        blosc2.set_nthreads(2)
        self.blosc2 = blosc2

    def create(self, path, shape, dtype):
        b = self.blosc2
        params = {"codec": b.Codec.LZ4, "clevel": 5, "filters": [b.Filter.SHUFFLE], "nthreads": 2}
        return b.empty(
            shape=shape, dtype=dtype, chunks=(C,) * 3, blocks=(16,) * 3, urlpath=str(path), mode="w", cparams=params)

    def open(self, path):
        return self.blosc2.open(str(path), mode="r", dparams={"nthreads": 2})


class Hdf5:
    def __init__(self):
        import h5py
        import hdf5plugin
        self.h5py, self.plugin = h5py, hdf5plugin

    def create(self, path, shape, dtype):
        codec = self.plugin.Blosc(cname="lz4", clevel=5, shuffle=1)
        self.file = self.h5py.File(path, "w")
        return self.file.create_dataset("d", shape, dtype, chunks=(C,) * 3, **codec)

    def open(self, path):
        return self.h5py.File(path, "r", rdcc_nbytes=1 << 26)["d"]


def library(tool):
    return {"zarr": lambda: Zarr(False), "zarrs": lambda: Zarr(True), "tensorstore": TensorStore, "blosc2": Blosc2,
            "hdf5": Hdf5}[tool]()


def used():
    """User and system seconds of this process."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_utime + own.ru_stime


def peak_mib():
    for line in open("/proc/self/status"):
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024


def size_of(path):
    path = pathlib.Path(path)
    return path.stat().st_size if path.is_file() else sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


def one(tool, operation, raw, shape, dtype, path):
    """Runs in a process of its own: one operation of one tool, a JSON line of what it took."""
    lib = library(tool)
    shape = tuple(shape)
    source = np.memmap(raw, dtype=dtype, mode="r", shape=shape)
    wall = cpu = 0.0
    said = {}
    if operation == "write":
        store = lib.create(path, shape, dtype)
        for z in range(0, shape[0], C):
            slab = np.array(source[z:z + C])
            start, before = time.perf_counter(), used()
            store[z:z + len(slab)] = slab
            wall, cpu = wall + time.perf_counter() - start, cpu + used() - before
        if tool == "hdf5":
            start = time.perf_counter()
            lib.file.close()
            wall += time.perf_counter() - start
        said["bytes"] = size_of(path)
    elif operation == "read":
        store = lib.open(path)
        for z in range(0, shape[0], C):
            start, before = time.perf_counter(), used()
            slab = np.asarray(store[z:min(z + C, shape[0])])
            wall, cpu = wall + time.perf_counter() - start, cpu + used() - before
            assert np.array_equal(slab, source[z:z + C]), f"{tool} gives other samples at plane {z}"
    else:
        corners = np.random.default_rng(7).integers(0, np.array(shape) - C, (BOXES, 3))
        boxes = [tuple(slice(int(k), int(k) + C) for k in corner) for corner in corners]
        store = lib.open(path)
        for box in boxes:
            assert np.array_equal(np.asarray(store[box]), source[box]), f"{tool} gives other samples in {box}"
        times = {"kept": [], "fresh": []}
        for box in boxes:
            start = time.perf_counter()
            np.asarray(store[box])
            times["kept"].append(time.perf_counter() - start)
        for box in boxes:
            start = time.perf_counter()
            np.asarray(lib.open(path)[box])
            times["fresh"].append(time.perf_counter() - start)
        said = {way: {"median_ms": statistics.median(t) * 1e3, "p99_ms": sorted(t)[int(0.99 * len(t))] * 1e3}
                for way, t in times.items()}
    print(json.dumps({**said, "wall": wall, "cpu": cpu, "mib": peak_mib()}))


def vtk_mesh(raw, shape, dtype, iso, out):
    """Runs in a process of its own: what a script does today, raw file to binary PLY."""
    import vtk
    from vtk.util import numpy_support
    vtk.vtkSMPTools.SetBackend("STDThread")
    vtk.vtkSMPTools.Initialize(2)
    values = np.fromfile(raw, dtype=dtype)
    image = vtk.vtkImageData()
    image.SetDimensions(shape[2], shape[1], shape[0])
    image.GetPointData().SetScalars(numpy_support.numpy_to_vtk(values, deep=False))
    edges = vtk.vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, iso)
    for what in ["Normals", "Gradients", "Scalars"]:
        getattr(edges, f"SetCompute{what}")(0)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_utime, time.perf_counter()
    edges.Update()
    extraction = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_utime - before
    writer = vtk.vtkPLYWriter()
    writer.SetInputData(edges.GetOutput())
    writer.SetFileName(str(out))
    writer.SetFileTypeToBinary()
    writer.Write()
    print(json.dumps({"triangles": edges.GetOutput().GetNumberOfPolys(), "extraction": extraction, "mib": peak_mib()}))


def process(words, env=None):
    """Wall and CPU seconds and peak MiB of a process, and what it said."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run([str(w) for w in words], stdout=subprocess.PIPE, text=True, env={**os.environ, **(env or {})})
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, words))}: status {done.returncode}")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def itself(*words):
    wall, cpu, said = process([sys.executable, __file__, *words])
    return {**json.loads(said.splitlines()[-1]), "process_wall": wall, "process_cpu": cpu}


def source_of(field, args):
    """Raw file, shape (z, y, x), type, isovalue."""
    raw = args.folder / f"{field}.raw"
    if field == "sandstone":
        shape, dtype, iso = (500, 500, 500), "u1", 0.5
        if not raw.exists():
            import gzip
            head, body = (args.data / "bentheimer_500_binary.nrrd").read_bytes().split(b"\n\n", 1)
            assert b"gzip" in head
            raw.write_bytes(gzip.decompress(body))
        assert raw.stat().st_size == 500**3
        return raw, shape, dtype, iso
    shape = (args.n,) * 3
    dtype, iso = ("<f4", 0.0) if field == "sphere" else ("<i2", args.ct_iso)
    if not raw.exists():
        words = [RELEASE / "brickmarch-data-gen", "field", field, "--n", args.n, "--out", raw]
        process(words + (["--type", "i16"] if dtype == "<i2" else []))
    return raw, shape, dtype, iso


def median(runs, key):
    return statistics.median(run[key] for run in runs)


def ours(raw, shape, dtype, path):
    name = {"<f4": "f32", "<i2": "i16", "u1": "u8"}[dtype]
    dims = ",".join(str(n) for n in reversed(shape))
    wall, cpu, said = process([
        RELEASE / "brickmarch", "import", raw, path, "--dims", dims, "--type", name, "--mem", "64MiB", "--threads", 2,
        "--overwrite", "--json", "-q"])
    return {"wall": wall, "cpu": cpu, "mib": json.loads(said)["peak_rss_bytes"] / 2**20, "bytes": size_of(path)}


def bench(name, env):
    words = ["cargo", "bench", "-q", "-p", "brickmarch-benches", "--", name]
    return process(words, env)[2]


def stores(field, args, record):
    raw, shape, dtype, _ = source_of(field, args)
    warm(raw)
    samples = int(np.prod(shape)) * np.dtype(dtype).itemsize
    bvol = args.folder / f"{field}.bvol"
    paths = {tool: args.folder / f"{field}.{tool}" for tool in TOOLS}
    writes, reads, boxes = ({tool: [] for tool in ["brickmarch", *TOOLS]} for _ in range(3))
    for _ in range(args.runs):
        writes["brickmarch"].append(ours(raw, shape, dtype, bvol))
        said = bench("dense", {"BRICKMARCH_DENSE": f"{bvol}={raw}"})
        reads["brickmarch"].append(json.loads(said.splitlines()[-1]))
        for tool in TOOLS:
            words = [str(raw), json.dumps(shape), dtype, str(paths[tool])]
            writes[tool].append(itself("--one", tool, "write", *words))
            reads[tool].append(itself("--one", tool, "read", *words))
            boxes[tool].append(itself("--one", tool, "boxes", *words))
            if paths[tool].is_dir():
                shutil.rmtree(paths[tool])
            else:
                paths[tool].unlink()
    said = bench("region", {"BRICKMARCH_REGION": str(bvol)})
    us = re.search(r"fresh open (\d+) \((\d+)\), kept open (\d+) \((\d+)\), in the cache (\d+) \((\d+)\)", said)
    fresh, fresh99, kept, kept99, cached, _ = (int(v) / 1e3 for v in us.groups())
    print(f"\n{field}, {' x '.join(map(str, reversed(shape)))} {dtype}, {samples / 1e6:.0f} MB\n")
    print("| store | write MB/s | CPU s | read MB/s | CPU s | 64^3: opened anew ms (99th) | kept open ms (99th) | ratio | write, read peak MiB |")
    print("|---|---|---|---|---|---|---|---|---|")
    for tool in ["brickmarch", *TOOLS]:
        w, r = median(writes[tool], "wall"), median(reads[tool], "wall")
        if tool == "brickmarch":
            ways = f"{fresh:.2f} ({fresh99:.2f}) | {kept:.2f} ({kept99:.2f}), in the cache {cached:.2f}"
        else:
            cells = [[statistics.median(b[way][k] for b in boxes[tool]) for k in ["median_ms", "p99_ms"]]
                     for way in ["fresh", "kept"]]
            ways = " | ".join("{:.2f} ({:.2f})".format(*cell) for cell in cells)
        print(
            f"| {tool} | {samples / w / 1e6:.0f} | {median(writes[tool], 'cpu'):.1f} | {samples / r / 1e6:.0f} "
            f"| {median(reads[tool], 'cpu'):.1f} | {ways} | {samples / writes[tool][0]['bytes']:.2f} "
            f"| {median(writes[tool], 'mib'):.0f}, {median(reads[tool], 'mib'):.0f} |")
    record[field] = {"writes": writes, "reads": reads, "boxes": boxes, "region": said.strip()}


def meshes(field, args, record):
    raw, shape, dtype, iso = source_of(field, args)
    bvol, out = args.folder / f"{field}.bvol", args.folder / "dense.ply"
    runs = {"brickmarch": [], "VTK": []}
    for _ in range(args.runs):
        wall, cpu, said = process([
            RELEASE / "brickmarch", "mesh", bvol, out, "--iso", iso, "--boundary", "cut", "--mem", "64MiB",
            "--threads", 2, "--overwrite", "--json", "-q"])
        made = json.loads(said)
        runs["brickmarch"].append(
            {"wall": wall, "cpu": cpu, "triangles": made["triangles"], "mib": made["peak_rss_bytes"] / 2**20})
        out.unlink()
        it = itself("--vtk", str(raw), json.dumps(shape), dtype, str(iso), str(out))
        runs["VTK"].append({**it, "wall": it["process_wall"], "cpu": it["process_cpu"]})
        out.unlink()
    a, b = (runs[k][0]["triangles"] for k in runs)
    assert abs(a / b - 1) < 0.02, f"{field}: {a} and {b} triangles"
    for name, some in runs.items():
        print(f"| {field} | {name} | {median(some, 'wall'):.2f} | {median(some, 'cpu'):.2f} | {median(some, 'mib'):.0f} "
              f"| {some[0]['triangles']:,} |")
    record[field]["meshes"] = runs


def main():
    if sys.argv[1:2] == ["--one"]:
        tool, operation, raw, shape, dtype, path = sys.argv[2:]
        return one(tool, operation, raw, json.loads(shape), dtype, path)
    if sys.argv[1:2] == ["--vtk"]:
        raw, shape, dtype, iso, out = sys.argv[2:]
        return vtk_mesh(raw, json.loads(shape), dtype, float(iso), out)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", required=True, type=pathlib.Path)
    parser.add_argument("--fields", default="sphere,ct,sandstone")
    parser.add_argument("--n", type=int, default=1024)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--ct-iso", type=float, default=200.0)
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path("/dev/shm"))
    args = parser.parse_args()
    date = datetime.date.today().isoformat()
    record = {"date": date, "cores": os.cpu_count(), "n": args.n, "runs": args.runs}
    fields = args.fields.split(",")
    for field in fields:
        stores(field, args, record)
    print("\n| field | raw or volume file to binary PLY | wall s | CPU s | peak MiB | triangles |\n|---|---|---|---|---|---|")
    for field in fields:
        meshes(field, args, record)
    path = ROOT / f"benches/record/{date}-dense-{args.n}.json"
    path.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Small good inputs for every fuzz target, made from the golden files and by hand.

usage: seeds.py FOLDER      writes FOLDER/<target>/*
"""
import gzip
import pathlib
import struct
import sys

HERE = pathlib.Path(__file__).resolve().parent
CODES = dict(bit=0, u8=1, i8=2, u16=3, i16=4, u32=5, i32=6, f32=7)


def records(data):
    at = 12288
    while at + 40 <= len(data):
        if data[at : at + 4] != b"SVrc":
            at = (at // 4096 + 1) * 4096
            continue
        length = struct.unpack_from("<I", data, at + 8)[0]
        yield data[at + 4], data[at + 5], data[at + 34], data[at + 40 : at + 40 + length]
        at += (40 + length + 7) // 8 * 8


def nifti(version):
    if version == 1:
        head = bytearray(352)
        struct.pack_into("<i", head, 0, 348)
        struct.pack_into("<8h", head, 40, 3, 3, 2, 2, 1, 1, 1, 1)
        struct.pack_into("<2h", head, 70, 4, 16)
        struct.pack_into("<8f", head, 76, 1, 1, 2, 3, 0, 0, 0, 0)
        struct.pack_into("<3f", head, 108, 352, 1, 0)
        head[344:348] = b"n+1\0"
    else:
        head = bytearray(544)
        struct.pack_into("<i8s2h", head, 0, 540, b"n+2\0\r\n\x1a\n", 4, 16)
        struct.pack_into("<8q", head, 16, 3, 3, 2, 2, 1, 1, 1, 1)
        struct.pack_into("<8d", head, 104, 1, 1, 2, 3, 0, 0, 0, 0)
        struct.pack_into("<q2d", head, 168, 544, 1, 0)
    return bytes(head) + struct.pack("<12h", *range(12))


def ply(binary):
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    head = (
        f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\nelement face 4\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    if binary:
        body = b"".join(struct.pack("<3f", *c) for c in corners)
        return head + body + b"".join(struct.pack("<B3i", 3, *f) for f in faces)
    lines = [" ".join(map(str, c)) for c in corners] + ["3 " + " ".join(map(str, f)) for f in faces]
    return head + "\n".join(lines).encode() + b"\n"


def stl():
    triangle = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    return bytes(80) + struct.pack("<I", 2) + triangle * 2


def main():
    out = pathlib.Path(sys.argv[1])
    seeds = {}

    def add(target, data):
        seeds.setdefault(target, []).append(data)

    for path in sorted((HERE / "../golden").glob("*.bvol")):
        data = path.read_bytes()
        # Without the two superblocks a reader walks the log.
        add("open_bytes", data)
        add("open_bytes", data[:4096] + bytes(8192) + data[12288:])
        add("open_and_read_all", data)
        code = CODES.get(path.name.split("_")[1], 1)
        for kind, codec, level, payload in records(data):
            if kind == 2:
                add("brick", bytes([code, codec]) + payload)
            elif kind == 3:
                add("page", bytes([code, level - 1, 0, 1]) + payload)
            elif kind in (4, 5, 7):
                add("catalog", payload)
    add("raw", bytes([1, 0, 0, 0]) + struct.pack("<3I3f2I", 2, 2, 2, 1, 1, 1, 0, 0) + bytes(range(8)))
    for major in (1, 2, 3):
        text = b"{'descr': '<i2', 'fortran_order': False, 'shape': (2, 2, 3), }"
        size = "<H" if major == 1 else "<I"
        text = text.ljust((64 - 8 - struct.calcsize(size)) % 64 + 64, b" ")[:-1] + b"\n"
        add("npy", b"\x93NUMPY" + bytes([major, 0]) + struct.pack(size, len(text)) + text + bytes(range(24)))
    nrrd = (
        b"NRRD0005\n# c\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 3 2 2\n"
        b"space directions: (1,0,0) (0,1,0) (0,0,2)\nkinds: domain domain domain\nendian: little\n"
        b"encoding: %s\nspace origin: (0,0,0)\nkey:=value\n\n%s"
    )
    samples = struct.pack("<12h", *range(12))
    add("nrrd", nrrd % (b"raw", samples))
    add("nrrd", nrrd % (b"gzip", gzip.compress(samples, mtime=0)))
    add("nrrd", nrrd % (b"ascii", b" ".join(b"%d" % n for n in range(12))))
    for version in (1, 2):
        add("nifti", nifti(version))
        add("nifti", gzip.compress(nifti(version), mtime=0))
    meta = (
        b"ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
        b"CompressedData = %s\nTransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\n"
        b"ElementSpacing = 1 1 2\nDimSize = 3 2 2\nElementType = MET_SHORT\nElementDataFile = LOCAL\n%s"
    )
    import zlib

    add("metaimage", meta % (b"False", samples))
    add("metaimage", meta % (b"True", zlib.compress(samples)))
    for binary in (False, True):
        add("ply", ply(binary))
    add("stl", stl())
    add(
        "stl",
        b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        b"endloop\nendfacet\nendsolid s\n",
    )
    add("obj", b"# c\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvn 0 0 1\nvt 0 0\no a\nf 1 2 3\nf 1//1 3//1 4//1 2//1\n")
    add("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n")
    # Eight bytes are one operation, see tests/store/operations.rs; the first are the volume.
    volume = lambda sample, kind=0: [0, sample, 60, 15, 9, 100, 0, kind]
    bricks = [op for x in range(8) for op in ([17 * (x % 4), x, x % 2, 0, 0, 9 + x, x, 3],)]
    constant, commit, reopen, drop = [38, 0, 0, 0, 0, 7, 7, 7], [9] + [0] * 7, [10] + [0] * 7, [11] + [0] * 7
    more, levels, compact = [12, 7, 20, 20, 20, 3, 1, 1], [13, 2] + [0] * 6, [14] + [0] * 7
    keep, refresh, older, torn = ([15 + 128, n, 1, 99, 0, 0, 0, 0] for n in range(4))
    second = [0, 1, 1, 1, 1, 5, 5, 5]
    for sample in range(8):
        script = [volume(sample, sample % 2), *bricks, commit, keep, constant, levels, reopen, bricks[2], refresh]
        script += [more, second, commit, older, drop, bricks[5], torn, constant, commit, compact, bricks[1], refresh]
        add("operations", bytes(b for op in script for b in op))
    for target, inputs in seeds.items():
        folder = out / target
        folder.mkdir(parents=True, exist_ok=True)
        for n, data in enumerate(inputs):
            (folder / f"seed-{n:03}").write_bytes(data)


main()

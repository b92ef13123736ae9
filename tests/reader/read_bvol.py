#!/usr/bin/env python3
"""Reads a volume file (.bvol, format 1) from its document alone: docs/format.md. Slow and plain.

usage: read_bvol.py FILE [RAW [VOLUME [LEVEL]]]

Describes a volume as JSON, the first one or the one of this name, or a level of detail of it. Writes
its samples to RAW (native, little-endian, i fastest, one byte per bit).

Needs Python 3.8 and NumPy. Shares no code with the engine, so that the two check each other and the
document.
"""
import json
import struct
import sys

import numpy as np

MAGIC = bytes.fromhex("8953564f4c0d0a1a")
HEADER, BRICK, PAGE, CATALOG, ATTRIBUTES, FOOTER, HISTORY = range(1, 8)
TYPES = ["bit", "u8", "i8", "u16", "i16", "u32", "i32", "f32"]
NUMPY = dict(bit="u1", u8="u1", i8="i1", u16="<u2", i16="<i2", u32="<u4", i32="<i4", f32="<f4")
KINDS = ["density", "distance", "mask", "label", "color"]
UNITS = ["none", "mm", "um", "m", "nm"]


class Damaged(Exception):
    pass


def need(condition, what):
    if not condition:
        raise Damaged(what)


def _table():
    for n in range(256):
        for _ in range(8):
            n = n >> 1 ^ (0x82F63B78 if n & 1 else 0)
        yield n


CRC_TABLE = list(_table())


def crc32c(data, running=0):
    """CRC32C of data, going on from a running value (section 2)."""
    crc = running ^ 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def lz4_block(data, length):
    """One LZ4 block that must decode to exactly `length` bytes."""
    out, at = bytearray(), 0

    def more(n):
        nonlocal at
        if n == 15:
            while True:
                byte = data[at]
                at += 1
                n += byte
                need(n <= length, "LZ4 length")
                if byte != 255:
                    break
        return n

    try:
        while True:
            token = data[at]
            at += 1
            literals = more(token >> 4)
            need(at + literals <= len(data), "LZ4 literals")
            out += data[at : at + literals]
            at += literals
            if at == len(data):
                break
            back = data[at] | data[at + 1] << 8
            at += 2
            need(0 < back <= len(out), "LZ4 offset")
            match = more(token & 15) + 4
            need(len(out) + match <= length, "LZ4 match")
            for _ in range(match):
                out.append(out[-back])
    except IndexError:
        raise Damaged("LZ4 block is cut off") from None
    need(len(out) == length, "LZ4 block of another length")
    return bytes(out)


def morton(p):
    return sum((p[a] >> b & 1) << 3 * b + a for b in range(21) for a in range(3))


def unmorton(code):
    return [sum((code >> 3 * b + a & 1) << b for b in range(21)) for a in range(3)]


class Rows:
    """A brick of codec 6. Takes (s, k, j) as in the document: stripe, slice, row."""

    def __init__(self, stored, edge):
        need(len(stored) >= 16, "codec 6: start")
        self.clip = np.frombuffer(stored[:8], "<f4")
        masks, widths = struct.unpack_from("<2I", stored, 8)
        need(16 + masks + widths <= len(stored), "codec 6: lengths")
        self.masks, rest = stored[16 : 16 + masks], stored[16 + masks :]
        self.widths, self.words = rest[:widths], rest[widths:]
        self.edge, self.lanes = edge, min(edge, 16)
        groups = edge * edge * edge // self.lanes
        need(masks == 0 or masks >= groups // 4, "codec 6: codes")
        self.codes, self.more = self.masks[: groups // 4], self.masks[groups // 4 :]
        self.group = 0

    def take(self, name, n):
        data = getattr(self, name)
        need(len(data) >= n, f"codec 6: {name}")
        setattr(self, name, data[n:])
        return data[:n]

    def states(self, above, behind):
        """Per sample of the next group: 0 and 1 the clip values, 2 active."""
        if not self.masks:
            return np.full(self.lanes, 2)
        code = self.codes[self.group // 4] >> self.group % 4 * 2 & 3
        self.group += 1
        if code < 2:
            return behind if code else above
        lane = np.arange(self.lanes)
        if code == 2:
            (word,) = struct.unpack("<H", self.take("more", 2))
            first, end = word & 31, word >> 5 & 31
            need(first <= end <= self.lanes and word < 4096, "codec 6: interval")
            sides = np.where(lane < first, word >> 10 & 1, word >> 11 & 1)
            return np.where((lane >= first) & (lane < end), 2, sides)
        active, high = struct.unpack("<2H", self.take("more", 4))
        need(active & high == 0 and (active | high) >> self.lanes == 0, "codec 6: masks")
        return np.where(active >> lane & 1, 2, high >> lane & 1)

    def residuals(self, lanes, out):
        if not lanes.any():
            return
        width, count = self.take("widths", 1)[0], int(lanes.sum())
        need(width <= 26 or width in (28, 32), "codec 6: width")
        bits = int.from_bytes(self.take("words", (count * width + 7) // 8), "little")
        out[lanes] = [bits >> n * width & (1 << width) - 1 for n in range(count)]

    def brick(self):
        out = np.empty((self.edge,) * 3, np.float32)
        with np.errstate(all="ignore"):
            for i in range(0, self.edge, self.lanes):
                self.stripe(out[:, :, i : i + self.lanes])
        need(not self.more and not self.widths and not self.words, "codec 6: bytes are left over")
        return out

    def stripe(self, out):
        # Three rows and slices before the brick: not active, low.
        state = np.zeros((self.edge + 3, self.edge + 3, self.lanes), int)
        known = np.full(state.shape, np.nan, np.float32)
        for k in range(self.edge):
            for j in range(self.edge):
                s = lambda dj, dk: state[k + 3 - dk, j + 3 - dj]
                f = lambda dj, dk: known[k + 3 - dk, j + 3 - dj]
                here = self.states(s(1, 0), s(0, 1))
                state[k + 3, j + 3] = here
                active = here == 2
                out[k, j] = self.clip[np.minimum(here, 1)]
                if not active.any():
                    continue
                has = lambda *places: np.all([s(*p) == 2 for p in places], axis=0)
                good = has((1, 0), (2, 0), (3, 0)) | has((0, 1), (0, 2), (0, 3))
                good |= has((1, 0), (0, 1), (1, 1), (2, 0), (2, 1))
                good |= has((1, 0), (0, 1), (1, 1), (0, 2), (1, 2))
                words = np.zeros(self.lanes, np.uint32)
                self.residuals(active & good, words)
                self.residuals(active & ~good, words)
                last = out[k, j - 1] if j else out[k - 1, j] if k else np.float32(0)
                two, three = np.float32(2), np.float32(3)
                a1, a2, b1, b2, c = f(1, 0), f(2, 0), f(0, 1), f(0, 2), f(1, 1)
                y, z = two * a1 - a2, two * b1 - b2
                m = lambda d: f(0, d) - (two * f(1, d) - f(2, d))
                guess = y + (two * m(1) - m(2))
                for weaker in (
                    y + m(1),
                    z + (a1 - (two * c - f(1, 2))),
                    three * (a1 - a2) + f(3, 0),
                    three * (b1 - b2) + f(0, 3),
                    (a1 + b1) - c,
                    y,
                    z,
                    a1,
                    b1,
                    last,
                    np.float32(0),
                ):
                    guess = np.where(np.isnan(guess), weaker, guess).astype(np.float32)
                bits, sign = guess.view(np.uint32), np.uint32(0x80000000)
                key = bits ^ np.where(bits & sign, np.uint32(0xFFFFFFFF), sign)
                one = np.uint32(1)
                key = key + ((words >> one) ^ (np.uint32(0) - (words & one)))
                bits = key ^ np.where(key & sign, sign, np.uint32(0xFFFFFFFF))
                # As integers: no NaN may change its bits.
                out[k, j].view(np.uint32)[active] = bits[active]
                known[k + 3, j + 3].view(np.uint32)[active] = bits[active]


def packed_words(data, count):
    """Residual words of codec 7."""
    length = struct.unpack_from("<H", data)[0]
    widths, words = data[2 : 2 + length], data[2 + length :]
    if length != count // 32:
        widths = lz4_block(widths, count // 32)
    need(len(widths) == count // 32, "codec 7: widths")
    out, bits = [], int.from_bytes(words, "little")
    for n in range(count // 16):
        width = widths[n // 2] >> 4 * (n % 2) & 15
        width = 16 if width == 15 else width
        out += [bits >> i * width & (1 << width) - 1 for i in range(16)]
        bits >>= 16 * width
        words = words[2 * width :]
    need(not words and bits == 0, "codec 7: bytes are left over")
    return out


def coded_plane(data, count):
    """A plane of codec 8 and what follows it."""
    kind, data = data[0], data[1:]
    if kind < 2:
        return (data[:count], data[count:]) if kind == 0 else (data[:1] * count, data[1:])
    need(kind == 2, "codec 8: kind of plane")
    last, at, values = data[0], 1, []
    freq = []
    while len(freq) <= last:
        first = data[at]
        if first == 0:
            freq += [0] * (1 + data[at + 1])
        else:
            freq.append(first if first < 128 else (first & 127) << 8 | data[at + 1])
        at += 1 if 0 < first < 128 else 2
    need(len(freq) == last + 1 and sum(freq) == 2048 and max(freq) < 2048, "codec 8: table")
    slots = [(v, f, r) for v, f in enumerate(freq) for r in range(f)]
    count_of_words, *x = struct.unpack_from("<5I", data, at)
    words = iter(struct.unpack_from(f"<{count_of_words}H", data, at + 20))
    for t in range(count):
        value, f, r = slots[x[t % 4] % 2048]
        values.append(value)
        new = f * (x[t % 4] >> 11) + r
        x[t % 4] = new if new >= 1 << 16 else new << 16 | next(words)
    need(next(words, None) is None and x == [1 << 16] * 4, "codec 8: words are left over")
    return bytes(values), data[at + 20 + 2 * count_of_words :]


def two_values(stored, edge, dtype, is_bits):
    """A brick of codec 9."""
    values, rest = (b"\0\1", stored) if is_bits else (stored[: 2 * dtype.itemsize], stored[2 * dtype.itemsize :])
    need(len(values) == 2 * dtype.itemsize, "codec 9: values")
    plane, rest = coded_plane(rest, edge**3 // 8)
    need(not rest, "codec 9: bytes are left over")
    f = np.unpackbits(np.frombuffer(plane, "u1"), bitorder="little").reshape(edge, edge, edge)
    for k in range(edge):
        for j in range(edge):
            if k == j == 0:
                continue
            b = f[k - 1, j] if k else f[0, j - 1]
            a = f[k, j - 1] if j else b
            c = b if k == 0 or j + 1 == edge else f[k - 1, j + 1]
            votes = a.astype(int) + b + c + np.append(a[:1], a[:-1]) + np.append(a[1:], a[-1:])
            f[k, j] ^= votes >= 3
    return np.frombuffer(values, dtype)[f]


def fitted(stored, edge, dtype, is_packed):
    """A brick of codec 7 or 8."""
    *w, offset = struct.unpack_from("<4bi", stored)
    rest, count = stored[8:], edge**3
    if is_packed:
        d = np.array(packed_words(rest, count), np.int64)
    else:
        d = np.zeros(count, np.int64)
        for b in range(dtype.itemsize):
            plane, rest = coded_plane(rest, count)
            d |= np.frombuffer(plane, "u1").astype(np.int64) << 8 * b
        need(not rest, "codec 8: bytes are left over")
    d = ((d >> 1) ^ -(d & 1)).reshape(edge, edge, edge)
    f = np.zeros(d.shape, dtype)
    f[0, 0] = np.cumsum(d[0, 0]).astype(dtype)
    for k in range(edge):
        for j in range(k == 0, edge):
            if k == 0:
                taps = [f[0, j - 1]] * 4
            else:
                b = f[k - 1, j]
                above = f[k - 1, j + 1] if j + 1 < edge else b
                taps = [f[k, j - 1], b, f[k - 1, j - 1], above] if j else [b, b, b, above]
            guess = sum(w * t.astype(np.int64) for w, t in zip(w, taps)) + offset + 32 >> 6
            f[k, j] = (guess + d[k, j]).astype(dtype)
    return f


class Reader:
    def __init__(self, data, name=None, level=0):
        self.data = data
        self.seed = self.find_seed()
        self.generation, self.log_end, self.catalog_ref, self.footer = self.find_root()
        need(self.generation > 0, "damaged root: generation 0")
        need(self.log_end <= len(data), "truncated")
        self.read_catalog()
        own = [n for n, v in enumerate(self.volumes) if v["lod"] == 0 and name in (None, v["name"])]
        need(own, f"no volume {name}")
        self.levels = self.find_levels(own[0])
        need(0 <= level <= len(self.levels), f"level {level} of {len(self.levels)}")
        self.choose(own[0] if level == 0 else self.levels[level - 1])

    # Sections 3 to 6.

    def find_seed(self):
        header = self.data[:4096]
        if header[:8] != MAGIC or crc32c(header[:4092]) != struct.unpack_from("<I", header, 4092)[0]:
            header = self.data[12288 + 40 : 12288 + 40 + 4096]
            need(header[:8] == MAGIC, "not a volume")
            seed = crc32c(header[40:56])
            need(crc32c(header[:4092]) == struct.unpack_from("<I", header, 4092)[0], "header copy")
            self.seed = seed
            need(self.record_at(12288) is not None, "header copy")
        major, _, length, incompat = struct.unpack_from("<HHIQ", header, 8)
        need(major == 1, f"format version {major}")
        need(incompat & ~0b111000 == 0, f"unknown features {incompat:#x}")
        need(length == 4096, "header length")
        return crc32c(header[40:56])

    def find_root(self):
        roots = []
        for at, odd in ((4096, 1), (8192, 0)):
            block = self.data[at : at + 4096]
            if len(block) < 4096 or block[:8] != b"SVOLROOT":
                continue
            if crc32c(block[:4092], self.seed) != struct.unpack_from("<I", block, 4092)[0]:
                continue
            generation, end = struct.unpack_from("<2Q", block, 8)
            if generation % 2 == odd and end % 4096 == 0 and end >= 12288:
                footer = struct.unpack_from("<Q", block, 40)[0]
                roots.append((generation, end, block[24:40], footer))
        if len(roots) == 2:
            return max(roots)
        start = roots[0] if roots else (0, 12288, bytes(16), 0)
        root = start
        while (after := self.next_commit(root)) is not None:
            root = after
        if roots and root == start and start[0] > 0:
            need(len(self.data) <= root[1], "damaged root: a newer generation may be lost")
        return root

    def next_commit(self, root):
        generation, at, _, previous = root
        chain, count, start = self.seed, 0, at
        while True:
            found = self.record_at(at)
            if found is None or found[0]["generation"] != generation + 1:
                return None
            head, payload, end = found
            if head["kind"] == FOOTER:
                if len(payload) != 72:
                    return None
                said = struct.unpack_from("<4Q", payload, 24)[:3]
                fits = struct.unpack_from("<Q", payload)[0] == generation + 1
                fits = fits and said == (start, previous, count)
                fits = fits and struct.unpack_from("<I", payload, 64)[0] == chain
                log_end = (end + 4095) // 4096 * 4096
                return (generation + 1, log_end, payload[8:24], at) if fits else None
            chain = crc32c(self.data[at : at + 40], chain)
            count, at = count + 1, end

    def record_at(self, at):
        if at + 40 > len(self.data) or self.data[at : at + 4] != b"SVrc":
            return None
        kind, codec, _, stored, decoded, generation, key, volume, level, _, crc = struct.unpack_from(
            "<BBHIIQQHBBI", self.data, at + 4
        )
        end = at + 40 + (stored + 7) // 8 * 8
        if end > len(self.data):
            return None
        if crc32c(self.data[at + 40 : end], crc32c(self.data[at : at + 36], self.seed)) != crc:
            return None
        head = dict(kind=kind, codec=codec, decoded=decoded, generation=generation, key=key)
        head.update(volume=volume, level=level, crc=crc)
        return head, self.data[at + 40 : at + 40 + stored], end

    def follow(self, reference, kind, key=0, level=0, before=None, volume=None):
        """The record of a reference, which must be in its place."""
        offset, length, crc = struct.unpack("<QII", reference)
        found = self.record_at(offset) if offset >= 12288 else None
        need(found is not None, f"no record at offset {offset}")
        head, payload, end = found
        need(end <= (self.log_end if before is None else before), f"record at {offset} ends too late")
        need((head["crc"], len(payload)) == (crc, length), f"another record at {offset}")
        place = (head["kind"], head["key"], head["level"], head["volume"])
        volume = self.number if volume is None else volume
        need(place == (kind, key, level, volume), f"record of another place at {offset}")
        need(head["generation"] <= self.generation, f"record of a later generation at {offset}")
        return head, payload, offset

    # Section 7.

    def read_catalog(self):
        head, payload, _ = self.follow(self.catalog_ref, CATALOG, volume=0)
        need(head["generation"] == self.generation, "catalog of another generation")
        version, count = struct.unpack_from("<HH", payload)
        need(version == 1 and 1 <= count <= 4096, f"catalog version {version} with {count} volumes")
        self.volumes, at = [], 8
        for n in range(count):
            entry = payload[at : at + 56]
            need(len(entry) == 56, "catalog is cut off")
            level, lod, parent, _, name_length = struct.unpack_from("<BBHHH", entry, 48)
            name = payload[at + 56 : at + 56 + name_length]
            at += 56 + (name_length + 7) // 8 * 8
            need(at <= len(payload) and name_length <= 255, "name is cut off")
            fits = parent == 0 if lod == 0 else parent < n and self.volumes[parent]["lod"] == 0
            need(fits, f"volume {n} is level {lod} of volume {parent}")
            refs = dict(attributes=entry[0:16], history=entry[16:32], root=entry[32:48])
            self.volumes.append(dict(refs, level=level, lod=lod, parent=parent, name=name.decode("utf-8")))
        need(at == len(payload), "bytes are left over in the catalog")

    def choose(self, number):
        self.number = number
        entry = self.volumes[number]
        self.root_ref, self.root_level, self.name = entry["root"], entry["level"], entry["name"]
        self.history = ""
        if any(entry["history"]):
            _, text, _ = self.follow(entry["history"], HISTORY)
            version, length = struct.unpack_from("<IQ", text)
            if version == 1:
                self.history = text[12 : 12 + length].decode("utf-8")
        a = self.attributes(number)
        self.sample, self.kind, self.unit = TYPES[a[2]], KINDS[a[4]], UNITS[a[5]]
        self.dtype = np.dtype(NUMPY[self.sample])
        self.edge = 1 << a[7]
        self.background, self.low, self.high = (self.value(a[n : n + 4]) for n in (8, 16, 20))
        self.has_nan = bool(struct.unpack_from("<I", a, 24)[0])
        self.min = struct.unpack_from("<3q", a, 32)
        self.size = struct.unpack_from("<3I", a, 56)
        self.matrix = struct.unpack_from("<12d", a, 72)
        self.counts = struct.unpack_from("<5Q", a, 168)
        self.bricks = [-(-n // self.edge) for n in self.size]

    def attributes(self, number):
        _, a, _ = self.follow(self.volumes[number]["attributes"], ATTRIBUTES, volume=number)
        need(len(a) == 208 and a[0:2] == b"\1\0", "attributes version")
        need(a[3] == 1 and a[6] == 0 and 3 <= a[7] <= 6, "attributes")
        return a

    def find_levels(self, parent):
        """Numbers of the levels of detail that were built from the samples of a volume."""
        found = {}
        for n, entry in enumerate(self.volumes):
            if entry["lod"] and entry["parent"] == parent:
                if self.attributes(n)[68:72] == self.volumes[parent]["root"][12:16]:
                    found[entry["lod"]] = n
        whole = range(1, len(found) + 1)
        return [found[lod] for lod in whole] if all(lod in found for lod in whole) else []

    def value(self, four):
        width = self.dtype.itemsize
        need(not any(four[width:]), "value of the type")
        return np.frombuffer(four[:width], self.dtype)[0]

    # Sections 8 and 9.

    def samples(self):
        """All samples as an array [k, j, i]."""
        shape = tuple(b * self.edge for b in reversed(self.bricks))
        self.out = np.full(shape, self.background, self.dtype)
        self.seen = [0, 0, 0]
        if self.root_level:
            self.page(self.root_ref, self.root_level, [0, 0, 0], None)
        need(tuple(self.seen) == (self.counts[0], self.counts[1], self.counts[3]), "counts")
        nx, ny, nz = self.size
        return self.out[:nz, :ny, :nx]

    def put(self, brick, edge, values):
        k, j, i = (slice(b * self.edge, (b + edge) * self.edge) for b in reversed(brick))
        self.out[k, j, i] = values

    def page(self, reference, level, origin, before):
        _, p, offset = self.follow(reference, PAGE, morton(origin), level, before)
        need(p[0] == level and list(struct.unpack_from("<3I", p, 8)) == origin, "page of another place")
        masks = [int.from_bytes(p[at : at + 64], "little") for at in (24, 88, 152)]
        child, tile, nan = ([s for s in range(512) if m >> s & 1] for m in masks)
        need(not set(child) & set(tile), "a slot is both child and tile")
        need(set(nan) <= set(child) | set(tile), "NaN in an absent slot")
        need(len(p) == 216 + 24 * len(child) + 4 * len(tile) + 584, "page length")
        self.seen[2] += 1
        edge = 8 ** (level - 1)
        place = lambda slot: [o + edge * v for o, v in zip(origin, unmorton(slot))]
        for slot in child + tile:
            need(all(v < n for v, n in zip(place(slot), self.bricks)), "slot outside of the domain")
        tiles_at = 216 + 16 * len(child)
        for n, slot in enumerate(tile):
            at = tiles_at + 4 * n
            self.put(place(slot), edge, self.value(p[at : at + 4]))
            self.seen[1] += 1
        for n, slot in enumerate(child):
            below = p[216 + 16 * n : 232 + 16 * n]
            if level > 1:
                self.page(below, level - 1, place(slot), offset)
            else:
                self.put(place(slot), 1, self.brick(below, place(slot), offset))
                self.seen[0] += 1

    def brick(self, reference, brick, before):
        head, stored, _ = self.follow(reference, BRICK, morton(brick), 0, before)
        count, width = self.edge**3, self.dtype.itemsize
        length = count // 8 if self.sample == "bit" else count * width
        need(head["decoded"] == length >= len(stored), "brick length")
        codec = head["codec"]
        if codec < 2:
            raw = stored if codec == 0 else lz4_block(stored, length)
            need(len(raw) == length, "brick length")
            if self.sample == "bit":
                raw = np.unpackbits(np.frombuffer(raw, "u1"), bitorder="little").tobytes()
            return np.frombuffer(raw, self.dtype).reshape((self.edge,) * 3)
        if codec == 9:
            need(self.sample != "f32", "codec 9 of f32")
            return two_values(stored, self.edge, self.dtype, self.sample == "bit")
        need(codec <= 8 and self.sample != "bit", f"codec {codec}")
        need(codec not in (5, 6) or self.sample == "f32", f"codec {codec} of other samples than f32")
        if codec > 6:
            need(self.sample in ("u8", "i8", "u16", "i16"), f"codec {codec} of {self.sample}")
            return fitted(stored, self.edge, self.dtype, codec == 7)
        if codec == 6:
            return Rows(stored, self.edge).brick()
        lengths = struct.unpack_from(f"<{width}I", stored)
        at, words = 4 * width, np.zeros(count, np.uint64)
        for b, n in enumerate(lengths):
            need(at + n <= len(stored), "planes are cut off")
            plane = stored[at : at + n] if n == count else lz4_block(stored[at : at + n], count)
            words |= np.frombuffer(plane, "u1").astype(np.uint64) << np.uint64(8 * b)
            at += n
        need(at == len(stored), "bytes are left over")
        words = words.astype(f"u{width}").reshape((self.edge,) * 3)
        if codec > 2:
            one = words.dtype.type(1)
            words = (words >> one) ^ (words.dtype.type(0) - (words & one))
            words = {3: self.along_rows, 4: self.along_planes, 5: self.smooth}[codec](words)
        return words.view(self.dtype)

    def unkey(self, key):
        if self.sample != "f32":
            return key
        sign = np.uint32(0x80000000)
        return key ^ np.where(key & sign, sign, np.uint32(0xFFFFFFFF))

    def along_rows(self, d):
        rows = d.reshape(-1, self.edge)
        first = np.cumsum(rows[:, 0], dtype=d.dtype)
        rows = np.cumsum(rows, axis=1, dtype=d.dtype)
        rows[1:] += first[:-1, None]
        return self.unkey(rows.reshape(d.shape))

    def along_planes(self, d):
        return self.unkey(np.cumsum(np.cumsum(d, axis=0, dtype=d.dtype), axis=1, dtype=d.dtype))

    def smooth(self, d):
        f = np.zeros(d.shape, np.float32)
        two = np.float32(2)

        def along_j(k, j):
            if j == 0:
                return np.zeros(self.edge, np.float32)
            return f[k, 0] if j == 1 else two * f[k, j - 1] - f[k, j - 2]

        with np.errstate(all="ignore"):
            for k in range(self.edge):
                for j in range(self.edge):
                    guess = along_j(k, j)
                    miss = [f[k - n, j] - along_j(k - n, j) for n in (1, 2)[: min(k, 2)]]
                    if k == 1:
                        guess = guess + miss[0]
                    elif k > 1:
                        guess = guess + (two * miss[0] - miss[1])
                    bits = np.where(np.isnan(guess), np.float32(0), guess).view(np.uint32)
                    sign = np.uint32(0x80000000)
                    key = bits ^ np.where(bits & sign, np.uint32(0xFFFFFFFF), sign)
                    f[k, j] = self.unkey(key + d[k, j]).astype(np.uint32).view(np.float32)
        return f.view(np.uint32)

    def describe(self):
        number = lambda v: v.item() if np.isfinite(v) else str(v)  # JSON has no inf
        low, high = number(self.low), number(self.high)
        return dict(
            sample=self.sample, kind=self.kind, unit=self.unit, brick_edge=self.edge, name=self.name,
            history=self.history, min=self.min, size=self.size, matrix=self.matrix,
            background=number(self.background), range=[low, high], has_nan=self.has_nan,
            bricks=self.counts[0], tiles=self.counts[1], pages=self.counts[3], generation=self.generation,
            volumes=[v["name"] for v in self.volumes if v["lod"] == 0], levels=len(self.levels),
        )


def main():
    with open(sys.argv[1], "rb") as file:
        reader = Reader(file.read(), *sys.argv[3:4], *map(int, sys.argv[4:5]))
    samples = reader.samples()
    if len(sys.argv) > 2:
        samples.tofile(sys.argv[2])
    print(json.dumps(reader.describe()))


if __name__ == "__main__":
    try:
        main()
    except Damaged as error:
        sys.exit(f"{sys.argv[1]}: {error}")

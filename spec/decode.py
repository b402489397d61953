#!/usr/bin/env python3
"""Decodes a .ssplat file to PAM, in double precision: python3 decode.py [--partial] IN.ssplat OUT.pam

Written from the text of ssplat.md alone, to read beside it: section numbers are those of the text. Needs numpy, and
the zstd library (Debian: libzstd1) for the planes layout.

Exit codes: 2 wrong use, 3 reading or writing failed, 4 illegal file, 5 newer version or no zstd library, 6 over this decoder's limits.
"""

import ctypes
import ctypes.util
import math
import os
import sys
import zlib

import numpy as np

SIGNATURE = bytes([0x89, 0x53, 0x53, 0x50])
FINE = 16

# What this decoder is willing to do (§9).
MOST_PRIMITIVES = 1 << 24
MOST_SAMPLES = 1 << 28
MOST_WEIGHTS = 1 << 32


class Illegal(Exception):
    """The file breaks the specification."""


class TooMuch(Exception):
    """The file may be sound but asks for more than this decoder allows."""


class Unsupported(Exception):
    """A newer file, or a library is missing."""


def demand(condition, problem):
    if not condition:
        raise Illegal(problem)


# §1. Words and arithmetic


def quotient(a, b):
    """a / b for b > 0, without the fraction."""
    return a // b if a >= 0 else -(-a // b)


def ilog2(v):
    return v.bit_length() - 1


def bits(v):
    return v.bit_length()


def clamp(v, low, high):
    return low if v < low else high if v > high else v


def rounded(v):
    return math.floor(v + 0.5)


class Bytes:
    def __init__(self, data, at=0):
        self.data, self.at = data, at

    def take(self, count, what):
        demand(count <= len(self.data) - self.at, f"{what} is cut off")
        self.at += count
        return self.data[self.at - count : self.at]

    def byte(self, what):
        return self.take(1, what)[0]

    def u32(self, what):
        return int.from_bytes(self.take(4, what), "little")

    def varint(self, what):  # §2.1
        value = 0
        for i in range(9):
            byte = self.byte(what)
            value |= (byte & 127) << 7 * i
            if byte < 128:
                demand(byte > 0 or i == 0, f"{what} is longer than it needs to be")
                return value
        raise Illegal(f"{what} is too long")

    def signed(self, what):
        value = self.varint(what)
        return value // 2 if value % 2 == 0 else -(value + 1) // 2


# §2. Header and checksum, §3. Sections


class Header:
    def __init__(self, data):
        b = Bytes(data)
        demand(data[:4] == SIGNATURE, "not an ssplat file")
        b.at = 4
        version = b.byte("version")
        if version != 3:
            raise Unsupported(f"format version {version}")
        flags = b.byte("flags")
        self.layout = flags & 3
        self.blend_sum = flags >> 2 & 1
        self.channels = 1 + (flags >> 3 & 3)
        self.sixteen = flags >> 5 & 1
        self.codebook = flags >> 6 & 1
        self.sections = flags >> 7 & 1
        self.size = [b.varint("width"), b.varint("height")]
        demand(all(1 <= s <= 1 << 20 for s in self.size), "width or height out of range")
        self.count = b.varint("count")
        demand(self.count < 1 << 32, "count out of range")
        first, second, third = b.take(3, "steps")
        self.D = (first & 15) + 4
        self.delta = self.D / 32
        self.tau = 2.0 ** (((first >> 4 & 3) - 1) / 2)
        self.chroma = [1, 1.5, 2, 3][first >> 6]
        self.position = second & 15
        self.luma = 2.0 ** ((second >> 4) / 3 - 7)
        self.coarsest = (third & 15) - 6
        self.range = third >> 4
        self.finest = self.coarsest - self.range
        demand(self.finest >= -10, "finest step out of range")
        demand(self.layout != 0 or self.range == 0, "range in the packed layout")
        self.bytes = data[: b.at]
        # §4
        self.top = min(255, 704 // self.D)
        self.cap = 128 if self.layout < 2 else 4096
        self.grid = [self.positions(s, self.finest) for s in self.size]
        self.angle_counts = [self.angle_count(d) for d in range(256)]
        self.steps_of = {}

    def angle_count(self, d):  # §4.2
        if d == 0:
            return 1
        r = 2.0 ** (d * self.delta)
        n = math.ceil(math.pi * (r - 1 / r) / (math.sqrt(2) * self.delta * math.log(2) * self.tau))
        return clamp(n, 1, self.cap)

    @staticmethod
    def positions(side, e):
        return -(-side >> e) if e >= 0 else side << -e

    def logs(self, major, minor, angle):
        """lx and ly of §4.3."""
        key = (major, minor, angle)
        if key not in self.steps_of:
            if self.range == 0:
                self.steps_of[key] = (0, 0)
            else:
                r = 2.0 ** ((major - minor) * self.delta)
                sin = math.sin(math.pi * angle / self.angle_counts[major - minor])
                lift = 0.5 * math.log2(1 + (r * r - 1) * sin * sin)
                fine = self.position / 4 + 1 / 64
                ex = math.floor(major * self.delta - 2 - lift - fine + 0.5)
                ey = math.floor(minor * self.delta - 2 + lift - fine + 0.5)
                self.steps_of[key] = tuple(clamp(e, self.finest, self.coarsest) - self.finest for e in (ex, ey))
        return self.steps_of[key]

    def check_shape(self, major, minor, angle):
        demand(0 <= minor <= major <= self.top, "scale out of range")
        demand(angle < self.angle_counts[major - minor], "angle out of range")

    def check(self, p):
        x, y, major, minor, angle, color = p
        self.check_shape(major, minor, angle)
        for v, side, log in zip((x, y), self.size, self.logs(major, minor, angle)):
            demand(v < self.positions(side, self.finest + log), "position out of range")
        demand(all(-32768 <= c <= 32767 for c in color), "colour out of range")


def read_sections(b, damaged):
    """Skips the sections; gives back the bytes that the file's checksum covers."""
    start, covered, last = b.at, b"", b""
    count = b.varint("section count")
    demand(count > 0, "no section")
    for _ in range(count):
        name = b.take(4, "section name")
        demand(all(65 <= c <= 90 or 97 <= c <= 122 for c in name), "section name is not made of letters")
        demand(name > last, "order of sections")
        last = name
        length = b.varint("section length")
        stored = b.u32("section checksum")
        covered += b.data[start : b.at]
        contents = b.take(length, "section")
        start = b.at
        if name[0] < 97:
            raise Illegal(f"unknown critical section {name.decode()}")
        if zlib.crc32(name + contents) != stored:
            damaged.append(name.decode())
    return covered


# §6.1


def read_color(b, channels, what):
    color = tuple(b.signed(what) for _ in range(channels))
    demand(all(-32768 <= c <= 32767 for c in color), f"{what} out of range")
    return color


def read_codebook(b, header):
    if not header.codebook:
        return None
    size = b.varint("codebook size")
    demand(1 <= size <= 65536, "codebook size")
    book, first = [], -32768
    for _ in range(size):
        first += b.varint("codebook")
        demand(first <= 32767, "codebook out of range")
        color = (first,) + read_color(b, header.channels - 1, "codebook")
        demand(not book or book[-1] < color, "codebook order")
        book.append(color)
    return book


# §6.3


def hilbert(order, x, y):
    mask, distance = (1 << order) - 1, 0
    for bit in range(order - 1, -1, -1):
        right, down = x >> bit & 1, y >> bit & 1
        distance = 4 * distance + (3 * right ^ down)
        if down == 0:
            if right == 1:
                x, y = x ^ mask, y ^ mask
            x, y = y, x
    return distance


def hilbert_point(order, distance):
    x = y = 0
    for bit in range(order):
        digit = distance >> 2 * bit & 3
        right, down = digit >> 1, (digit ^ digit >> 1) & 1
        if down == 0:
            if right == 1:
                last = (1 << bit) - 1
                x, y = last - x, last - y
            x, y = y, x
        x, y = x | right << bit, y | down << bit
    return x, y


# §6. The packed layout


def read_packed(b, header):
    background = read_color(b, header.channels, "background")
    book = read_codebook(b, header)
    count = header.count
    if count == 0:
        return background, []
    fields = 6 if book else 5 + header.channels
    widths = list(b.take(fields, "record format"))
    demand(max(widths[:2]) <= 15 and max(widths) <= 16, "record field width")
    offsets = [0, 0, b.byte("record format")] + [0] * (fields - 3)
    if not book:
        offsets[5:] = read_color(b, header.channels, "record format")
    size = -(-sum(widths) // 8)

    def tiles(k, width):
        return -(-header.grid[k] // (1 << width))

    across, down = tiles(0, widths[0]), tiles(1, widths[1])
    demand(across * down + count * size <= len(b.data) - b.at, "records are cut off")
    counts = [b.varint("tile count") for _ in range(across * down)]
    demand(sum(counts) == count, "sum of tile counts")
    order, out, last = max(widths[:2]), [], None
    seen = [set() for _ in widths]
    for tile, n in enumerate(counts):
        corner = [tile % across << widths[0], tile // across << widths[1]]
        for _ in range(n):
            record = int.from_bytes(b.take(size, "records"), "little")
            raw = []
            for width in widths:
                raw.append(record & (1 << width) - 1)
                record >>= width
            demand(record == 0, "padding of a record")
            v = [r + o for r, o in zip(raw, offsets)]
            demand(not book or v[5] < len(book), "codebook index")
            color = book[v[5]] if book else tuple(v[5:])
            p = (corner[0] + v[0], corner[1] + v[1], v[2], v[2] - v[3], v[4], color)
            header.check(p)
            key = (tile, hilbert(order, v[0], v[1])) + p[2:]
            demand(last is None or last <= key, "order of records")
            last = key
            out.append(p)
            for values, value in zip(seen, v):
                values.add(value)
    for k in range(2, fields):
        if k == 2 or k >= 5 and not book:
            demand(offsets[k] == min(seen[k]), "record format")
        demand(widths[k] == bits(max(seen[k]) - offsets[k]), "record format")
    rest = sum(widths[2:])
    best = min(
        (count * -(-(wx + wy + rest) // 8) + tiles(0, wx) * tiles(1, wy), wx + wy, wx)
        for wx in range(16)
        for wy in range(16)
    )
    demand(best[1:] == (widths[0] + widths[1], widths[0]), "record format")
    return background, out


# §7. The planes layout


def zstd_library():
    for name in (ctypes.util.find_library("zstd"), "libzstd.so.1", "libzstd.dylib", "libzstd.dll"):
        try:
            library = ctypes.CDLL(name) if name else None
        except OSError:
            continue
        if library:
            library.ZSTD_decompress.restype = ctypes.c_size_t
            library.ZSTD_decompress.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t]
            library.ZSTD_findFrameCompressedSize.restype = ctypes.c_size_t
            library.ZSTD_findFrameCompressedSize.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
            return library
    raise Unsupported("the zstd library is not installed")


def decompress(frame, count):
    library = zstd_library()
    demand(library.ZSTD_findFrameCompressedSize(frame, len(frame)) == len(frame), "zstd frame is broken")
    plane = ctypes.create_string_buffer(max(1, count))
    demand(library.ZSTD_decompress(plane, count, frame, len(frame)) == count, "zstd frame is broken")
    return plane.raw[:count]


def read_planes(b, header):
    background = read_color(b, header.channels, "background")
    book = read_codebook(b, header)
    count = header.count
    most = [8, 2, 2, 1, 1, 1] + [3] * (1 if book else header.channels)
    fields = []
    for limit in most:
        width = b.byte("bytes of a field")
        demand(width <= limit, "bytes of a field")
        values = np.zeros(count, np.uint64)
        for i in range(width):
            length = b.varint("plane")
            plane = b.take(length or count, "plane")
            if length:
                plane = decompress(plane, count)
            values |= np.frombuffer(plane, np.uint8).astype(np.uint64) << np.uint64(8 * i)
        demand(width == 0 or count > 0 and int(values.max()) >> 8 * (width - 1) > 0, "bytes of a field")
        fields.append(values.tolist())
    cells = [(g - 1 >> header.range) + 1 for g in header.grid]
    order = bits(max(cells) - 1)
    out, last, position = [], None, 0
    for row in zip(*fields):
        position += row[0]
        row = (position,) + row[1:]
        demand(last is None or last <= row, "order of primitives")
        last = row
        demand(position < 1 << 2 * order, "position out of range")
        cx, cy = hilbert_point(order, position)
        demand(cx < cells[0] and cy < cells[1], "position out of range")
        major, minor, angle = row[3], row[3] - row[4], row[5]
        header.check_shape(major, minor, angle)
        lx, ly = header.logs(major, minor, angle)
        fx, fy = header.range - lx, header.range - ly
        demand(row[1] < 1 << fx and row[2] < 1 << fy, "refinement out of range")
        demand(not book or row[6] < len(book), "codebook index")
        color = book[row[6]] if book else tuple(v // 2 if v % 2 == 0 else -(v + 1) // 2 for v in row[6:])
        p = (cx << fx | row[1], cy << fy | row[2], major, minor, angle, color)
        header.check(p)
        out.append(p)
    return background, out


# §8.1 The range coder


class RangeDecoder:
    def __init__(self, data):
        self.data, self.at = data, 4
        demand(data[:4] != b"\xff\xff\xff\xff", "start of the coded stream")
        self.code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
        self.range = 0xFFFFFFFF

    def bit(self, one):
        bound = (self.range >> 16) * one
        if self.code < bound:
            self.range, bit = bound, 1
        else:
            self.range -= bound
            self.code -= bound
            bit = 0
        self.normalize()
        return bit

    def normalize(self):
        while self.range < 1 << 24:
            self.range <<= 8
            self.code = self.code << 8 | (self.data[self.at] if self.at < len(self.data) else 0)
            self.at += 1

    def uniform(self, total):
        unit = self.range // total
        value = min(self.code // unit, total - 1)
        self.code -= unit * value
        self.range = self.range - unit * value if value == total - 1 else unit
        self.normalize()
        return value

    def raw(self, count):
        if count > 16:
            high = self.uniform(1 << count - 16)
            return high << 16 | self.uniform(1 << 16)
        return self.uniform(1 << count)

    def finish(self):
        length = len(self.data)
        if length == 0:
            return
        last = self.data[-1]
        right = length <= self.at and last != 0
        if right and 8 * (self.at - length) < 32:
            unit = 1 << 8 * (self.at - length)
            right = self.code < unit and self.code < last * unit and self.code + (256 - last) * unit >= self.range
        demand(right, "end of the coded stream")


# §8.2 Models

STRETCH = [rounded(256 * math.log(p / (1 - p))) for p in ((i + 0.5) / 4096 for i in range(4096))]
SQUASH = [clamp(rounded(65536 / (1 + math.exp(-i / 256))), 32, 65504) for i in range(-2047, 2048)]
STEP = [rounded(65536 / (n + 2)) for n in range(1024)]
TRUST = [rounded(256 * math.sqrt(n / (n + 2))) for n in range(1024)]


class Field:
    def __init__(self, coder, nodes, contexts, limit):
        self.coder, self.nodes, self.limit = coder, nodes, limit
        self.p = [[1 << 21] * (n * nodes) for n in contexts]
        self.n = [[0] * (n * nodes) for n in contexts]
        self.weights = [[65536 // len(contexts)] * len(contexts) for _ in range(nodes)]

    def start(self, k, value, node, one, n):
        self.p[k][value * self.nodes + node] = 64 * one
        self.n[k][value * self.nodes + node] = n

    def opinions(self, chances, counts):
        for k, n in enumerate(counts):
            for value in range(len(self.p[k]) // self.nodes):
                for node, chance in enumerate(chances):
                    self.start(k, value, node, 256 * chance + 128, n)
        return self

    def bit(self, contexts, node):
        weights, x, inputs, places = self.weights[node], 0, [], []
        for k, value in enumerate(contexts):
            at = value * self.nodes + node
            v = STRETCH[self.p[k][at] >> 10] * TRUST[self.n[k][at]] >> 8
            x += v * weights[k]
            inputs.append(v)
            places.append(at)
        one = SQUASH[clamp(x >> 16, -2047, 2047) + 2047]
        bit = self.coder.bit(one)
        error, target = (65536 - one, (1 << 22) - 1) if bit else (-one, 0)
        for k, at in enumerate(places):
            weights[k] += inputs[k] * error + 8192 >> 14
            p, n = self.p[k], self.n[k]
            p[at] += (target - p[at]) * STEP[n[at]] >> 16
            if n[at] < self.limit:
                n[at] += 1
        return bit

    def tree(self, contexts, count):
        node = 1
        for _ in range(count):
            node = 2 * node + self.bit(contexts, node)
        return node - (1 << count)

    def signed(self, contexts):
        if self.bit(contexts, 0):
            return 0
        negative, length, m = self.bit(contexts, 1), 0, 1
        while length < 16 and self.bit(contexts, 2 + length):
            length += 1
        if length > 0:
            m = 2 + self.bit(contexts, 20 + 3 * length)
        if length > 1:
            m = 2 * m + self.bit(contexts, 21 + 3 * length + (m & 1))
        rest = max(0, length - 2)
        m = m << rest | self.coder.raw(rest)
        return -m if negative else m


# §8.3 Positions

STAY = [251, 251, 249, 243, 222, 195, 164, 137, 102, 71, 46, 25, 13, 8, 4] + [2] * 9


def some(chance, tries):
    none = 65536
    for _ in range(max(1, tries)):
        none = max(256, none * (256 - chance) >> 8)
    return 65536 - none


def log16(v):
    log = ilog2(v)
    return 16 * log + ((v << 4 >> log) & 15)


class Node:
    __slots__ = ("corner", "count", "slope", "density", "crowd")

    def __init__(self, corner, count, around):
        self.corner, self.count = corner, count
        self.slope, self.density, self.crowd = around


def axis_of(log):
    return None if log == [0, 0] else 0 if log[0] >= log[1] else 1


def whole_region(header):
    return (0, 0), [max(bits(g - 1), header.range) for g in header.grid]


class Counts:
    def __init__(self, coder):
        self.coder = coder
        self.stay = Field(coder, 1, [576, 384], 250)
        self.small = Field(coder, 1, [416, 6656], 250)
        self.large = Field(coder, 72, [16, 7], 250)
        for size, chance in enumerate(STAY):
            for full in range(8):
                for s in range(3):
                    self.stay.start(0, (size * 8 + full) * 3 + s, 0, some(chance, max(0, full - s) // (s + 1)), 6)
                for m in range(2):
                    self.stay.start(1, (size * 8 + full) * 2 + m, 0, some(chance, 1 + m), 4)
        for n in range(1, 13):
            self.opinion(n, 1, 0, n + 1)

    def opinion(self, n, node, low, high):
        if high - low < 2:
            return
        middle = low + (high - low) // 2
        one = 65536 * sum(math.comb(n, k) for k in range(middle, high)) // sum(math.comb(n, k) for k in range(low, high))
        at = 16 * n + node
        for k, values in enumerate((2, 32)):
            for value in range(values):
                self.small.start(k, at * values + value, 0, one, 30)
        self.opinion(n, 2 * node, low, middle)
        self.opinion(n, 2 * node + 1, middle, high)

    def split(self, node, inside):
        n, partial = node.count, int(inside[1] < inside[0])
        if n > 12:
            expected = n * inside[0] // (inside[0] + inside[1])
            fine = max(0, ilog2(n) // 2 - 1)
            coarse = self.large.signed((min(15, ilog2(n)), node.slope))
            return expected + (coarse << fine) + self.coder.raw(fine)
        low, high, at = 0, n + 1, 1
        slope = 7 if partial else node.slope
        while high - low > 1:
            middle = low + (high - low) // 2
            place = 16 * n + at
            bit = self.small.bit((place * 2 + partial, place * 32 + 4 * slope + node.density), 0)
            low, high = (middle, high) if bit else (low, middle)
            at = 2 * at + bit
        return low


def look_around(level, corner, log, shape, axis):
    table = {tuple(n.corner[k] - corner[k] >> log[k] for k in (0, 1)): n.count for n in level}
    for node in level:
        n, at = node.count, [node.corner[k] - corner[k] >> log[k] for k in (0, 1)]

        def beside(k, step):
            other = at.copy()
            other[k] += step
            return table.get(tuple(other), 0) if 0 <= other[k] < shape[k] else n

        a, b = beside(axis, -1), beside(axis, 1)
        total = a + b + beside(1 - axis, -1) + beside(1 - axis, 1)
        q = quotient(8 * (b - a), a + b + n)
        node.slope = 0 if q <= -4 else 1 if q <= -2 else 2 if q == -1 else 3 if q == 0 else 4 if q == 1 else 5 if q <= 3 else 6
        density = total // n
        node.density = 0 if density <= 1 else 1 if density == 2 else 2 if density <= 4 else 3
        node.crowd = min(7, bits(2 * total + n))


def read_places(coder, header, corner, log, side, cells, count):
    """The squares of the group's primitives, as (logarithm of the side, corner), in order."""
    counts, out, log = Counts(coder), [], list(log)
    level = [Node(corner, count, (3, 0, 7))] if count else []
    while level:
        axis = axis_of(log)
        shape = [-(-side[k] // (1 << log[k])) for k in (0, 1)]
        if shape[0] * shape[1] <= 4 * count + 64:
            look_around(level, corner, log, shape, axis or 0)
        if log[0] == log[1] and log[0] <= header.range:
            size = clamp(quotient(16 * log[0] - cells, 8) + 12, 0, 23)
            for node in level:
                s = node.count if axis is None else 0
                full, several = min(node.count, 7), int(node.count > 1)
                while s < node.count:
                    contexts = ((size * 8 + full) * 3 + min(s, 2), (size * 8 + node.crowd) * 2 + several)
                    if not counts.stay.bit(contexts, 0):
                        break
                    s += 1
                out.extend([(log[0], node.corner)] * s)
                node.count -= s
        if axis is None:
            break
        log[axis] -= 1
        half, following = 1 << log[axis], []
        for node in level:
            if node.count == 0:
                continue
            upper = list(node.corner)
            upper[axis] += half
            inside = [clamp(header.grid[axis] - c[axis], 0, half) for c in (node.corner, upper)]
            lower = counts.split(node, inside) if inside[1] > 0 else node.count
            demand(0 <= lower <= node.count, "count of a half")
            around = (node.slope, node.density, node.crowd)
            for c, n in ((node.corner, lower), (tuple(upper), node.count - lower)):
                if n > 0:
                    following.append(Node(c, n, around))
        level = following
    return out


# §8.4 Neighbours


class Buckets:
    def __init__(self, count, corner, side):
        self.corner, log = corner, [0, 0]

        def shape():
            return [-(-side[k] // (1 << log[k])) for k in (0, 1)]

        while shape()[0] * shape()[1] > max(1, 3 * count // 8) and log[1] < 30:
            log[0 if log[0] == log[1] else 1] += 1
        self.log, self.last, self.sums = log, [s - 1 for s in shape()], {}

    def of(self, place):
        log, q = place
        out = []
        for k in (0, 1):
            u = (q[k] - self.corner[k] + ((1 << log) >> 1)) * 8 >> self.log[k]
            out.append((u >> 3, u % 8) if u >> 3 <= self.last[k] else (self.last[k], 7))
        return out

    def around(self, place):
        (cx, fx), (cy, fy) = self.of(place)
        out = [0] * 16
        for y in range(max(0, cy - 1), min(self.last[1], cy + 1) + 1):
            for x in range(max(0, cx - 1), min(self.last[0], cx + 1) + 1):
                dx, dy = 8 * (x - cx) + 4 - fx, 8 * (y - cy) + 4 - fy
                w = 4096 // (dx * dx + dy * dy + 10)
                if (x, y) in self.sums:
                    out = [o + w * s for o, s in zip(out, self.sums[x, y])]
        return out

    def add(self, place, left):
        (x, _), (y, _) = self.of(place)
        sums = [s + v for s, v in zip(self.sums.get((x, y), [0] * 16), left)]
        self.sums[x, y] = [s >> 1 for s in sums] if sums[15] >= 16 else sums


# §8.5 Shape and colour

CHANCES = {
    "major": "19 128 214 164 75 10 11 64 128 128 128 128 128 128 128 128 128 128 "
    "128 128 128 128 128 123 128 128 100 116 111 42 84 70 29 45 69 64",
    "aspect": "19 128 212 163 64 9 12 128 128 128 128 128 128 128 128 128 128 128 "
    "128 128 128 128 128 122 128 128 101 118 115 33 75 84 12 36 128 128",
    "luma": "11 128 232 202 137 49 5 25 128 128 128 128 128 128 128 128 128 128 "
    "128 128 128 128 128 128 128 128 122 125 119 83 108 101 33 79 79 25",
    "Co": "105 128 95 68 30 21 44 128 128 128 128 128 128 128 128 128 128 128 "
    "128 128 128 128 128 78 128 128 61 91 94 49 81 100 67 91 192 128",
    "Cg": "149 128 55 34 15 47 64 128 128 128 128 128 128 128 128 128 128 128 "
    "128 128 128 128 128 62 128 128 31 74 57 35 53 128 64 64 128 128",
}
CHANCES = {name: [int(c) for c in text.split()] for name, text in CHANCES.items()}
ACCORD = {2: (128, 134, 170, 182, 196, 210), 5: (128, 140, 150, 170, 188, 216), 11: (128, 135, 145, 155, 175, 200)}
MIRROR = {2: 3, 5: 6, 11: 12}
TANGENTS = [rounded(4096 * math.tan(2 * math.pi * (j + 0.5) / 64)) for j in range(16)]
UNITS = [tuple(rounded(256 * f(2 * math.pi * k / 64)) for f in (math.cos, math.sin)) for k in range(64)]


def group_class(v, c):
    return clamp(v, -c, c) + c


def level_of(v):
    return min(7, bits(v))


class Mean:
    def __init__(self, value):
        self.sum, self.count = 4 * value, 4

    def get(self):
        return self.sum // self.count

    def add(self, value):
        self.sum += value
        self.count += 1


class Slope:
    def __init__(self, xy):
        self.xy, self.xx = xy, 1 << 20

    def __call__(self, v):
        return clamp(quotient(self.xy * 256, self.xx), -1024, 1024) * v >> 8

    def add(self, u, v):
        self.xy += u * v
        self.xx += u * u
        if max(self.xx, abs(self.xy)) >= 1 << 50:
            self.xx, self.xy = self.xx >> 1, self.xy >> 1


def consensus(axis, elongation):
    x, y = axis[0] >> 8, axis[1] >> 8
    square = x * x + y * y
    fifths = sum(25 * square >= k * k * elongation * elongation for k in (1, 2, 3, 4))
    if elongation == 0:
        return 0, 0
    if fifths == 0:
        return 0, 1
    if x > 0 and y >= 0:
        quarter = 0
    elif x <= 0 and y > 0:
        quarter, x, y = 1, y, -x
    elif x < 0:
        quarter, x, y = 2, -x, -y
    else:
        quarter, x, y = 3, -y, x
    steps = sum(4096 * y >= x * t for t in TANGENTS)
    return (16 * quarter + steps) % 64, fifths + 1


def read_group(coder, header, background, book, corner, log, count):
    side = [min(header.grid[k] - corner[k], 1 << log[k]) for k in (0, 1)]
    cells = (log16(max(1, 256 * side[0] * side[1] // max(1, count))) - 128) // 2
    places = read_places(coder, header, corner, log, side, cells, count)
    buckets = Buckets(count, corner, side)
    D, finest, position = header.D, header.finest, header.position

    def scale_of(g):
        return quotient((g + 32) * 2 * FINE, D)

    spacing = scale_of(cells + 16 * finest)
    octave = 32 * FINE // D
    guesses = [spacing - octave, spacing - 3 * octave] + [FINE * b for b in background] + [0] * (4 - len(background))
    means = [Mean(g) for g in guesses]
    follow = [Slope(1 << 20) for _ in range(4)]
    cross = [[Slope(0), Slope(0)] for _ in range(4)]
    field_major = Field(coder, 72, [144, 8], 250).opinions(CHANCES["major"], (6, 6))
    field_aspect = Field(coder, 72, [40, 81], 250).opinions(CHANCES["aspect"], (3, 3))
    field_angle = Field(coder, 16, [48, 96], 250)
    for k, values in enumerate((48, 96)):
        for value in range(values):
            for node, chances in ACCORD.items():
                one, n = 256 * chances[value % 6], (6, 2)[k]
                field_angle.start(k, value, node, one, n)
                field_angle.start(k, value, MIRROR[node], 65536 - one, n)
    if book:
        index_bits = bits(len(book) - 1)
        field_index = Field(coder, max(2, 1 << index_bits), [1], 250)
    else:
        names = ("luma", "Co", "Cg", "luma")[: header.channels]
        field_colors = [Field(coder, 72, [128, 64], 250).opinions(CHANCES[n], (3, 3)) for n in names]

    out, last = [], None
    for place in places:
        l, q = place
        # What is near (§8.4).
        near = buckets.around(place)
        V, E, axis, elongation, weight = near[:6], near[6:12], near[12:14], near[14], near[15]
        mean = [m.get() for m in means]
        dev = [quotient(FINE * V[k] - mean[k] * weight, weight + 40) for k in range(6)]
        errors = [0] * 6

        # Major scale.
        e = finest + l
        o = scale_of(16 * e + 4 * position)
        f = clamp(e + 8, 0, 15)
        hint = group_class(quotient((mean[0] - o) * D, 8 * FINE), 4)
        off = field_major.signed((9 * f + hint, level_of(4 * E[0] // (weight + 40))))
        major = max(0, o + 8 >> 4) + off
        errors[0] = abs(off)
        demand(0 <= major <= header.top, "major scale")
        t = 2 * (major * D - 64 - 8 * position) - 1
        demand(clamp((t + 32) // 64, finest, header.coarsest) - finest == l, "major scale is not of this square")

        # Minor scale.
        guess = mean[1] + quotient(9 * (FINE * major - mean[0]) + 7 * dev[1] - dev[0], 16)
        expected = max(0, major - (guess + 8 >> 4))
        contexts = (min(39, expected), 9 * group_class(quotient(off, 2), 4) + group_class(dev[1] >> 5, 4))
        off = field_aspect.signed(contexts)
        minor = major - expected - off
        errors[1] = abs(off)
        demand(0 <= minor <= major, "minor scale")

        # Angle.
        n, angle = header.angle_counts[major - minor], 0
        if n > 1:
            direction, accord = consensus(axis, elongation)
            guess = (direction * n + 32) // 64 % n
            contexts = (6 * min(7, ilog2(n)) + accord, 6 * (direction // 4) + accord)
            low, high, node = 0, n, 1
            while high - low > 1 and node < 16:
                middle = low + (high - low) // 2
                bit = field_angle.bit(contexts, node)
                low, high = (middle, high) if bit else (low, middle)
                node = 2 * node + bit
            angle = (low + coder.uniform(high - low) + guess + n - n // 2) % n

        # Rest of the position.
        lx, ly = header.logs(major, minor, angle)
        x = (q[0] >> lx) + coder.raw(l - lx)
        y = (q[1] >> ly) + coder.raw(l - ly)

        # Colour.
        if book:
            index = field_index.tree((0,), index_bits)
            demand(index < len(book), "codebook index")
            color = book[index]
        else:
            color, surprises, before = [], [], 0
            z = clamp(quotient((major + minor - (spacing >> 3)) * D, 32) + 8, 0, 15)
            for k in range(header.channels):
                following = follow[k](dev[2 + k])
                pairs = list(zip(cross[k], surprises))
                guess = mean[2 + k] + following + sum(slope(s) for slope, s in pairs)
                guess = clamp(guess, -32768 * FINE, 32767 * FINE)
                activity = level_of(4 * E[2 + k] // (weight + 20))
                phase = (guess + 8) % 16 // 4
                contexts = (8 * before + activity, 16 * phase + z) if k else (8 * z + activity, 8 * phase + activity)
                off = field_colors[k].signed(contexts)
                value = (guess + 8 >> 4) + off
                demand(-32768 <= value <= 32767, "colour out of range")
                color.append(value)
                errors[2 + k] = abs(off)
                before = level_of(abs(off))
                v = FINE * value - mean[2 + k]
                follow[k].add(dev[2 + k], v)
                left = v - following
                surprises.append(left)
                for slope, s in pairs:
                    slope.add(s, left)
                    left -= slope(s)
            color = tuple(color)

        p = (x, y, major, minor, angle, color)
        header.check(p)
        key = (major, minor, angle, x, y, color)
        demand(last is None or last[0] != place or last[1] <= key, "order of primitives")
        last = (place, key)
        out.append(p)

        # What it leaves.
        values = [major, minor] + list(color) + [0] * (4 - len(color))
        for m, value in zip(means, values):
            m.add(FINE * value)
        g = (major - minor) * D
        elongated = 16 * g // (g + 32)
        ux, uy = UNITS[(64 * angle + n // 2) // n % 64]
        buckets.add(place, values + errors + [elongated * ux, elongated * uy, elongated, 1])
    return out


def read_coded(b, header):
    coder = RangeDecoder(b.take(len(b.data) - b.at, "stream"))
    field = Field(coder, 72, [6], 60)
    background = tuple(field.signed((min(k, 1),)) for k in range(header.channels))
    demand(all(-32768 <= c <= 32767 for c in background), "background out of range")
    book = None
    if header.codebook:
        book, color = [], background
        for _ in range(coder.raw(16) + 1):
            color = tuple(c + field.signed((2 + k,)) for k, c in enumerate(color))
            demand(all(-32768 <= c <= 32767 for c in color), "codebook out of range")
            demand(not book or book[-1] < color, "codebook order")
            book.append(color)
    out = read_group(coder, header, background, book, *whole_region(header), header.count)
    coder.finish()
    return background, out


# §8.6 Groups and levels

MOST_WITHOUT_GROUPS = 32768
MOST_OF_A_GROUP = 4096


def read_divisions(b, header, corner, log, count, groups):
    if count == 0:
        return
    axis = axis_of(log)
    if count <= MOST_OF_A_GROUP or axis is None or log[axis] <= header.range:
        groups.append((corner, log, count))
        return
    log = list(log)
    log[axis] -= 1
    upper = list(corner)
    upper[axis] += 1 << log[axis]
    lower = count
    if upper[axis] < header.grid[axis]:
        lower = b.varint("group size")
        demand(lower <= count, "group size")
    read_divisions(b, header, corner, log, lower, groups)
    read_divisions(b, header, tuple(upper), log, count - lower, groups)


def read_groups(b, header, lost=None):
    """Background and primitives; with a list `lost`, groups that are not intact leave their counts there."""
    start = b.at
    background = read_color(b, header.channels, "background")
    book = read_codebook(b, header)
    levels = b.varint("level count")
    demand(1 <= levels <= 8, "level count")
    sizes = [b.varint("level") for _ in range(levels)]
    demand(min(sizes) > 0 and sum(sizes) == header.count, "sizes of levels")
    demand(levels > 1 or header.count > MOST_WITHOUT_GROUPS, "levels where there is no need")
    groups = []
    for size in sizes:
        read_divisions(b, header, *whole_region(header), size, groups)
    entries = []
    for group in groups:
        length = b.varint("group length")
        entries.append((length, b.byte("largest scale of a group"), b.u32("group checksum")))
        demand(group[2] <= 8 * length + 1024, "primitives of a group")
    computed = zlib.crc32(zlib.crc32(header.bytes).to_bytes(4, "little") + b.data[start : b.at])
    demand(b.u32("directory checksum") == computed, "checksum of the directory")
    at, out = b.at, []
    for (corner, log, count), (length, largest, checksum) in zip(groups, entries):
        b.at, at = min(at, len(b.data)), at + length
        try:
            stream = b.take(length, "group")
            demand(zlib.crc32(stream) == checksum, "checksum of a group")
            coder = RangeDecoder(stream)
            part = read_group(coder, header, background, book, corner, log, count)
            coder.finish()
            demand(max(p[2] for p in part) == largest, "largest scale of a group")
        except Illegal:
            if lost is None:
                raise
            lost.append(count)
        else:
            out += part
    return background, out


# §5. The picture


def colors_of(header, colors):
    """Colour integers, one row each, to values."""
    v = np.array(colors, np.float64).reshape(-1, header.channels) * header.luma
    if header.channels >= 3:
        y, co, cg = v[:, 0].copy(), v[:, 1] * header.chroma, v[:, 2] * header.chroma
        v[:, 0], v[:, 1], v[:, 2] = y - cg / 2 + co / 2, y + cg / 2, y - cg / 2 - co / 2
    return v


def draw(header, background, primitives):
    width, height = header.size
    channels, K = header.channels, 3.5
    top, dtype = (65535, ">u2") if header.sixteen else (255, "u1")
    b = colors_of(header, [background])[0]
    colors = colors_of(header, [p[5] for p in primitives])
    shapes, weights = [], 0
    for x, y, major, minor, angle, _ in primitives:
        lx, ly = header.logs(major, minor, angle)
        cx, cy = (x + 0.5) * 2.0 ** (header.finest + lx), (y + 0.5) * 2.0 ** (header.finest + ly)
        s1, s2 = 2.0 ** (major * header.delta - 2), 2.0 ** (minor * header.delta - 2)
        phi = math.pi * angle / header.angle_counts[major - minor]
        cos, sin = math.cos(phi), math.sin(phi)
        hx, hy = K * math.hypot(s1 * cos, s2 * sin), K * math.hypot(s1 * sin, s2 * cos)
        left, right = max(0, math.floor(cx - hx)), min(width, math.ceil(cx + hx))
        above, below = max(0, math.floor(cy - hy)), min(height, math.ceil(cy + hy))
        weights += max(0, right - left) * max(0, below - above)
        shapes.append((cx, cy, s1, s2, cos, sin, left, right, above, below))
    if weights > MOST_WEIGHTS:
        raise TooMuch(f"{weights} weights to draw")
    edge = math.exp(-K * K / 2)
    out = np.empty((height, width, channels), dtype)
    rows = max(1, (1 << 22) // width)
    for start in range(0, height, rows):
        end = min(height, start + rows)
        total = np.zeros((end - start, width))
        sums = np.zeros((channels, end - start, width))
        for (cx, cy, s1, s2, cos, sin, left, right, above, below), color in zip(shapes, colors):
            above, below = max(above, start), min(below, end)
            if left >= right or above >= below:
                continue
            dx = np.arange(left, right) + 0.5 - cx
            dy = (np.arange(above, below) + 0.5 - cy)[:, None]
            u, v = (dx * cos + dy * sin) / s1, (dy * cos - dx * sin) / s2
            w = np.maximum(0, np.exp(-(u * u + v * v) / 2) - edge)
            box = np.s_[above - start : below - start, left:right]
            total[box] += w
            for k in range(channels):
                sums[k][box] += w * color[k]
        for k in range(channels):
            if header.blend_sum:
                value = b[k] + sums[k]
            else:
                value = (sums[k] + b[k] / 128) / (total + 1 / 128)
            out[start:end, :, k] = np.floor(np.clip(value, 0, 1) * top + 0.5)
    return out


def read(data, header, notes):
    """Background and primitives of a whole file."""
    b, damaged = Bytes(data[:-4], len(header.bytes)), []
    demand(len(b.data) >= b.at, "checksum is cut off")
    covered = header.bytes + (read_sections(b, damaged) if header.sections else b"")
    demand(zlib.crc32(covered + b.data[b.at :]) == int.from_bytes(data[-4:], "little"), "checksum of the file")
    notes += [f"section {name} is damaged" for name in damaged]
    demand(header.count <= 8 * (len(b.data) - b.at) + 1024, "count is too large for the payload")
    picture = [read_packed, read_planes, read_coded, read_groups][header.layout](b, header)
    demand(b.at == len(b.data), "bytes left over")
    return picture


def decode(data, partial=False):
    """The header, the samples (rows × columns × channels), and what there is to report."""
    header, notes = Header(data), []
    if math.prod(header.size) * header.channels > MOST_SAMPLES or header.count > MOST_PRIMITIVES:
        raise TooMuch(f"{header.size[0]} × {header.size[1]} pixels, {header.count} primitives")
    try:
        background, primitives = read(data, header, notes)
    except Illegal as e:
        if not partial or header.layout != 3:
            raise
        b, lost = Bytes(data, len(header.bytes)), []
        if header.sections:
            read_sections(b, [])
        background, primitives = read_groups(b, header, lost)
        notes.append(f"{e}; {sum(lost)} of {header.count} primitives in {len(lost)} groups are missing")
    return header, draw(header, background, primitives), notes


def write_pam(path, header, samples):
    kinds = {1: "GRAYSCALE", 2: "GRAYSCALE_ALPHA", 3: "RGB", 4: "RGB_ALPHA"}
    head = "P7\nWIDTH {}\nHEIGHT {}\nDEPTH {}\nMAXVAL {}\nTUPLTYPE {}\nENDHDR\n".format(
        *header.size, header.channels, 65535 if header.sixteen else 255, kinds[header.channels]
    )
    with open(path + ".part", "wb") as f:
        f.write(head.encode() + samples.tobytes())
    os.replace(path + ".part", path)


def main(arguments):
    partial = "--partial" in arguments
    files = [a for a in arguments if a != "--partial"]
    if len(files) != 2:
        print(__doc__.splitlines()[0], file=sys.stderr)
        return 2
    try:
        with open(files[0], "rb") as f:
            data = f.read()
        header, samples, notes = decode(data, partial)
        write_pam(files[1], header, samples)
    except (Illegal, TooMuch, Unsupported, OSError) as e:
        words = {Illegal: "illegal file", TooMuch: "limit exceeded", Unsupported: "not supported"}
        print(f"{files[0]}: {words.get(type(e), 'error')}: {e}", file=sys.stderr)
        return {Illegal: 4, Unsupported: 5, TooMuch: 6}.get(type(e), 3)
    for note in notes:
        print(f"{files[0]}: {note}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

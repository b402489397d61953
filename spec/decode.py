#!/usr/bin/env python3
"""Decodes a .ssplat file to PAM, in double precision: python3 decode.py [--partial] [--width W --height H] IN.ssplat OUT.pam

Written from the text of ssplat.md alone, to read beside it: section numbers are those of the text. Needs numpy, and
the zstd library (Debian: libzstd1) for the planes layout.

Exit codes: 2 wrong use, 3 reading or writing failed, 4 illegal file, 5 newer version or no zstd library, 6 over this decoder's limits.
"""

import argparse
import ctypes
import ctypes.util
import math
import os
import sys
import zlib

import numpy as np

SIGNATURE = bytes([0x89, 0x53, 0x53, 0x50])
FINE = 16

# The limits of this decoder (§9).
MOST_PRIMITIVES = 1 << 24
MOST_SAMPLES = 1 << 28
MOST_WEIGHTS = 1 << 32


class Illegal(Exception):
    """The file breaks the specification."""


class TooMuch(Exception):
    """The file may be valid but exceeds the limits of this decoder."""


class Unsupported(Exception):
    """The file has a newer version, or a library is missing."""


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
        if version != 6:
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
        self.cicp = None
        # §4
        self.top = min(255, 704 // self.D)
        self.cap = 128 if self.layout < 2 else 4096
        self.grid = [self.positions(s, self.finest) for s in self.size]
        halves = [2, 3, 4, 6][first >> 6] if self.channels > 2 else 2
        self.most = [most_color(h, second >> 4) for h in (2, halves, halves, 2)][: self.channels]
        self.angle_counts = [self.angle_count(d) for d in range(256)]
        self.steps_of = {}
        self.detail = self.exact = None

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
        """Returns lx and ly of §4.3."""
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

    def seat(self, major):
        """Returns the logarithm of the side of the square that contains such Gaussians (§8.4)."""
        t = 2 * (major * self.D - 64 - 8 * self.position) - 1
        return clamp((t + 32) // 64, self.finest, self.coarsest) - self.finest

    def check_shape(self, major, minor, angle):
        demand(0 <= minor <= major <= self.top, "scale out of range")
        demand(angle < self.angle_counts[major - minor], "angle out of range")

    def check(self, p):
        x, y, major, minor, angle, color = p
        self.check_shape(major, minor, angle)
        for v, side, log in zip((x, y), self.size, self.logs(major, minor, angle)):
            demand(v < self.positions(side, self.finest + log), "position out of range")
        self.check_color(color, "colour")

    def check_color(self, color, what):
        demand(all(abs(c) <= most for c, most in zip(color, self.most)), f"{what} out of range")


def most_color(halves, luma):
    """Returns the largest colour integer for a step of this many half luma steps (§4)."""
    return max(n for n in range(1, 1025) if (n * halves) ** 3 << luma <= 1 << 33)


def read_sections(b, header, damaged):
    """Skips all sections except `Dtal`, `Exac` and `cicp`, whose contents it stores in the header. Returns the bytes that the file's checksum covers."""
    start, covered, last = b.at, b"", b""
    count = b.varint("section count")
    demand(1 <= count <= 64, "number of sections")
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
        is_right = zlib.crc32(zlib.crc32(header.bytes).to_bytes(4, "little") + name + contents) == stored
        if name == b"Dtal":
            demand(is_right, "checksum of section Dtal")
            header.detail = DetailHead(contents, header)
        elif name == b"Exac":
            demand(is_right, "checksum of section Exac")
            header.exact = ExactHead(contents, header)
        elif name[0] < 97:
            raise Illegal(f"unknown critical section {name.decode()}")
        elif not is_right:
            damaged.append(name.decode())
        elif name == b"cicp":
            demand(len(contents) == 4, "length of section cicp")
            demand(contents[2] == 0, "matrix coefficients of section cicp")
            demand(contents[3] <= 1, "full-range flag of section cicp")
            header.cicp = tuple(contents)
    detail, exact = header.detail, header.exact
    if detail and exact:
        demand((detail.payload, detail.checksum) == (exact.payload, exact.checksum), "sections of the layers differ")
    demand(not exact or detail or exact.detail == 0, "detail length without a detail layer")
    return covered


# §6.1


def read_color(b, channels, what):
    return tuple(b.signed(what) for _ in range(channels))


def read_background(b, header):
    color = read_color(b, header.channels, "background")
    header.check_color(color, "background")
    return color


def read_codebook(b, header):
    if not header.codebook:
        return None
    size = b.varint("codebook size")
    demand(1 <= size <= 65536, "codebook size")
    book, first = [], -32768
    for _ in range(size):
        first += b.varint("codebook")
        color = (first,) + read_color(b, header.channels - 1, "codebook")
        header.check_color(color, "codebook")
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
    background = read_background(b, header)
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
        demand(all(-32768 <= c <= 32767 for c in offsets[5:]), "record format")
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


def check_frame(frame, count):
    """Checks the rules for a frame in addition to those of RFC 8878."""
    b = Bytes(frame)
    demand(b.take(5, "zstd frame") == b"\x28\xb5\x2f\xfd\0", "start of a zstd frame")
    window = b.byte("zstd frame")
    window = (1 << 10 + (window >> 3)) // 8 * (8 + (window & 7))
    demand(count <= window <= max(1024, 2 * count), "window of a zstd frame")
    plain, last = 0, False
    while not last:
        head = int.from_bytes(b.take(3, "zstd block"), "little")
        last, kind, size = head & 1, head >> 1 & 3, head >> 3
        demand(kind < 3 and size <= min(window, 1 << 17), "head of a zstd block")
        block = Bytes(b.take(1 if kind == 1 else size, "zstd block"))
        if kind < 2:
            plain += size
            demand(plain <= count, "length of a zstd frame")
            continue
        # Literals: raw, a repeated byte, or compressed.
        first = block.byte("literals")
        block.at = 0
        kind, form = first & 3, first >> 2 & 3
        if kind < 2:
            head, shift = [(1, 3), (2, 4), (1, 3), (3, 4)][form]
            size = int.from_bytes(block.take(head, "literals"), "little") >> shift
            size = size if kind == 0 else 1
        else:
            head, width = [(3, 10), (3, 10), (4, 14), (5, 18)][form]
            size = int.from_bytes(block.take(head, "literals"), "little") >> 4 + width & (1 << width) - 1
        block.take(size, "literals")
        # Sequences: their number, and the modes, which have two reserved bits.
        first = block.byte("sequences")
        if first == 0:
            demand(block.at == len(block.data), "bytes behind a zstd block")
            continue
        block.take(0 if first < 128 else 1 if first < 255 else 2, "sequences")
        demand(block.byte("sequences") & 3 == 0, "modes of a zstd block")
    demand(b.at == len(frame), "bytes behind a zstd frame")


def decompress(frame, count):
    check_frame(frame, count)
    library = zstd_library()
    demand(library.ZSTD_findFrameCompressedSize(frame, len(frame)) == len(frame), "zstd frame is broken")
    plane = ctypes.create_string_buffer(max(1, count))
    demand(library.ZSTD_decompress(plane, count, frame, len(frame)) == count, "zstd frame is broken")
    return plane.raw[:count]


def read_planes(b, header):
    background = read_background(b, header)
    book = read_codebook(b, header)
    count = header.count
    most = [8, 2, 2, 1, 1, 1] + [3] * (1 if book else header.channels)
    fields, computed = [], 0
    for limit in most:
        width = b.byte("bytes of a field")
        demand(width <= limit, "bytes of a field")
        values = np.zeros(count, np.uint64)
        for i in range(width):
            length = b.varint("plane")
            plane = b.take(length or count, "plane")
            if length:
                plane = decompress(plane, count)
            computed = zlib.crc32(plane, computed)
            values |= np.frombuffer(plane, np.uint8).astype(np.uint64) << np.uint64(8 * i)
        demand(width == 0 or count > 0 and int(values.max()) >> 8 * (width - 1) > 0, "bytes of a field")
        fields.append(values.tolist())
    demand(b.u32("checksum of the planes") == computed, "checksum of the planes")
    cells = [(g - 1 >> header.range) + 1 for g in header.grid]
    order = bits(max(cells) - 1)
    out, last, position = [], None, 0
    for row in zip(*fields):
        position += row[0]
        row = (position,) + row[1:]
        demand(last is None or last <= row, "order of Gaussians")
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

    def choose(self, below, low, high):
        """Returns the value v in low … high − 1 with below(v) ≤ target < below(v + 1), where below(low) is 0, and both bounds."""
        total = below(high)
        unit = self.range // total
        target = min(self.code // unit, total - 1)
        first, last = 0, total
        while high - low > 1:
            middle = (low + high) // 2
            at = below(middle)
            if at <= target:
                low, first = middle, at
            else:
                high, last = middle, at
        self.take(unit, first, last, total)
        return low, first, last, total

    def take(self, unit, first, last, total):
        self.code -= unit * first
        self.range = self.range - unit * first if last == total else unit * (last - first)
        self.normalize()

    def uniform(self, total):
        unit = self.range // total
        value = min(self.code // unit, total - 1)
        self.take(unit, value, value + 1, total)
        return value

    def raw(self, count):
        if count > 16:
            high = self.uniform(1 << count - 16)
            return high << 16 | self.uniform(1 << 16)
        return self.uniform(1 << count)

    def pair(self, a, b):
        if a + b <= 16:
            both = self.raw(a + b)
            return both >> b, both & (1 << b) - 1
        first = self.raw(a)
        return first, self.raw(b)

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


# §8.2 Values near a place

LOGISTIC = [rounded(65536 / (1 + math.exp(-(i - 2048) / 256))) for i in range(4097)]
INVERSE = {i: rounded(2**16 * 4096 * 2 * math.log(2) / (16 * 2 ** (i / 16 - 8))) for i in range(80, 321)}
AT_THE_MEAN = 5678


def log16(v):
    log = ilog2(v)
    return 16 * log + ((v << 4 >> log) & 15)


class Near:
    """The distribution around a place with a given spread."""

    def __init__(self, coder, place, spread):
        self.coder, self.place, self.inverse = coder, place, INVERSE[clamp(spread, 80, 320)]

    def chance(self, v):
        t = clamp((16 * v - 8 - self.place) * self.inverse >> 16, -32767, 32767) + 32768
        i = t >> 4
        return LOGISTIC[i] + ((LOGISTIC[i + 1] - LOGISTIC[i]) * (t % 16) >> 4)

    def distance(self, v):
        return min(abs(16 * v - self.place) * self.inverse >> 16, 32767)

    def chosen(self, low, count, share):
        least, floor = self.chance(low), share // count + 1
        return self.coder.choose(lambda v: self.chance(v) - least + floor * (v - low), low, low + count)

    def bounded(self, low, count, share):
        return self.chosen(low, count, share)[0]

    def open(self):
        middle = self.place + 8 >> 4

        def below(v):
            if v == -128 or v == 128:
                return 256 * (v + 128)
            return (self.chance(middle + v) * 65280 >> 16) + v + 128

        step = self.coder.choose(below, -128, 128)[0]
        if -128 < step < 127:
            return middle + step
        n = self.coder.uniform(18)
        rest = (1 << n) + self.coder.raw(n) - 1
        return middle - 128 - rest if step < 0 else middle + 127 + rest


class Gains:
    def __init__(self, *classes):
        self.kinds = [[[0, 0] for _ in range(n)] for n in classes]

    def sum(self, classes):
        return sum(kind[c][0] for kind, c in zip(self.kinds, classes)) >> 16

    def learn(self, classes, distance):
        for kind, c in zip(self.kinds, classes):
            number, count = kind[c]
            number += (distance - AT_THE_MEAN) * max(1024, 65536 // (count + 12)) >> 8
            kind[c] = [clamp(number, -(1 << 23), 1 << 23), min(count + 1, 64)]


# §8.3 Adaptive bits


class Field:
    def __init__(self, coder, nodes, values, limit):
        self.coder, self.nodes, self.limit = coder, nodes, limit
        self.p = [1 << 21] * (values * nodes)
        self.n = [0] * (values * nodes)

    def start(self, value, node, one, n):
        self.p[value * self.nodes + node] = 64 * one
        self.n[value * self.nodes + node] = n

    def bit(self, context, node):
        at = context * self.nodes + node
        p, n = self.p[at], self.n[at]
        bit = self.coder.bit(clamp(p >> 6, 32, 65504))
        target = (1 << 22) - 1 if bit else 0
        self.p[at] = p + ((target - p) * (65536 // (n + 2)) >> 16)
        self.n[at] = min(n + 1, self.limit)
        return bit

    def tree(self, context, count):
        node = 1
        for _ in range(count):
            node = 2 * node + self.bit(context, node)
        return node - (1 << count)

    def signed(self, context):
        if self.bit(context, 0):
            return 0
        negative, length, m = self.bit(context, 1), 0, 1
        while length < 16 and self.bit(context, 2 + length):
            length += 1
        if length > 0:
            m = 2 + self.bit(context, 20 + 3 * length)
        if length > 1:
            m = 2 * m + self.bit(context, 21 + 3 * length + (m & 1))
        rest = max(0, length - 2)
        m = m << rest | self.coder.raw(rest)
        return -m if negative else m


# §8.4 Positions

STAY = [251, 251, 249, 243, 222, 195, 164, 137, 102, 71, 46, 25, 13, 8, 4] + [2] * 9


def axis_of(log):
    return None if list(log) == [0, 0] else 0 if log[0] >= log[1] else 1


def whole_region(header):
    return (0, 0), [max(bits(g - 1), header.range) for g in header.grid]


def halves(corner, log, axis):
    """Returns the logarithms of the sides of both halves, and the corner of the upper half."""
    log, upper = list(log), list(corner)
    log[axis] -= 1
    upper[axis] += 1 << log[axis]
    return log, tuple(upper)


class Places:
    """Returns the squares of a group's Gaussians, as (logarithm of the side, corner), in decoding order."""

    def __init__(self, coder, header, cells):
        self.coder, self.header, self.cells, self.out = coder, header, cells, []
        self.gains = Gains(32)
        self.stay = Field(coder, 1, 72, 250)
        for size, chance in enumerate(STAY):
            none = 65536
            for n in (1, 2, 3):
                none = none * (256 - chance) >> 8
                self.stay.start(3 * size + n - 1, 0, clamp(65536 - none, 256, 65280), 6)

    def stays(self, l, n):
        size = clamp(quotient(16 * l - self.cells, 8) + 12, 0, 23)
        return self.stay.bit(3 * size + min(n, 3) - 1, 0)

    def region(self, corner, log, n):
        header, axis = self.header, axis_of(log)
        if n == 1:
            l = min(*log, header.range)
            while l > 0 and not self.stays(l, 1):
                l -= 1
            place = self.coder.pair(log[0] - l, log[1] - l)
            corner = tuple(c + (p << l) for c, p in zip(corner, place))
            demand(corner[0] < header.grid[0] and corner[1] < header.grid[1], "position out of range")
            self.out.append((l, corner))
            return
        left = n
        if log[0] == log[1] <= header.range:
            while left > 0 and (axis is None or self.stays(log[0], left)):
                left -= 1
            self.out.extend([(log[0], corner)] * (n - left))
        if left == 0:
            return
        log, upper = halves(corner, log, axis)
        inside = [clamp(header.grid[axis] - c[axis], 0, 1 << log[axis]) for c in (corner, upper)]
        lower = self.split(left, inside) if inside[1] > 0 else left
        if lower > 0:
            self.region(corner, log, lower)
        if lower < left:
            self.region(upper, log, left - lower)

    def split(self, n, inside):
        part = (inside[0] << 16) // (inside[0] + inside[1])
        if n <= 12:
            chances = [65536] + [0] * n
            for _ in range(n):
                chances = [c * (65536 - part) + b * part >> 16 for b, c in zip([0] + chances, chances)]
            sums = [0]
            for c in chances:
                sums.append(sums[-1] + c + 1)
            return self.coder.choose(sums.__getitem__, 0, n + 1)[0]
        fine, classes = max(0, ilog2(n) - 10), (ilog2(n),)
        spread = max(0, log16(n) // 2 - 16 * fine) + 120 + self.gains.sum(classes)
        near = Near(self.coder, (16 * n * part >> 16) >> fine, spread)
        coarse = near.bounded(0, (n >> fine) + 1, 64)
        self.gains.learn(classes, near.distance(coarse))
        lower = (coarse << fine) + self.coder.raw(fine)
        demand(lower <= n, "count of a half")
        return lower


def read_places(coder, header, corner, log, cells, count):
    places = Places(coder, header, cells)
    if count > 0:
        places.region(corner, log, count)
    return sorted(places.out, key=lambda place: -place[0])


# §8.5 Neighbours


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
        out = [0] * 14
        for y in range(max(0, cy - 1), min(self.last[1], cy + 1) + 1):
            for x in range(max(0, cx - 1), min(self.last[0], cx + 1) + 1):
                dx, dy = 8 * (x - cx) + 4 - fx, 8 * (y - cy) + 4 - fy
                w = 1 << ilog2(5792 // (dx * dx + dy * dy + 10))
                if (x, y) in self.sums:
                    out = [o + w * s for o, s in zip(out, self.sums[x, y])]
        return out

    def add(self, place, left):
        (x, _), (y, _) = self.of(place)
        sums = [s + v for s, v in zip(self.sums.get((x, y), [0] * 14), left)]
        self.sums[x, y] = [s >> 1 for s in sums] if sums[13] >= 16 else sums


# §8.6 Shape and colour

ERRORS = (384, 192, 128, 384)
ACCORD = (112, 112, 86, 79, 72, 63)
TANGENTS = [rounded(4096 * math.tan(2 * math.pi * (j + 0.5) / 64)) for j in range(16)]
UNITS = [tuple(rounded(256 * f(2 * math.pi * k / 64)) for f in (math.cos, math.sin)) for k in range(64)]


def group_class(v, c):
    return clamp(v, -c, c) + c


class Mean:
    def __init__(self, value):
        self.sum, self.count = 4 * value, 4

    def refresh(self):
        self.value = self.sum // self.count

    def add(self, value):
        self.sum += value
        self.count += 1


class Slope:
    def __init__(self, xy):
        self.xy, self.xx = xy, 1 << 20

    def refresh(self):
        self.slope = clamp(quotient(self.xy * 256, self.xx), -1024, 1024)

    def __call__(self, v):
        return self.slope * v >> 8

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
    places = read_places(coder, header, corner, log, cells, count)
    buckets = Buckets(count, corner, side)
    D, channels = header.D, header.channels

    def scale_of(g):
        return quotient((g + 32) * 2 * FINE, D)

    spacing = scale_of(cells + 16 * header.finest)
    octave = 32 * FINE // D
    guesses = [spacing - octave, spacing - 3 * octave] + [FINE * b for b in background] + [0] * (4 - len(background))
    means, mean_errors = [Mean(g) for g in guesses], [Mean(e) for e in ERRORS]
    follow = [Slope(1 << 20) for _ in range(4)]
    cross = [[Slope(0), Slope(0)] for _ in range(4)]
    refreshed = means + mean_errors + follow + [slope for pair in cross for slope in pair]
    majors_of = {}
    for major in range(header.top + 1):
        majors_of.setdefault(header.seat(major), []).append(major)
    gains_minor, gains_angle = Gains(40, 9, 9), Gains(8, 6, 16)
    shift, seen = [0] * 40, [0] * 40
    if book:
        index_bits = bits(len(book) - 1)
        field_index = Field(coder, max(2, 1 << index_bits), 1, 250)
    else:
        gains_colors = [Gains(16, 9, 8) for _ in range(channels)]

    out, last = [], None
    for place in places:
        l, q = place
        # The neighbours (§8.5), and the previous Gaussians.
        near = buckets.around(place)
        V, E, axis, elongation, weight = near[:6], near[6:10], near[10:12], near[12], near[13]
        if len(out) < 64 or len(out) % 8 == 0:
            for r in refreshed:
                r.refresh()
        mean = [m.value for m in means]
        trust = (1 << 24) // (weight + 40)
        dev = [(FINE * v - m * weight) * trust >> 24 for v, m in zip(V, mean)]
        errors = [0] * 4

        # Major scale.
        demand(l in majors_of, "square without a scale")
        low = majors_of[l][0]
        major = Near(coder, mean[0] + dev[0], 165).bounded(low, len(majors_of[l]), 1024)

        # Minor scale.
        e = FINE * major - mean[1] - quotient(9 * (FINE * major - mean[0]) + 10 * dev[1], 16)
        kind = clamp(e + 8 >> 4, 0, 39)
        p = e + (shift[kind] >> 16)
        classes = (kind, group_class(dev[0] >> 5, 4), group_class(dev[1] >> 5, 4))
        around = Near(coder, p, 152 + gains_minor.sum(classes))
        d = around.bounded(0, major + 1, 1024)
        minor = major - d
        gains_minor.learn(classes, around.distance(d))
        moved = shift[kind] + clamp(FINE * d - p, -64, 64) * max(1024, 65536 // (seen[kind] + 20))
        shift[kind] = clamp(moved, -(1 << 23), 1 << 23)
        seen[kind] += 1

        # Angle.
        n, angle = header.angle_counts[d], 0
        if n > 1:
            direction, accord = consensus(axis, elongation)
            p = direction * n // 4
            classes = (min(7, log16(n) >> 4), accord, direction // 4)
            around = Near(coder, p, log16(n) + gains_angle.sum(classes) + ACCORD[accord])
            v, first, end, total = around.chosen(p - 8 * n + 15 >> 4, n, 16384)
            angle = v % n
            gains_angle.learn(classes, 2 * AT_THE_MEAN * abs(first + end - total) // total)

        # The remaining bits of the position.
        lx, ly = header.logs(major, minor, angle)
        u, v = coder.pair(l - lx, l - ly)
        x, y = (q[0] >> lx) + u, (q[1] >> ly) + v

        # Colour.
        if book:
            index = field_index.tree(0, index_bits)
            demand(index < len(book), "codebook index")
            color = book[index]
        else:
            color, surprises, before = [], [], 8
            trust = (1 << 24) // (weight + 512)
            z = clamp(quotient((major + minor - (spacing >> 3)) * D, 32) + 8, 0, 15)
            a = min(7, d * D // 32)
            for k in range(channels):
                following = follow[k](dev[2 + k])
                pairs = list(zip(cross[k], surprises))
                p = mean[2 + k] + following + sum(slope(s) for slope, s in pairs)
                p = clamp(p, -32768 * FINE, 32767 * FINE)
                expected = (FINE * E[k] + 512 * mean_errors[k].value) * trust >> 24
                classes = (z, before, a)
                around = Near(coder, p, log16(max(1, expected)) + 32 + gains_colors[k].sum(classes))
                value = around.open()
                demand(abs(value) <= header.most[k], "colour out of range")
                color.append(value)
                gains_colors[k].learn(classes, around.distance(value))
                errors[k] = min(65536, abs(FINE * value - p) >> 2)
                before = min(7, bits(abs(value - (p + 8 >> 4))))
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
        demand(last is None or last[0] != place or last[1] <= key, "order of Gaussians")
        last = (place, key)
        out.append(p)

        # The prediction error.
        values = [major, minor] + list(color) + [0] * (4 - len(color))
        for m, value in zip(means + mean_errors, values + errors):
            m.add(FINE * value)
        g = d * D
        elongated = 16 * g // (g + 32)
        ux, uy = UNITS[(64 * angle + n // 2) // n % 64]
        buckets.add(place, values + errors + [elongated * ux, elongated * uy, elongated, 1])
    return out


def read_coded(b, header):
    coder = RangeDecoder(b.take(len(b.data) - b.at, "stream"))
    field = Field(coder, 72, 6, 60)
    background = tuple(field.signed(min(k, 1)) for k in range(header.channels))
    header.check_color(background, "background")
    book = None
    if header.codebook:
        book, color = [], background
        for _ in range(coder.raw(16) + 1):
            color = tuple(c + field.signed(2 + k) for k, c in enumerate(color))
            header.check_color(color, "codebook")
            demand(not book or book[-1] < color, "codebook order")
            book.append(color)
    out = read_group(coder, header, background, book, *whole_region(header), header.count)
    coder.finish()
    return background, out


# §8.7 Groups and levels

MOST_WITHOUT_GROUPS = 32768
MOST_OF_A_GROUP = 512


def read_divisions(b, header, corner, log, count, groups):
    if count == 0:
        return
    axis = axis_of(log)
    if count <= MOST_OF_A_GROUP or axis is None or log[axis] <= header.range:
        groups.append((corner, log, count))
        return
    staying = b.varint("group size")
    demand(staying <= count, "group size")
    if staying > 0:
        groups.append((corner, log, staying))
    count -= staying
    log, upper = halves(corner, log, axis)
    lower = count
    if upper[axis] < header.grid[axis]:
        lower = b.varint("group size")
        demand(lower <= count, "group size")
    read_divisions(b, header, corner, log, lower, groups)
    read_divisions(b, header, upper, log, count - lower, groups)


def read_groups(b, header, lost=None):
    """Returns background and Gaussians. With a list `lost`, damaged groups are skipped and their counts appended to it."""
    start = b.at
    background = read_background(b, header)
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
        demand(group[2] <= 8 * length + 1024, "Gaussians of a group")
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


# §11 The detail layer

TILE = 256
SIZES = 4


class DetailHead:
    """§11.1"""

    def __init__(self, contents, header):
        demand(header.layout >= 2, "layout of a file with a detail layer")
        b = Bytes(contents)
        self.payload, self.checksum = b.varint("payload length"), b.u32("payload checksum")
        self.step = int.from_bytes(b.take(2, "step"), "little")
        flags = b.byte("detail flags")
        demand(flags < 128, "detail flags")
        seen, start = flags >> 6 & 1, b.at
        # The fields by their bits: the values of the preset, and the stored values.
        presets = ([39, 32], [0, 0], [0b11_10_11_00], [0x42], [1]), ([64, 32], [48, 48], [0b11_10_11_00], [0x20], [4])
        fields = [list(b.take(len(p), "field")) if flags >> k & 1 else p for k, p in enumerate(presets[seen])]
        demand(b.at == len(contents), "bytes behind the detail head")
        lengths = [sum(len(f) for f, p in zip(fields, preset) if f != p) for preset in presets]
        shortest = 1 if lengths[1] < lengths[0] else 0
        demand(seen == shortest and len(contents) - start == lengths[seen], "contents of section Dtal are not the shortest")
        (orange, green), (luma, chroma), (sizes,), (biases,), (self.classes,) = fields
        demand(self.step > 0, "step")
        demand(orange > 0 and green > 0, "chroma steps")
        demand(1 <= self.classes <= 8, "step classes")
        self.ratio, self.slope = [16, orange, green, 16], [luma, chroma, chroma, luma]
        self.sizes = [(sizes & 3, sizes >> 2 & 3), (sizes >> 4 & 3, sizes >> 6), (sizes & 3, sizes >> 2 & 3)]
        demand(all(least <= most for least, most in self.sizes), "block sizes")
        self.bias = [biases & 15, biases >> 4]
        has_plane = flags >> 5 & 1
        demand(not has_plane or header.channels in (2, 4), "a plane of alpha without alpha")
        self.kinds = [(0, [0])] + [(1, [1, 2])] * (header.channels >= 3) + [(2, [3])] * has_plane

    def steps(self, plane, step_class, size):
        """Returns the steps of all frequencies of a block, rows × columns (§11.5)."""
        base = self.step * self.ratio[plane] // 16
        if self.classes > 1:
            base = base * (38, 54, 76, 108, 152, 215, 304, 430)[step_class] // 64
        f = np.arange(4 << size, dtype=np.int64) ** 2
        frequency = (f + f[:, None]) * 1024 >> 4 + 2 * size
        return np.maximum(1, base + (base * self.slope[plane] * frequency >> 14))


def wrapped(values):
    """Returns the value modulo 2³² as a signed integer."""
    return np.asarray(values).astype(np.int64).astype(np.int32)


# §11.2


def tile_count(header, side):
    width, height = header.size
    return -(-width // side) * -(-height // side)


def tiles_of(header, side):
    """Returns left, top, width and height of each tile."""
    width, height = header.size
    corners = [(x, y) for y in range(0, height, side) for x in range(0, width, side)]
    return [(x, y, min(side, width - x), min(side, height - y)) for x, y in corners]


def read_tiles(b, header, side, decoded, lost=None):
    """Returns what `decoded` makes of each tile's stream, with its position. With a list `lost`, damaged tiles are appended to it, and the result is None if the index is damaged."""
    count, entries = tile_count(header, side), []
    try:
        demand(count <= len(b.data) - b.at, "index of a layer is cut off")
        for _ in range(count):
            length = b.varint("length of a tile")
            entries.append((length, int.from_bytes(b.take(2, "check of a tile"), "little") if length else 0))
    except Illegal:
        if lost is None:
            raise
        return None
    tiles, at = [], b.at
    for place, (length, check) in zip(tiles_of(header, side), entries):
        b.at, at = min(at, len(b.data)), at + length
        tiles.append((place, None))
        if length == 0:
            continue
        try:
            stream = b.take(length, "tile")
            demand(zlib.crc32(stream) & 0xFFFF == check, "check of a tile")
            tiles[-1] = place, decoded(stream, header, place[2:])
        except Illegal:
            if lost is None:
                raise
            lost.append(place)
    return tiles


def detail_tiles(b, header, lost=None):
    return read_tiles(b, header, TILE, lambda *tile: Tile(*tile).additions(), lost)


def exact_tiles(b, header, lost=None):
    return read_tiles(b, header, 1 << header.exact.side, lambda *tile: ExactTile(*tile).samples(), lost)


# §11.3


class Models:
    """Adaptive bits, which start in the same state for each tile."""

    STARTS = None

    def __init__(self):
        if Models.STARTS is None:
            path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "detail-models.txt")
            with open(path) as f:
                table = np.array(f.read().split(), int).reshape(2, -1)
            at, starts = 0, {}

            def take(name, *shape):
                nonlocal at
                count = math.prod(shape)
                starts[name] = table[:, at : at + count].reshape(2, *shape)
                at += count

            take("filled", 3, SIZES, 8, 4)
            for kind in (0, 1):
                take(f"exponent{kind}", 8, 12)
                take(f"mantissa{kind}", 12, 3)
                take(f"place{kind}", SIZES, 15, 6, 4)
                take(f"more{kind}", 5, 4, 2)
                take(f"larger{kind}", 16)
                take(f"divide{kind}", SIZES, 3)
            take("class", 16, 8)
            assert at == table.shape[1]
            for name in ("exponent", "mantissa", "place", "more", "larger", "divide"):
                starts[name + "2"] = starts[name + "0"]
            starts["filled"] = np.concatenate([starts["filled"], starts["filled"][:, :1]], 1)
            Models.STARTS = starts
        self.of = {}

    def code(self, coder, name, *index):
        key = (name, *index)
        model = self.of.get(key)
        if model is None:
            one, seen = Models.STARTS[name][(slice(None), *index)].tolist()
            model = self.of[key] = [256 * one + 128, 256 * one + 128, seen]
        quick, slow, n = model
        bit = coder.bit(clamp(quick + slow >> 1, 32, 65504))
        target, pace = 65535 if bit else 0, 131072 // (2 * n + 3)
        quick += (target - quick) * min(32767, max(2730, pace)) >> 16
        slow += (target - slow) * min(32767, max(512, pace)) >> 16
        model[:] = quick, slow, min(127, n + 1)
        return bit


# §11.4


def scan_of(size):
    """Returns the places (u, v) of a block in coding order, with the zone of each."""
    side = range(4 << size)
    places = sorted(((u, v) for v in side for u in side), key=lambda p: (sum(p), p[1 - sum(p) % 2]))

    def zone(k):
        return (0, 1, 2, 2)[k] if k < 4 else 3 + 2 * (ilog2(k) - 2) + (k >> ilog2(k) - 1 & 1)

    return [(u, v, zone(k >> (0, 0, 1, 2)[size])) for k, (u, v) in enumerate(places)]


SCANS = [scan_of(size) for size in range(SIZES)]


class Tile:
    """The levels of a tile of this size in pixels; rows and columns count cells."""

    def __init__(self, stream, header, size):
        self.head, self.channels, self.pixels = header.detail, header.channels, size
        self.coder, self.models = RangeDecoder(stream), Models()
        across, down = self.cells = [8 * -(-side // 32) for side in size]
        self.sizes = np.zeros((3, down, across), int)
        self.dense = np.zeros((4, down, across), int)
        self.classes = np.zeros((down // 8, across // 8), int)
        self.blocks = []  # plane, column, row, size, class, levels
        for y in range(0, down, 8):
            for x in range(0, across, 8):
                self.superblock(x, y)
        demand(self.blocks, "a tile without levels")
        self.coder.finish()

    def bit(self, *model):
        return self.models.code(self.coder, *model)

    def superblock(self, x, y):
        i, j = x // 8, y // 8
        if self.head.classes > 1:
            near = [self.classes[j, i - 1]] * (i > 0) + [self.classes[j - 1, i]] * (j > 0) or [1]
            near, value = int(near[0] + near[-1]), 0
            while value < self.head.classes - 1 and self.bit("class", near, value):
                value += 1
            self.classes[j, i] = value
        for kind, planes in self.head.kinds:
            self.square(kind, planes, x, y, 3)

    def square(self, kind, planes, x, y, size):
        least, most = self.head.sizes[kind]
        n = 1 << size
        divided = size > most
        if least < size <= most:
            sizes = self.sizes[kind]
            smaller = int(y > 0 and sizes[y - 1, x] < size) + int(x > 0 and sizes[y, x - 1] < size)
            divided = self.bit(f"divide{kind}", size, smaller)
        if divided:
            half = n // 2
            for cx, cy in ((x, y), (x + half, y), (x, y + half), (x + half, y + half)):
                self.square(kind, planes, cx, cy, size - 1)
            return
        self.sizes[kind, y : y + n, x : x + n] = size
        for plane in planes:
            levels = self.block(kind, plane, x, y, size)
            if levels:
                step_class = int(self.classes[y // 8, x // 8])
                self.blocks.append((plane, x, y, size, step_class, levels))
            self.dense[plane, y : y + n, x : x + n] = len(levels) * 1024 // (4 * n) ** 2

    def block(self, kind, plane, x, y, size):
        """Returns the levels of a block by their places (u, v)."""
        n, dense = 1 << size, self.dense[plane]
        near = list(dense[y - 1, x : x + n]) * (y > 0) + list(dense[y : y + n, x - 1]) * (x > 0)
        bucket = min(7, bits(-(-int(sum(near)) * 4 * (4 * n) ** 2 // (1024 * len(near))))) if near else 2
        others = 0
        if plane in (1, 2):
            luma = 16 * int(self.dense[0, y : y + n, x : x + n].sum()) // 1024
            others = min(3, bits(luma)) if plane == 1 else int(luma > 1) + 2 * int(self.dense[1, y, x] != 0)
        if not self.bit("filled", plane, size, bucket, others):
            return {}
        # Their number.
        e, count = 0, 1
        while e < 4 + 2 * size and self.bit(f"exponent{kind}", bucket, e):
            e += 1
        if e > 0:
            count = 2 + self.bit(f"mantissa{kind}", e, 0)
        if e > 1:
            count = 2 * count + self.bit(f"mantissa{kind}", e, 1 + (count & 1))
        for _ in range(e - 2):
            count = 2 * count + self.coder.bit(32768)
        places = len(SCANS[size])
        demand(count <= places, "levels of a block")
        # Their places, and the levels.
        levels, left = {}, count
        size_at = lambda u, v: abs(levels.get((u, v), 0))
        for k, (u, v, zone) in enumerate(SCANS[size]):
            w = 2 * (size_at(u - 1, v) + size_at(u, v - 1)) + size_at(u - 1, v - 1) + size_at(u - 2, v) + size_at(u, v - 2)
            near = min(3, (w + 1) // 2)
            if left < places - k and not self.bit(f"place{kind}", size, zone, min(5, bits(left - 1)), near):
                continue
            magnitude = 1
            if self.bit(f"more{kind}", min(4, zone // 3), near, int(count > 4)):
                magnitude = self.larger(kind)
            levels[u, v] = -magnitude if self.coder.bit(32768) else magnitude
            left -= 1
            if left == 0:
                break
        return levels

    def larger(self, kind):
        a = 2
        while a < 15:
            if not self.bit(f"larger{kind}", a):
                return a
            a += 1
        e, rest = 0, 0
        while e < 15 and self.coder.bit(32768):
            e += 1
        for _ in range(e):
            rest = 2 * rest + self.coder.bit(32768)
        magnitude = 14 + (1 << e) + rest
        demand(magnitude <= 32767, "level")
        return magnitude

    # §11.5

    def additions(self):
        """Returns the additions to the pixels, rows × columns × channels, in 1/32 of an 8-bit code value."""
        across, down = self.cells
        planes = np.zeros((4, 4 * down, 4 * across), np.int32)
        for plane, x, y, size, step_class, levels in self.blocks:
            n, steps = 4 << size, self.head.steps(plane, step_class, size)
            coefficients = np.zeros((n, n), np.int32)
            for (u, v), level in levels.items():
                units = 32 * abs(level) - self.head.bias[abs(level) > 1]
                value = int(wrapped(units * int(steps[v, u]) + 64)) >> 7
                coefficients[v, u] = -value if level < 0 else value
            planes[plane, 4 * y : 4 * y + n, 4 * x : 4 * x + n] = inverse_transform(coefficients)
        for kind, of_kind in self.head.kinds:
            for plane in of_kind:
                lap(planes[plane], self.sizes[kind])
                lap(planes[plane].T, self.sizes[kind].T)
        width, height = self.pixels
        y, o, g, a = planes[:, :height, :width]
        y = y + y
        colors = [y - g + o, y + g, y - g - o] if self.channels >= 3 else [y]
        alphas = [a + a] if self.channels in (2, 4) else []
        return np.stack([np.clip(c, -32768, 32767) for c in colors + alphas], -1)


def inverse_transform(x):
    n = len(x)
    cosine = lambda j: math.floor(2048 * math.cos(j * math.pi / 64) + 0.5)
    rows = [[cosine(16 if k == 0 else (2 * i + 1) * k * 32 // n % 128) for i in range(n)] for k in range(n)]
    T, log = np.array(rows, np.int32), ilog2(n)
    down = T.T @ x + np.int32(1024) >> 11
    return down @ T + np.int32(1 << 9 + log) >> 10 + log


def lap(plane, sizes):
    """Joins blocks across the edges between rows, in place."""
    for y in range(1, len(sizes)):
        edge = np.repeat(sizes[y], 4)
        at = y % (1 << edge) == 0
        x0, x1, x2, x3 = plane[4 * y - 2 : 4 * y + 2, at]
        e0, e1, d0, d1 = x1 + x2, x0 + x3, x1 - x2, x0 - x3
        m0 = 3784 * d0 - 1567 * d1 + 2048 >> 12
        m1 = 1567 * d0 + 3784 * d1 + 2048 >> 12
        plane[4 * y - 2 : 4 * y + 2, at] = [e1 + m1 + 1 >> 1, e0 + m0 + 1 >> 1, e0 - m0 + 1 >> 1, e1 - m1 + 1 >> 1]


# §11.6


def shares(side, pixels):
    """Returns the weights of the pixels along an axis for each output pixel, as a matrix."""
    step, out = side / pixels, np.zeros((pixels, side))
    for i in range(pixels):
        if step <= 1:
            at = clamp((i + 0.5) * step - 0.5, 0, side - 1)
            first = min(int(at), side - 1)
            out[i, first] = 1 - (at - first)
            if at > first:
                out[i, first + 1] = at - first
        else:
            for x in range(int(i * step), min(side, math.ceil((i + 1) * step))):
                out[i, x] = (min(x + 1, (i + 1) * step) - max(x, i * step)) / step
    return out


def additions(header, tiles, size):
    """Returns the additions to the samples of the whole picture at this size: rows × columns × channels, where 1 is white."""
    width, height = header.size
    whole = np.zeros((height, width, header.channels))
    for (x, y, across, down), added in tiles:
        if added is not None:
            whole[y : y + down, x : x + across] = added / (32 * 255)
    if tuple(size) == (width, height):
        return whole
    whole = np.tensordot(shares(height, size[1]), whole, 1)
    return np.moveaxis(np.tensordot(shares(width, size[0]), np.moveaxis(whole, 1, 0), 1), 0, 1)


# §12. The exact layer

EXACT_CELL = 8
MASK32, MASK64 = 2**32 - 1, 2**64 - 1
NEIGHBOURS = (
    [(-1, 0), (0, -1), (-1, -1), (1, -1), (-2, 0), (0, -2), (-2, -1), (2, -1), (-1, -2), (1, -2)]
    + [(-3, 0), (0, -3), (-2, -2), (2, -2), (-3, -1), (3, -1), (-1, -3), (1, -3), (-4, 0), (-3, -2)]
    + [(3, -2), (-2, -3), (2, -3), (4, -1), (-4, -1), (0, -4), (-5, 0), (4, -2), (-4, -2), (-1, -4)]
)
LENGTHS = 30, 18, 10, 6, 3


class ExactHead:
    """§12.1"""

    def __init__(self, contents, header):
        demand(header.layout >= 2, "layout of a file with an exact layer")
        b = Bytes(contents)
        self.payload, self.checksum = b.varint("payload length"), b.u32("payload checksum")
        self.detail, self.side = b.varint("detail length"), b.byte("side")
        demand(b.at == len(contents), "bytes behind the exact head")
        demand(5 <= self.side <= 11, "side of the exact tiles")


# §12.3


def hashed(v):
    v = v * 0x9E3779B97F4A7C15 & MASK64
    return (v ^ v >> 29) * 0xD6E8FEB86659FD93 & MASK64


def key(color):
    return (color * 0x9E3779B97F4A7C15 & MASK64) >> 32


def factors():
    m = 0x2545F491
    for _ in NEIGHBOURS:
        m = m * 0x9E3779B1 & MASK32 | 1
        yield m


FACTORS = list(factors())
LOGITS = [next((i for i in range(4096) if LOGISTIC[i] >= 16 * p + 8), 4095) - 2048 for p in range(4096)]


def learnt(counter, bit):
    """Returns a counter, as a pair of its probability and its count, after a bit."""
    p, n = counter
    return p + (((4095 * bit - p) * (131072 // (2 * n + 3)) + 32768) >> 16), min(15, n + 1)


class AdaptiveBits:
    """Adaptive bits that start alike, by context."""

    def __init__(self, coder, start):
        self.coder, self.start, self.of = coder, start, {}

    def code(self, *context):
        one, seen = self.start(*context)
        model = self.of.setdefault(context, [256 * one + 128, 256 * one + 128, seen])
        quick, slow, n = model
        bit = self.coder.bit(clamp(quick + slow >> 1, 32, 65504))
        target, pace = 65535 * bit, 131072 // (2 * n + 3)
        quick += (target - quick) * min(32767, max(2730, pace)) >> 16
        slow += (target - slow) * min(32767, max(512, pace)) >> 16
        model[:] = quick, slow, min(127, n + 1)
        return bit


# §12.4


class ExactTile:
    def __init__(self, stream, header, size):
        self.coder = coder = RangeDecoder(stream)
        self.width, self.height = size
        self.channels, self.bits = header.channels, 16 if header.sixteen else 8
        self.white = sum((1 << self.bits) - 1 << 16 * k for k in range(self.channels))
        self.address = clamp(ilog2(self.width * self.height) + 2, 10, 16)
        self.whole = AdaptiveBits(coder, lambda *_: (240, 0))
        self.longer = AdaptiveBits(coder, lambda *_: (128, 0))
        self.follows = AdaptiveBits(coder, lambda o, misses, equal, confidence, shorter: (255 - 150 // (confidence + 2), 1))
        self.equals = AdaptiveBits(coder, lambda *_: (128, 0))
        self.entries = [{} for _ in LENGTHS]
        self.lines, self.counters, self.weights = {}, {}, {}
        self.runs = 0, 0
        self.rows = []
        self.covered = self.mask()
        for y in range(self.height):
            self.rows.append([])
            self.row(y)
        coder.finish()

    def mask(self):
        """Returns whether the layer covers each pixel, by rows."""
        if not AdaptiveBits(self.coder, lambda: (4, 0)).code():
            return [[1] * self.width for _ in range(self.height)]
        across, down = -(-self.width // EXACT_CELL), -(-self.height // EXACT_CELL)
        models = AdaptiveBits(self.coder, lambda *_: (128, 0))
        cells = []
        for y in range(down):
            cells.append([])
            for x in range(across):
                cells[y].append(models.code(cells[y][x - 1] if x else 1, cells[y - 1][x] if y else 1))
        demand(0 < sum(map(sum, cells)) < across * down, "covered cells of an exact tile")
        return [[cells[y // EXACT_CELL][x // EXACT_CELL] for x in range(self.width)] for y in range(self.height)]

    def at(self, x, y, current):
        """Returns the colour at a place, while row `current` is coded."""
        if y < 0:
            return self.white
        row = self.rows[y]
        if x < 0:
            return row[0] if y < current else self.at(0, y - 1, current)
        return row[min(x, self.width - 1)]

    def row(self, y):
        row, ended = self.rows[y], False
        while len(row) < self.width:
            x = len(row)
            near = [self.at(x + dx, y + dy, y) for dx, dy in NEIGHBOURS[:6]]
            if not self.covered[y][x]:
                row.append(near[0])
            elif not ended and len({*near, self.at(x + 2, y - 1, y)}) == 1:
                most = 1
                while x + most < self.width and self.covered[y][x + most] and self.at(x + most + 1, y - 1, y) == near[0]:
                    most += 1
                length = self.run(most)
                row += [near[0]] * length
                ended = length < most
            else:
                self.color(x, y, near, [near[0]] if ended else [])
                ended = False

    def run(self, most):
        largest = min(15, ilog2(most))
        whole = self.whole.code(largest, *self.runs)
        self.runs = self.runs[1], whole
        if whole:
            return most
        e = 0
        while e < largest and self.longer.code(largest, e):
            e += 1
        number = 1
        for _ in range(e):
            number = 2 * number + self.coder.bit(32768)
        demand(number - 1 < most, "length of a run")
        return number - 1

    # §12.5

    def color(self, x, y, near, excluded):
        contexts = []
        total, first = 0, 0
        for length in reversed(LENGTHS):
            for k in range(first, length):
                dx, dy = NEIGHBOURS[k]
                total += key(self.at(x + dx, y + dy, y)) * FACTORS[k]
            first = length
            s = total & MASK32
            t = (s ^ s >> 15) * 0x2C1B3C6D & MASK32
            h = t ^ t >> 13
            contexts.insert(0, (h >> 32 - self.address, h & 0xFFFF | 1))
        color = self.predicted(contexts, near, excluded)
        if color is None:
            color = self.literal(near)
            demand(color not in excluded, "literal colour that was excluded")
        self.rows[y].append(color)
        for table, (place, check) in zip(self.entries, contexts):
            entry = table.get(place)
            if entry is not None and entry[1] == check and entry[0] == color:
                entry[2] = min(63, entry[2] + 1)
            elif entry is not None and entry[1] == check and entry[2] >= 4:
                entry[2] //= 2
            else:
                table[place] = [color, check, 0]

    def predicted(self, contexts, near, excluded):
        found = []
        for table, (place, check) in zip(self.entries, contexts):
            entry = table.get(place)
            found.append(entry if entry is not None and entry[1] == check else None)
        w, n, nw, ne, ww, nn = near
        misses = 0
        for o, entry in enumerate(found):
            if entry is None or entry[0] in excluded:
                continue
            color, shorter = entry[0], found[o + 1] if o < 4 else None
            agrees = 0 if shorter is None else 1 if shorter[0] == color else 2
            if self.follows.code(o, min(3, misses), (color == w) + 2 * (color == n), entry[2], agrees):
                return color
            excluded.append(color)
            misses += 1
        pattern = (w == n) + 2 * (w == nw) + 4 * (n == nw) + 8 * (n == ne) + 16 * (ww == w) + 32 * (nn == n)
        for k, color in enumerate((w, n, nw, ne)):
            if color not in excluded:
                if self.equals.code(k, pattern, min(3, misses)):
                    return color
                excluded.append(color)
        return None

    # §12.6

    def literal(self, near):
        sample = lambda color, k: color >> 16 * k & 0xFFFF
        color, residual, top = 0, 0, (1 << self.bits) - 1
        q = lambda v: bits(v >> self.bits - 8)
        med = lambda w, n, nw: clamp(w + n - nw, min(w, n), max(w, n))
        for step, k in enumerate([(0,), (1, 0), (1, 0, 2), (3, 1, 0, 2)][self.channels - 1]):
            by_green = self.channels >= 3 and k in (0, 2)
            w, n, nw, ne, ww, nn = (sample(c, k) - (sample(c, 1) if by_green else 0) for c in near)
            base = sample(color, 1) if by_green else 0
            p = [base + med(w, n, nw), base + (w + n + (ne - nw >> 1) + 1 >> 1), base + w + ne - n]
            if by_green and k == 2:
                p[1] = sample(color, 0) + med(*(sample(c, 2) - sample(c, 0) for c in near[:3]))
            p = [clamp(v, 0, top) for v in p]
            edges, far = abs(w - nw) + abs(n - nw) + abs(n - ne), abs(w - ww) + abs(n - nn)
            if step == 0:
                a = q(edges + far), q(far), q(edges)
            else:
                a = q(edges + far), q(residual) + q(edges), q(residual)
            value = self.sample(step, color, p, [min(15, v) for v in a])
            residual = abs(value - p[0])
            color |= value << 16 * k
        return color

    def sample(self, step, color, p, a):
        value = 0
        for bit in reversed(range(self.bits)):
            if (bit + 1) % 4 == 0:
                h = hashed(hashed(color) ^ (64 * step + bit + 1) << 32 ^ value)
                check, node = h & 0xFFFF | 1, 1
                line = self.lines.get(h >> 64 - self.address)
                if line is None or line[0] != check:
                    line = self.lines[h >> 64 - self.address] = [check] + [(2048, 0)] * 15
            middle = value + (1 << bit)
            places = []
            for i in range(3):
                d = p[i] - middle
                v = d if d >= 0 else -1 - d
                k = v if v < 2 else 2 * ilog2(v) + (v >> ilog2(v) - 1 & 1)
                start = 2048 + 110 * min(15, k) if d >= 0 else 2047 - 110 * min(15, k)
                places.append((i, step, bit, a[i], d >= 0, k))
                self.counters.setdefault(places[i], (start, 1))
            counters = [line[node]] + [self.counters[place] for place in places]
            logits = [LOGITS[c[0]] for c in counters]
            weights = self.weights.setdefault((step, bit, min(7, line[node][1])), [28000] * 4)
            x = sum(l * (u >> 4) for l, u in zip(logits, weights)) >> 12
            one = clamp(LOGISTIC[clamp(x, -2047, 2047) + 2048], 32, 65504)
            is_one = self.coder.bit(one)
            error = 65536 * is_one - one
            weights[:] = [clamp(u + (l * error + 8192 >> 14), 1 - 2**19, 2**19 - 1) for l, u in zip(logits, weights)]
            line[node] = learnt(line[node], is_one)
            for place in places:
                self.counters[place] = learnt(self.counters[place], is_one)
            node, value = 2 * node + is_one, value + (is_one << bit)
        return value

    def samples(self):
        """Returns the samples, rows × columns × channels, and whether each pixel is covered."""
        colors = np.array(self.rows, np.uint64)
        parts = [colors >> np.uint64(16 * k) & np.uint64(0xFFFF) for k in range(self.channels)]
        return np.stack(parts, -1).astype(np.int64), np.array(self.covered, bool)


# §12.7


def boxes(side, pixels):
    """Returns the parts of each output pixel that the pixels along an axis fill, as a matrix."""
    step, out = side / pixels, np.zeros((pixels, side))
    for i in range(pixels):
        start, end = clamp(i * step, 0, side), clamp((i + 1) * step, 0, side)
        first = min(int(start), side - 1)
        for x in range(first, max(first + 1, min(side, math.ceil(end)))):
            out[i, x] = (min(x + 1, end) - max(x, start)) / (end - start)
    return out


def cover(header, below, tiles, size):
    """Returns the picture at this size: the samples `below`, and the exact tiles over them."""
    (width, height), top = header.size, 65535 if header.sixteen else 255
    values = np.zeros((height, width, header.channels), np.int64)
    covered = np.zeros((height, width), bool)
    for (x, y, across, down), tile in tiles:
        if tile is not None:
            values[y : y + down, x : x + across], covered[y : y + down, x : x + across] = tile
    if tuple(size) == (width, height):
        return np.where(covered[..., None], values, below).astype(below.dtype)
    mean = lambda v: boxes(height, size[1]) @ v @ boxes(width, size[0]).T
    part, out, view = mean(covered.astype(float)), below.copy(), below / top
    alpha = header.channels % 2 == 0
    share = (values[..., -1] / top + 2.0**-12) * covered if alpha else covered.astype(float)
    rest = np.maximum(0, 1 - part)
    under = rest * (view[..., -1] + 2.0**-12) if alpha else rest
    for k in range(header.channels):
        v = values[..., k] / top
        if alpha and k == header.channels - 1:
            mixed = mean(v * covered) + rest * view[..., k]
        else:
            total = mean(share) + under
            mixed = (mean(v * share) + under * view[..., k]) / np.where(total > 0, total, 1)
        code = np.floor(np.clip(mixed, 0, 1) * top + 0.5)
        out[..., k] = np.where(part > 0, code, below[..., k])
    return out


# §5. The picture


def colors_of(header, colors):
    """Converts colour integers, one row per colour, to values."""
    v = np.array(colors, np.float64).reshape(-1, header.channels) * header.luma
    if header.channels >= 3:
        y, co, cg = v[:, 0].copy(), v[:, 1] * header.chroma, v[:, 2] * header.chroma
        v[:, 0], v[:, 1], v[:, 2] = y - cg / 2 + co / 2, y + cg / 2, y - cg / 2 - co / 2
    return v


def low_pass(side, pixels):
    """Returns the number of samples of an output pixel, their distance, and the increase of the variance, along one axis (§5.5)."""
    step = side / pixels
    k = next((k for k in (1, 2, 4) if step / k <= 1.5), 8)
    distance = step / k
    return k, distance, max(0.0, distance * distance - 1) / 12


class Shape:
    """A Gaussian in the form in which it is sampled."""

    def __init__(self, header, gaussian, grid):
        x, y, major, minor, angle, _ = gaussian
        lx, ly = header.logs(major, minor, angle)
        self.cx, self.cy = (x + 0.5) * 2.0 ** (header.finest + lx), (y + 0.5) * 2.0 ** (header.finest + ly)
        self.s1, self.s2 = s1, s2 = 2.0 ** (major * header.delta - 2), 2.0 ** (minor * header.delta - 2)
        phi = math.pi * angle / header.angle_counts[major - minor]
        self.cos, self.sin = cos, sin = math.cos(phi), math.sin(phi)
        (_, dx, qx), (_, dy, qy) = grid
        self.xx, self.yy = (s1 * cos) ** 2 + (s2 * sin) ** 2, (s1 * sin) ** 2 + (s2 * cos) ** 2
        self.xy = (s1 * s1 - s2 * s2) * sin * cos
        self.widened = qx > 0 or qy > 0
        self.det = (s1 * s2) ** 2 + qx * self.yy + qy * self.xx + qx * qy
        self.xx, self.yy = self.xx + qx, self.yy + qy
        hx, hy = 3.5 * math.sqrt(self.xx), 3.5 * math.sqrt(self.yy)
        self.columns = math.floor((self.cx - hx) / dx), math.ceil((self.cx + hx) / dx)
        self.rows = math.floor((self.cy - hy) / dy), math.ceil((self.cy + hy) / dy)

    def weights(self, x, y):
        """Returns the weights at the points with these columns and rows (§5.2, §5.5)."""
        dx, dy = x - self.cx, (y - self.cy)[:, None]
        edge = math.exp(-3.5 * 3.5 / 2)
        if not self.widened:
            u, v = (dx * self.cos + dy * self.sin) / self.s1, (dy * self.cos - dx * self.sin) / self.s2
            return np.maximum(0, np.exp(-(u * u + v * v) / 2) - edge)
        lean = dy - dx * (self.xy / self.xx)
        squared = dx * dx / self.xx + lean * lean * (self.xx / self.det)
        return self.s1 * self.s2 / math.sqrt(self.det) * np.maximum(0, np.exp(-squared / 2) - edge)


def draw(header, background, gaussians, tiles, size=None):
    """Returns the samples of the whole picture, rows × columns × channels, at its own size or another, with the additions of a detail layer."""
    width, height = size or header.size
    grid = low_pass(header.size[0], width), low_pass(header.size[1], height)
    (across, dx, _), (down, dy, _) = grid
    channels = header.channels
    top, dtype = (65535, ">u2") if header.sixteen else (255, "u1")
    b = colors_of(header, [background])[0]
    colors = colors_of(header, [p[5] for p in gaussians])
    shapes, weights = [Shape(header, p, grid) for p in gaussians], 0
    for s in shapes:
        s.columns = max(0, s.columns[0]), min(width * across, s.columns[1])
        s.rows = max(0, s.rows[0]), min(height * down, s.rows[1])
        weights += max(0, s.columns[1] - s.columns[0]) * max(0, s.rows[1] - s.rows[0])
    if weights > MOST_WEIGHTS:
        raise TooMuch(f"{weights} weights to draw")
    out = np.empty((height, width, channels), dtype)
    added = additions(header, tiles, (width, height)) if tiles else np.zeros((height, 1, 1))
    rows = max(1, (1 << 22) // (width * across * down))
    for first in range(0, height, rows):
        last = min(height, first + rows)
        start, end = first * down, last * down
        total = np.zeros((end - start, width * across))
        sums = np.zeros((channels, *total.shape))
        for s, color in zip(shapes, colors):
            (left, right), (above, below) = s.columns, (max(s.rows[0], start), min(s.rows[1], end))
            if left >= right or above >= below:
                continue
            w = s.weights((np.arange(left, right) + 0.5) * dx, (np.arange(above, below) + 0.5) * dy)
            box = np.s_[above - start : below - start, left:right]
            total[box] += w
            for k in range(channels):
                sums[k][box] += w * color[k]
        ground = b.reshape(-1, 1, 1)
        values = ground + sums if header.blend_sum else (sums + ground / 128) / (total + 1 / 128)
        values = np.clip(values, 0, 1)
        if across > 1 or down > 1:
            mean = lambda v: v.reshape(len(v), last - first, down, width, across).mean((2, 4))
            if channels in (2, 4):
                alpha = values[-1:]
                share = alpha + 2.0**-12
                values = np.concatenate([mean(values[:-1] * share) / mean(share), mean(alpha)])
            else:
                values = mean(values)
        values = np.clip(values + np.moveaxis(added[first:last], -1, 0), 0, 1)
        out[first:last] = np.moveaxis(np.floor(values * top + 0.5), 0, -1)
    return out


def payload(b, header):
    """Returns the bytes of the Gaussians: all remaining bytes, or those before the layers, which have a separate checksum (§11.1)."""
    head = header.detail or header.exact
    if head is None:
        return Bytes(b.data, b.at)
    start = b.at
    taken = b.take(head.payload, "payload")
    demand(zlib.crc32(header.bytes + taken) == head.checksum, "checksum of the payload")
    return Bytes(b.data[: b.at], start)


def read_gaussians(b, header):
    demand(header.count <= 8 * (len(b.data) - b.at) + 1024, "count is too large for the payload")
    picture = [read_packed, read_planes, read_coded, read_groups][header.layout](b, header)
    demand(b.at == len(b.data), "bytes left over")
    return picture


def read(data, header, notes):
    """Returns background, Gaussians, and the tiles of both layers of an intact file."""
    b, damaged = Bytes(data[:-4], len(header.bytes)), []
    demand(len(b.data) >= b.at, "checksum is cut off")
    covered = header.bytes + (read_sections(b, header, damaged) if header.sections else b"")
    demand(zlib.crc32(covered + b.data[b.at :]) == int.from_bytes(data[-4:], "little"), "checksum of the file")
    notes += [f"section {name} is damaged" for name in damaged]
    if header.cicp:
        notes.append("code points {} (primaries, transfer, matrix, full range)".format(", ".join(map(str, header.cicp))))
    part = payload(b, header)
    background, gaussians = read_gaussians(part, header)
    b.at, tiles, exact = part.at, [], []
    if header.detail:
        start = b.at
        tiles = detail_tiles(b, header)
        demand(not header.exact or b.at == start + header.exact.detail, "detail length")
    if header.exact:
        exact = exact_tiles(b, header)
    demand(b.at == len(b.data), "bytes left over")
    return background, gaussians, tiles, exact


def read_what_is_left(data, header, notes):
    """Returns the same for a damaged file (§9, §11.7)."""
    b, lost, tiles, exact, gone = Bytes(data, len(header.bytes)), [], [], [], []
    if header.sections:
        read_sections(b, header, [])
    if header.layout == 3:
        head = header.detail or header.exact
        end = len(data) if head is None else min(len(data), b.at + head.payload)
        background, gaussians = read_groups(Bytes(data[:end], b.at), header, lost)
        b.at = end
        notes.append(f"{sum(lost)} of {header.count} Gaussians in {len(lost)} groups are missing")
    else:
        part = payload(b, header)
        background, gaussians = read_gaussians(part, header)
        b.at = part.at
    start = b.at
    if header.detail:
        end = len(data) if header.exact is None else min(len(data), start + header.exact.detail)
        tiles, count = detail_tiles(Bytes(data[:end], start), header, gone), tile_count(header, TILE)
        notes.append(f"{count if tiles is None else len(gone)} of {count} tiles of the detail layer are missing")
    if header.exact:
        b.at, gone = min(len(data), start + header.exact.detail), []
        exact, count = exact_tiles(b, header, gone), tile_count(header, 1 << header.exact.side)
        notes.append(f"{count if exact is None else len(gone)} of {count} tiles of the exact layer are missing")
    return background, gaussians, tiles or [], exact or []


def decode(data, partial=False, size=None):
    """Returns the header, the samples (rows × columns × channels), and the messages to report."""
    header, notes = Header(data), []
    if math.prod(size or header.size) * header.channels > MOST_SAMPLES or header.count > MOST_PRIMITIVES:
        width, height = size or header.size
        raise TooMuch(f"{width} × {height} pixels, {header.count} Gaussians")
    try:
        picture = read(data, header, notes)
    except Illegal as e:
        if not partial or header.layout != 3 and header.detail is None and header.exact is None:
            raise
        notes.append(str(e))
        picture = read_what_is_left(data, header, notes)
    *layers, exact = picture
    samples = draw(header, *layers, size)
    if exact:
        samples = cover(header, samples, exact, size or header.size)
    return header, samples, notes


def write_pam(path, header, samples):
    kinds = {1: "GRAYSCALE", 2: "GRAYSCALE_ALPHA", 3: "RGB", 4: "RGB_ALPHA"}
    head = "P7\nWIDTH {}\nHEIGHT {}\nDEPTH {}\nMAXVAL {}\nTUPLTYPE {}\nENDHDR\n".format(
        samples.shape[1], samples.shape[0], header.channels, 65535 if header.sixteen else 255, kinds[header.channels]
    )
    with open(path + ".part", "wb") as f:
        f.write(head.encode() + samples.tobytes())
    os.replace(path + ".part", path)


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--partial", action="store_true", help="draw what is intact of a damaged file")
    parser.add_argument("--width", type=int, help="width of the output, with --height")
    parser.add_argument("--height", type=int, help="height of the output, with --width")
    parser.add_argument("files", nargs=2)
    try:
        asked = parser.parse_args(arguments)
    except SystemExit as e:
        return e.code
    files, size = asked.files, (asked.width, asked.height)
    if any(size) and not all(side and 1 <= side <= 1 << 20 for side in size):
        print("--width and --height go together, 1 to 1048576", file=sys.stderr)
        return 2
    try:
        with open(files[0], "rb") as f:
            data = f.read()
        header, samples, notes = decode(data, asked.partial, size if any(size) else None)
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

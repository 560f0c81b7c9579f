"""Mutations of logs: of bytes, and of what the bytes mean, with lengths and checksums made right.

A log is taken apart into records (opcode, body); a chunk's records are those of the log. Every
function takes a `random.Random` and returns what it changed anew, so that a seed replays a case.
"""

from __future__ import annotations

import re
import struct
import zlib

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
NUMBERS = (0, 1, 2, 3, 7, 127, 128, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**40)
DOUBLES = (0.0, -0.0, float("nan"), float("inf"), -float("inf"), 1e308, -1e300, 5e-324, 1e12, -1.0)
WORDS = (
    "int8", "uint64", "float32", "float64", "string", "wstring", "bool", "char", "p/Foo", "Header",
    "float64[36]", "float64[0]", "float64[]", "string[]", "int8[999999999]", "int8[<=3]", "x", "=",
    "9" * 5000, "std_msgs/Header", "geometry_msgs/Pose", "", "#", "===", "MSG: a/B", "a b c",
    "string<=5", "\x1b[2J", "\u202e", "builtin_interfaces/Time", "int8[1]", "a/b/c/d",
)  # fmt: skip
VALUES = (
    "null", "true", "[]", "{}", "[1, 2]", "[null, 1]", "NaN", "1e400", "-1", "0", "1.5", '"x"', "",
    "9" * 4000, "9" * 5000, "[[[[[]]]]]", "[" * 3000, '"\\ud800"', '"\\u001b[2J"', "65536",
    '"R1"', '[{"name": "R1", "id": 1}]', "Infinity", '{"graph": 3}', '"mean"', "1e-320", "{",
)  # fmt: skip


def flips(draw, data):
    out = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 40))):
        out[draw.randrange(len(out))] ^= 1 << draw.randrange(8)
    return bytes(out)


def values(draw, data):
    out = bytearray(data)
    for _ in range(draw.choice((1, 1, 3, 9))):
        at, width = draw.randrange(len(out)), draw.choice((1, 2, 4, 8))
        out[at : at + width] = (draw.choice(NUMBERS) % 256**width).to_bytes(width, "little")
    return bytes(out)


def cut(draw, data):
    return data[: draw.randrange(len(data))]


def insert(draw, data):
    at = draw.randrange(len(data) + 1)
    return data[:at] + draw.randbytes(draw.choice((1, 2, 9, 100))) + data[at:]


def remove(draw, data):
    at = draw.randrange(len(data))
    return data[:at] + data[at + draw.choice((1, 2, 8, 9, 100)) :]


def double(draw, data):
    a, b = sorted(draw.randrange(len(data) + 1) for _ in range(2))
    return data[:b] + data[a:]


def splice(draw, data, other):
    return data[: draw.randrange(len(data))] + other[draw.randrange(len(other)) :]


BYTES = (flips, values, cut, insert, remove, double)


def of_bytes(draw, data, other):
    """One or two mutations of raw bytes."""
    for _ in range(draw.choice((1, 1, 2))):
        kind = draw.choice((*BYTES, splice))
        data = kind(draw, data, other) if kind is splice else kind(draw, data)
        if len(data) == 0:
            return MAGIC
    return data


def apart(data):
    """The records of a log, those of uncompressed chunks in place of the chunks."""
    at, out = 8, []
    while at + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        body = data[at + 9 : at + 9 + length]
        if opcode == 6:
            size, _, name = struct.unpack_from("<QII", body, 16)
            inner = body[40 + name :]
            kind = body[32 : 32 + name]
            if kind == b"zstd":
                inner = zstandard.decompress(inner, max_output_size=size)
            elif kind == b"lz4":
                inner = lz4.frame.decompress(inner)
            out += apart(MAGIC + inner + MAGIC)
        elif opcode in {1, 3, 4, 5, 9, 12}:
            out.append((opcode, bytes(body)))
        at += 9 + length
    return out


def record(opcode, body, length=None):
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def together(draw, parts):
    """A log of records: in chunks of one kind or another, or bare; checksums are right."""
    form = draw.choice(("", "zstd", "lz4", "bare"))
    out = [MAGIC]
    inside = b""
    for opcode, body in parts:
        whole = record(opcode, body)
        if form == "bare" or opcode not in {3, 4, 5}:
            out.append(whole)
            continue
        inside += whole
        if len(inside) > 3000:
            out.append(chunk(form, inside))
            inside = b""
    if len(inside) > 0:
        out.append(chunk(form, inside))
    out += [record(15, bytes(4)), record(2, bytes(20)), MAGIC]
    return b"".join(out)


def chunk(form, inside):
    pack = {"": bytes, "zstd": zstandard.compress, "lz4": lz4.frame.compress}[form](inside)
    head = struct.pack("<QQQII", 0, 0, len(inside), zlib.crc32(inside), len(form))
    return record(6, head + form.encode() + struct.pack("<Q", len(pack)) + pack)


def texts(body, fixed, count):
    """The length-prefixed pieces of a record."""
    at, out = fixed, []
    for _ in range(count):
        size = int.from_bytes(body[at : at + 4], "little")
        out.append(body[at + 4 : at + 4 + size])
        at += 4 + size
    return out


def joined(head, pieces):
    return head + b"".join(struct.pack("<I", len(piece)) + piece for piece in pieces)


def schema(draw, body):
    """Another word, line or name in a message definition."""
    pieces = texts(body, 2, 3)
    text = pieces[2].decode("utf-8", "replace")
    tokens = re.split(r"(\s+|\[|\])", text)
    for _ in range(draw.choice((1, 1, 2, 5))):
        at = draw.randrange(len(tokens))
        match draw.randrange(4):
            case 0:
                tokens[at] = draw.choice(WORDS)
            case 1:
                tokens[at] = tokens[draw.randrange(len(tokens))]
            case 2:
                tokens[at : at + 1] = []
                tokens = tokens or [""]
            case 3:
                tokens[at:at] = [draw.choice(("\n", " ", "[")), draw.choice(WORDS)]
    pieces[2] = "".join(tokens).encode("utf-8", "replace")
    if draw.random() < 0.1:
        pieces[draw.randrange(2)] = draw.choice(WORDS).encode()
    return joined(body[:2], pieces)


def channel(draw, body):
    """Another topic, encoding or id."""
    head = bytearray(body[:4])
    pieces = texts(body, 4, 3)
    match draw.randrange(4):
        case 0:
            leaf = draw.choice(("odom", "uwb/range", "estimate", "ground_truth", "uwb/frame", "x"))
            pieces[0] = f"/{draw.choice(('R1', 'R2', 'Q' * 300, 'é'))}/{leaf}".encode()
        case 1:
            pieces[0] = draw.choice((b"/clt/innovation", b"", b"/\x1b[2J", b"\xff"))
        case 2:
            head[draw.randrange(4)] = draw.choice((0, 1, 2, 3, 255))
        case 3:
            pieces[draw.choice((1, 2))] = draw.choice((b"", b"json", b"\x05\x00\x00\x00abcde"))
    return joined(bytes(head), pieces)


def message(draw, body):
    """Another number, length or header in a payload."""
    out = bytearray(body) + bytes(max(26 - len(body), 0))
    for _ in range(draw.choice((1, 1, 2, 4))):
        match draw.randrange(6):
            case 0 if len(out) > 34:
                at = 26 + 8 * draw.randrange(max((len(out) - 26) // 8, 1))
                at += draw.choice((0, 0, 4))
                out[at : at + 8] = struct.pack("<d", draw.choice(DOUBLES))
            case 1 if len(out) > 34:
                at = 26 + 4 * draw.randrange((len(out) - 26) // 4)
                out[at : at + 4] = struct.pack("<I", draw.choice(NUMBERS) % 2**32)
            case 2:
                out[22:26] = draw.choice((b"\0\0\0\0", b"\0\1\0\0", b"\0\7\0\0", b"\1\1\0\0", b""))
            case 3:
                out = out[: draw.randrange(22, max(len(out), 22) + 1)]
            case 4:
                out += draw.randbytes(draw.choice((1, 4, 8)))
            case 5:
                at = draw.choice((0, 2, 6, 14))
                out[at : at + 8] = struct.pack("<Q", draw.choice((*NUMBERS, 2**63, 2**64 - 1)))[
                    : 2 if at == 0 else 8
                ]
    return bytes(out)


def metadata(draw, body):
    """Another key or value in a metadata record, or another name."""
    name, table = texts(body, 0, 2)
    pairs, at = [], 0
    while at < len(table):
        key, value = texts(table[at:], 0, 2)
        pairs.append([key, value])
        at += 8 + len(key) + len(value)
    if len(pairs) > 0:
        one = draw.choice(pairs)
        text = one[1].decode("utf-8", "replace")
        places = [match.span() for match in re.finditer(r'"[^"]*"|[-\d.e]+|\w+', text)]
        if len(places) > 0 and draw.random() < 0.8:
            a, b = draw.choice(places)
            one[1] = (text[:a] + draw.choice(VALUES) + text[b:]).encode("utf-8", "replace")
        elif draw.random() < 0.5:
            one[1] = draw.choice(VALUES).encode()
        else:
            one[0] = draw.choice((b"", b"robots", b"range_sigma", b"communication", b"calibration"))
    if draw.random() < 0.1:
        name = draw.choice((b"clt.team", b"clt.run", b""))
    return joined(b"", [name, b"".join(joined(b"", pair) for pair in pairs)])


MEANING = {3: schema, 4: channel, 5: message, 12: metadata}


def of_meaning(draw, data):
    """One to three mutations of records, or of their order."""
    parts = apart(data)
    for _ in range(draw.choice((1, 1, 2, 3))):
        kind = draw.choice((3, 3, 4, 5, 5, 5, 12, 12, 0))
        rows = [row for row, (opcode, _) in enumerate(parts) if opcode == kind]
        if kind == 0 or len(rows) == 0:
            a, b = (draw.randrange(len(parts)) for _ in range(2))
            match draw.randrange(3):
                case 0:
                    parts[a], parts[b] = parts[b], parts[a]
                case 1:
                    parts.insert(a, parts[b])
                case 2 if len(parts) > 1:
                    parts.pop(a)
            continue
        several = rows if kind == 5 and draw.random() < 0.2 else [draw.choice(rows)]
        for row in several:
            parts[row] = (kind, MEANING[kind](draw, parts[row][1]))
    return together(draw, parts)

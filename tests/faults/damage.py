"""Where formats have their lengths, and damage under right checksums."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib

import numpy as np
from mutations import mutated

from cabinpose.store.schema import checksum, with_checksum_line
from cabinpose.store.shard import with_checksum

Places = list[tuple[int, int]]  # of numbers in a file: where they begin, and how many bytes they have


def of_c3d(data: bytes) -> Places:
    """The counts of the header, and of each parameter its offset and dimensions."""
    places = [(at, 2) for at in range(2, 20, 2)]
    at = 512 * (data[0] - 1) + 4
    while length := abs(struct.unpack_from("b", data, at)[0]):
        offset = at + 2 + length
        places += [(at, 1), (offset, 2)]
        if data[at + 1] < 128:
            places += [(offset + 2 + i, 1) for i in range(2 + data[offset + 3])]
            places += [(offset + 4 + data[offset + 3], 2)]
        step = int.from_bytes(data[offset : offset + 2], "little")
        if not step:
            break
        at = offset + step
    return places


def of_xdf(data: bytes) -> Places:
    """The length of each chunk, its kind and stream, and what follows: the number of samples."""
    places, at = [], 4
    while at < len(data):
        places += [(at, 1), (at + 1, 4), (at + 5, 2), (at + 7, 4), (at + 11, 1), (at + 12, 4)]
        at += 5 + int.from_bytes(data[at + 1 : at + 5], "little")
    return places


def of_mcap(data: bytes) -> Places:
    """The length of each record, and the numbers that chunks, messages and the footer begin with."""
    places, at = [], 8
    while at + 9 <= len(data) - 8:
        size = int.from_bytes(data[at + 1 : at + 9], "little")
        places += [(at, 1), (at + 1, 8), *((at + 9 + i, 8) for i in range(0, min(size, 48), 8))]
        at += 9 + size
    return places


def of_mkv(data: bytes) -> Places:
    """The sizes of elements, by the identities that Azure's files have."""
    found = []
    for identity in (
        "18538067",
        "1f43b675",
        "1654ae6b",
        "ae",
        "1941a469",
        "61a7",
        "465c",
        "a3",
        "1254c367",
        "7373",
        "67c8",
        "63a2",
    ):
        code, at = bytes.fromhex(identity), data.find(bytes.fromhex(identity))
        while at >= 0 and len(found) < 300:
            found += [(at + len(code), 1), (at + len(code) + 1, 2)]
            at = data.find(code, at + 1) if len(code) > 1 else -1
    return [(at, size) for at, size in found if at + size <= len(data)]


def of_glb(data: bytes) -> Places:
    """The lengths of the file and of its chunks."""
    length = int.from_bytes(data[12:16], "little")
    return [(8, 4), (12, 4), (16, 4), (20 + length, 4), (24 + length, 4)]


def of_zip(data: bytes) -> Places:
    """The sizes of the entries in both directories."""
    places = []
    for mark, fields in (
        (b"PK\x03\x04", (8, 18, 22, 26, 28)),
        (b"PK\x01\x02", (10, 20, 24, 28, 42)),
        (b"PK\x05\x06", (8, 12, 16)),
    ):
        at = data.find(mark)
        while at >= 0:
            places += [(at + field, 2 if field in (8, 10, 26, 28) else 4) for field in fields if at + field + 4 <= len(data)]
            at = data.find(mark, at + 1)
    return places


def of_onnx(data: bytes) -> Places:
    """Bytes near the beginning of messages, which are their kinds and lengths."""
    kinds = [data.find(mark) for mark in (b"\x3a", b"\x0a", b"\x12", b"\x22", b"\x2a", b"Conv", b"Gemm", b"Reshape", b"weight")]
    return [(at + i, 1) for at in kinds if at >= 0 for i in range(-8, 8) if 0 <= at + i < len(data)]


# ------------------------------------------------------------------------------------- damage under right checksums


def in_zip(data: bytes, rng: np.random.Generator) -> bytes:
    """One entry damaged, all checksums right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {info.filename: archive.read(info) for info in archive.infolist()}
    chosen = list(entries)[int(rng.integers(len(entries)))]
    head, tail = entries[chosen][:128], entries[chosen][128:]
    entries[chosen] = mutated(head, rng) + tail if rng.random() < 0.7 else mutated(entries[chosen], rng)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return file.getvalue()


def in_glb(data: bytes, rng: np.random.Generator) -> bytes:
    """The JSON damaged, the lengths right."""
    length = int.from_bytes(data[12:16], "little")
    text = mutated(data[20 : 20 + length], rng)
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return data[:8] + struct.pack("<II4s", 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def in_chunk(data: bytes, rng: np.random.Generator) -> bytes:
    """The records of an MCAP file's first chunk damaged in place, under the right checksum."""
    at = next(at for at, size in of_mcap(data) if size == 1 and data[at] == 6)
    size, _, name = struct.unpack_from("<QII", data, at + 25)
    begin = at + 41 + name + 8
    records = mutated(data[begin : begin + size], rng)[:size].ljust(size, b"\0")
    return data[: at + 33] + struct.pack("<I", zlib.crc32(records)) + data[at + 37 : begin] + records + data[begin + size :]


def in_manifest(data: bytes, rng: np.random.Generator) -> bytes:
    """`dataset.yaml` damaged, its checksum right."""
    content = mutated(data[: data.rindex(b"checksum: ")], rng).decode("utf-8", "replace")
    return with_checksum_line(content if content.endswith("\n") else content + "\n").encode()


def in_group(data: bytes, rng: np.random.Generator) -> bytes:
    """A part's `zarr.json` damaged, its checksum right."""
    content = mutated(re.sub(rb'"checksum": "[^"]*"', b'"checksum": ""', data), rng).decode("utf-8", "replace")
    return content.replace('"checksum": ""', f'"checksum": "{checksum(content)}"', 1).encode()


def in_checked(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk damaged, or the index of a shard, their checksums right."""
    return with_checksum(mutated(data[:-4], rng))


def in_png(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk of a PNG damaged, often its head with the size, all lengths and checksums right."""
    chunks, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += size + 12
    chosen = 0 if rng.random() < 0.5 else int(rng.integers(len(chunks)))
    kind, content = chunks[chosen]
    chunks[chosen] = kind, mutated(content, rng)
    return data[:8] + b"".join(struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)

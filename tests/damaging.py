"""Damage done to files, by chance and by intent."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np


def mutated(data: bytes, rng: np.random.Generator, other: bytes = b"") -> tuple[str, bytes]:
    """Return a file's bytes with one kind of damage, and the name of the kind."""
    kinds = ("flip", "cut", "splice", "run", "length", "zero", "head")
    kind = str(rng.choice(kinds))
    broken = bytearray(data)
    place = int(rng.integers(len(broken)))
    if kind in ("flip", "head"):
        # Headers matter most, so that half of the damage is there.
        reach = min(len(broken), 512) if kind == "head" else len(broken)
        for spot in rng.integers(reach, size=rng.integers(1, 9)):
            broken[spot] ^= 1 << int(rng.integers(8))
    elif kind == "cut":
        del broken[place:]
    elif kind == "splice":
        source = other or data
        start = int(rng.integers(len(source)))
        piece = source[start : start + int(rng.integers(1, 65))]
        broken[place : place + len(piece)] = piece
    elif kind == "run":
        broken[place:place] = bytes([int(rng.integers(256))]) * int(rng.integers(1, 4097))
    elif kind == "length":
        reach = min(len(broken), 1024) if rng.random() < 0.7 else len(broken)
        spot = int(rng.integers(max(reach - 8, 1)))
        size = str(rng.choice(["H", "I", "Q"]))
        value = int(rng.choice([0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1, 2**63]))
        limit = 256 ** struct.calcsize(size) - 1
        order = str(rng.choice(["<", ">"]))
        packed = struct.pack(order + size, min(value, limit))
        broken[spot : spot + len(packed)] = packed
    else:
        broken[place : place + int(rng.integers(1, 257))] = bytes(int(rng.integers(1, 257)))
    return kind, bytes(broken)


def npy_header(shape: tuple[int, ...], descr: str = "|u1") -> bytes:
    """Return the head of a .npy file, whatever it says."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue()


def zip_bomb(path: Path, head: bytes, megabytes: int) -> None:
    """Write an .npz whose array unpacks to megabytes of zeros."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("holograms.npy", "w", force_zip64=True) as member,
    ):
        member.write(head)
        zeros = bytes(2**20)
        for _ in range(megabytes):
            member.write(zeros)

# ruff: noqa: E501  (lists of odd values)
"""Ways to damage a file, each drawn from a seeded generator; see ``python -m tests.fuzz``."""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

EXTREME = (
    "1e308", "-1e308", "1e999", "nan", "inf", "-inf", "-0", "1e-320", "0", "9" * 40, "1718000000", "1718000000000000000",
    "0x10", "1_000", "1e", "--1", "1,5", "true", "", "²",
)  # fmt: skip
NOISE = (
    "\0",
    "\x1b[31m",
    "\r",
    "\n",
    "\t",
    "\ufeff",
    "\u202e",
    '"',
    "'",
    ";",
    ",",
    "#",
    "é",
    "{",
    "}",
    "::error::",
    "%s",
)
UNITS = ("[us]", "[ns]", "[m^1e9]", "[]", "[[m/s]", "[1e999 m]", "[degC]", "[dB]", "{m/s}", "[" * 300)
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1e308, -1e308, 10**30, "", "x", "\x1b[31m", [], {}, [1, [2]], {"a": None}, "1e999", 5e-324,
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """Return bytes flipped, cut, doubled or replaced."""
    place, end = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    match rng.randrange(6):
        case 0:
            flipped = bytearray(data)
            for _ in range(rng.randrange(1, 8)):
                if flipped:
                    flipped[rng.randrange(len(flipped))] ^= 1 << rng.randrange(8)
            return bytes(flipped)
        case 1:
            return data[:place]
        case 2:
            return data[:place] + data[end:]
        case 3:
            return data[:end] + data[place:end] * rng.randrange(1, 4) + data[end:]
        case 4:
            return data[:place] + rng.choice(NOISE).encode() * rng.choice((1, 1, 500)) + data[place:]
        case _:
            return b""


def damage_numbers(data: bytes, rng: random.Random) -> bytes:
    """Return a text in which one to three numbers are extreme."""
    for _ in range(rng.randrange(1, 4)):
        found = list(NUMBER.finditer(data))
        if not found:
            return data
        number = rng.choice(found)
        data = data[: number.start()] + rng.choice(EXTREME).encode() + data[number.end() :]
    return data


def damage_table(data: bytes, rng: random.Random) -> bytes:
    """Return a CSV table with its columns, header, units or rows changed."""
    rows = [line.split(",") for line in data.decode("utf-8", "replace").splitlines()]
    if not rows:
        return b","
    width = len(rows[0])
    match rng.randrange(10):
        case 0:
            a, b = rng.randrange(width), rng.randrange(width)
            rows = [_swapped(row, a, b) for row in rows]
        case 1:
            rows[0][rng.randrange(width)] = rng.choice((*NOISE, "t", "vx", "", "time", "vx [m/s] [m/s]"))
        case 2:
            place = rng.randrange(width)
            rows[0][place] = rows[0][place].split(" [")[0] + " " + rng.choice(UNITS)
        case 3:
            rows = [row[:-1] for row in rows]
        case 4:
            rng.shuffle(rows)
        case 5:
            rows = rows[: rng.randrange(3)]
        case 6:
            rows = [*rows, *rows[1:]]
        case 7:
            row = rng.choice(rows)
            row[rng.randrange(len(row))] = rng.choice(EXTREME)
        case 8:
            return rng.choice((";", "\t", " ", "|")).join(",".join(row) for row in rows).encode()
        case _:
            rows = rows[1:]
    return "\n".join(",".join(row) for row in rows).encode("utf-8", "replace") + b"\n"


def _swapped(row: list[str], a: int, b: int) -> list[str]:
    row = list(row)
    if max(a, b) < len(row):
        row[a], row[b] = row[b], row[a]
    return row


def damage_json_lines(data: bytes, rng: random.Random) -> bytes:
    """Return a journal with one value of another type, every checksum right, as another program might have written."""
    lines, checksum = [], 0
    texts = data.decode("utf-8", "replace").splitlines()
    chosen = rng.randrange(len(texts)) if texts else 0
    for index, text in enumerate(texts):
        try:
            record = json.loads(text)
        except ValueError:
            return damage_bytes(data, rng)
        if not isinstance(record, dict):
            return damage_bytes(data, rng)
        record.pop("crc32", None)
        if index == chosen:
            record = _changed(record, rng)
        body = json.dumps(record).encode()[:-1]
        checksum = zlib.crc32(body, checksum)
        lines.append(body + b', "crc32": "%08x"}' % checksum)
    return b"\n".join(lines) + b"\n"


def _changed(value: Any, rng: random.Random) -> Any:
    """Return JSON with one value, at any depth, that is another."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = rng.choice(sorted(value))
        if rng.random() < 0.15:
            return {name: held for name, held in value.items() if name != key}
        return value | {key: _changed(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.5:
        place = rng.randrange(len(value))
        return [*value[:place], _changed(value[place], rng), *value[place + 1 :]]
    return rng.choice(VALUES)


def damage_arrays(data: bytes, rng: random.Random) -> bytes:
    """Return an NPZ file with an array of another type or shape, or missing."""
    with np.load(io.BytesIO(data), allow_pickle=False) as loaded:
        arrays = {name: loaded[name] for name in loaded.files}
    name = rng.choice(sorted(arrays))
    array = arrays[name]
    odd: tuple[Callable[[], Any], ...] = (
        lambda: array[::-1], lambda: array[:0], lambda: array.astype("U"), lambda: array.reshape(-1, 1), lambda: array[:1],
        lambda: np.zeros((len(array), 2, 2)), lambda: np.float64(1.0), lambda: np.full(len(array), np.nan),
        lambda: np.full(len(array), 1e308), lambda: np.zeros(len(array), complex), lambda: np.zeros(len(array), bool),
        lambda: np.array([None] * len(array), object), lambda: np.arange(len(array)).astype("datetime64[ns]"),
        lambda: np.arange(len(array)).astype("timedelta64[us]"), lambda: np.zeros(len(array), [("a", float)]),
        lambda: array[:-1], lambda: np.full(len(array), 2**62), lambda: np.zeros(len(array), "S3"),
        lambda: array.astype(np.float16), lambda: np.array("{" * 50), lambda: np.array('{"units": 3, "meta": [1]}'),
    )  # fmt: skip
    if rng.random() < 0.15:
        del arrays[name]
    else:
        try:
            arrays[name] = rng.choice(odd)()
        except (TypeError, ValueError):  # of a text that is no list
            arrays[name] = np.zeros(3)
    if rng.random() < 0.2:
        arrays[rng.choice(("a/b", "\x1b[31m", " ", "t ", "T", "x" * 300))] = np.zeros(3)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def damage_frame(data: bytes, rng: random.Random) -> bytes:
    """Return a Parquet file with a column of another type."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(data))
    place, n = rng.randrange(table.num_columns), table.num_rows
    odd: tuple[Any, ...] = (
        pa.array(["a"] * n), pa.array([None] * n, pa.float64()), pa.array([[1.0]] * n), pa.nulls(n), pa.array([b"\0"] * n),
        pa.array([True] * n), pa.array([2**62] * n), pa.array([float("nan")] * n), pa.array(range(n), pa.timestamp("ns")),
        pa.array(range(n), pa.duration("ms")), pa.array(range(n), pa.date32()), pa.array([{"a": 1}] * n),
        pa.array(["x"] * n).dictionary_encode(), pa.array(range(n), pa.int8()), pa.array([1e308] * n),
    )  # fmt: skip
    name = table.column_names[place] if rng.random() < 0.8 else rng.choice(("", "t", "\x1b[31m", "a\nb"))
    table = table.set_column(place, name, rng.choice(odd))
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


def damage_place(path: Path, rng: random.Random) -> None:
    """Put something else where a file was."""
    name = path.name
    match rng.randrange(8):
        case 0:
            path.unlink()
        case 1:
            path.unlink()
            path.mkdir()
        case 2:
            path.unlink()
            path.symlink_to(name)
        case 3:
            path.unlink()
            path.symlink_to(rng.choice(("/dev/null", "/dev/zero", "nowhere", "/", "/proc/self/mem")))
        case 4:
            path.unlink()
            os.mkfifo(path)
        case 5:
            path.rename(
                path.with_name(rng.choice(("a\x1b[31m", "a\nb", "-", "a b", "é", ".hidden")) + path.suffix)
            )
        case 6:
            shutil.copy(path, path.with_name("copy-" + name))
        case _:
            path.write_bytes(b"")


OF_FORMAT: dict[str, tuple[Callable[[bytes, random.Random], bytes], ...]] = {
    ".stl": (damage_bytes, damage_numbers),
    ".csv": (damage_bytes, damage_numbers, damage_table, damage_table),
    ".npz": (damage_bytes, damage_arrays, damage_arrays, damage_arrays),
    ".parquet": (damage_bytes, damage_frame, damage_frame),
    ".jsonl": (damage_bytes, damage_numbers, damage_json_lines, damage_json_lines, damage_json_lines),
}


def damage(path: Path, rng: random.Random) -> str:
    """Damage a file by a way that fits it; return what was done, in words."""
    if rng.random() < 0.12:
        damage_place(path, rng)
        return f"another thing in place of {path.name}"
    ways = OF_FORMAT.get(path.suffix, (damage_bytes,))
    way, data = rng.choice(ways), path.read_bytes()
    try:
        path.write_bytes(way(data, rng))
    except Exception:  # damaged before, so that it cannot be read as what it was
        path.write_bytes(damage_bytes(data, rng))
    return f"{way.__name__} of {path.name}"

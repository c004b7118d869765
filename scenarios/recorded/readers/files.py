"""Opening a recording: regular files only, unpacked where they are compressed, of a size that fits into memory.

A pipe or a device would hang or never end, and a file that unpacks without end would take the machine with it."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import stat
import zipfile
import zlib
from pathlib import Path
from typing import IO

LARGEST = 2 * 1024**3
"""Most bytes of a text that is read whole."""
PACKED = ((b"\x1f\x8b", "gzip"), (b"BZh", "bzip2"), (b"\xfd7zXZ\0", "xz"), (b"PK\x03\x04", "zip"),
          (b"\x28\xb5\x2f\xfd", "zstd"))


def regular(path: str) -> Path:
    """The path of a file (or of a folder). Raises ValueError for what is neither, and for what cannot be read."""
    found = Path(path)
    try:
        mode = found.stat().st_mode
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a NUL in the name
        raise ValueError(f"{path!r}: cannot be read: {error}") from None
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise ValueError(f"{path}: is no regular file but a pipe or a device: copy it to a file first")
    return found


def content(path: Path) -> tuple[bytes, str]:
    """What is in a file and how it was packed ("" for not at all). Raises ValueError."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
            kind = next((name for magic, name in PACKED if head.startswith(magic)), "")
            file.seek(0)
            return _unpacked(path, file, kind), kind
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (EOFError, zlib.error, lzma.LZMAError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        raise ValueError(f"{path}: the compressed file is damaged: {error}") from None


def _unpacked(path: Path, file: IO[bytes], kind: str) -> bytes:
    if kind == "zip":
        with zipfile.ZipFile(file) as archive:
            members = [name for name in archive.namelist() if not name.endswith("/")]
            if "[Content_Types].xml" in members:
                raise ValueError(f"{path}: is a spreadsheet: save its sheet as CSV")
            if len(members) != 1:
                raise ValueError(f"{path}: the zip holds {len(members)} files ({', '.join(members[:5])}, ..): one is "
                                 "needed")
            with archive.open(members[0]) as inner:
                return _whole(path, inner)
    if kind == "zstd":
        try:
            import zstandard
        except ImportError:
            raise ValueError(f"{path}: is compressed by zstd: pip install zstandard, or unpack it") from None
        with zstandard.ZstdDecompressor().stream_reader(file) as inner:
            return _whole(path, inner)
    openers = {"gzip": gzip.open, "bzip2": bz2.open, "xz": lzma.open}
    if kind:
        with openers[kind](file, "rb") as inner:
            return _whole(path, inner)
    return _whole(path, file)


def _whole(path: Path, file: IO[bytes] | io.RawIOBase) -> bytes:
    found = file.read(LARGEST + 1) or b""
    if len(found) > LARGEST:
        raise ValueError(f"{path}: holds more than {LARGEST / 1024**3:g} GB: cut it, or store it as Parquet")
    return found

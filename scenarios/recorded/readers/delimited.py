"""CSV and its kin: encoding and delimiter found out and said, or refused with the cause.

Every row must have as many fields as there are names; fields stay texts, since what is a number depends on the file."""

from __future__ import annotations

import codecs
import csv
import io
import re

import pyarrow as pa
import pyarrow.csv as pacsv

from .table import Table, cause

DELIMITERS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "spaces"}
MARKS = ((codecs.BOM_UTF8, "utf-8-sig", "UTF-8 with byte-order mark"), (codecs.BOM_UTF32_LE, "utf-32", "UTF-32"),
         (codecs.BOM_UTF32_BE, "utf-32", "UTF-32"), (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
         (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"))
SAMPLE = 200
WRITTEN = bytes(byte for byte in range(256) if byte not in {*range(9), *range(14, 32), 127})
"""Bytes that a text may hold."""
NUMBER = re.compile(r"\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*")


def read_delimited(path: str, data: bytes) -> Table:
    """The columns of a text table. Raises ValueError."""
    text, encoding = _decoded(path, data)
    del data
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    names_line, body, first = _names_row(path, text)
    sample = [line for line in body[:200_000].split(b"\n")[:SAMPLE] if line.strip()]
    if len(body) > 200_000:
        sample = sample[:-1]
    delimiter = _delimiter(path, names_line, [line.decode() for line in sample])
    names = [name.strip() for name in _fields(names_line, delimiter)]
    if all(NUMBER.fullmatch(name) for name in names):
        raise ValueError(f"{path}: the first row holds numbers ({', '.join(names[:3])}, ..): a row of names is needed")
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"{path}: two columns are called \"{twice[0]}\": names must differ")
    if b'"' in body:
        for number, line in enumerate(body.split(b"\n"), first):
            if line.count(b'"') % 2:
                raise ValueError(f"{path}: line {number}: a quote is opened and not closed in that line")
    if delimiter == " ":
        body = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", body)
        body = re.sub(rb"[ \t]+", b" ", body)
    try:
        columns = pacsv.read_csv(
            pa.BufferReader(body), pacsv.ReadOptions(column_names=names, block_size=1 << 24),
            pacsv.ParseOptions(delimiter=delimiter, double_quote=True, newlines_in_values=False),
            pacsv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False))
    except pa.ArrowInvalid as error:
        raise ValueError(_mismatch(path, names, body, delimiter, first) or f"{path}: not a CSV table: "
                         f"{cause(error)}") from None
    return Table(path, columns, f"CSV: {DELIMITERS[delimiter]}, {encoding}")


def _decoded(path: str, data: bytes) -> tuple[bytes, str]:
    """The text in UTF-8, and the encoding it had."""
    if not data.strip(b"\0 \t\r\n"):
        raise ValueError(f"{path}: not a CSV table: the file is empty")
    for mark, codec, name in MARKS:
        if data.startswith(mark):
            try:
                return data.decode(codec).encode(), name
            except UnicodeDecodeError as error:
                raise ValueError(f"{path}: begins as {name}, but is not: {error.reason} at byte "
                                 f"{error.start}") from None
    if b"\0" in data:
        odd, even = data[1::2].count(b"\0"), data[::2].count(b"\0")
        if max(odd, even) > 0.8 * len(data[::2]) and min(odd, even) == 0:
            codec = "utf-16-le" if odd else "utf-16-be"
            try:
                return data.decode(codec).encode(), "UTF-16"
            except UnicodeDecodeError:
                pass
        raise ValueError(f"{path}: not a text table: it holds NUL bytes, the first at {data.index(0)}")
    try:
        data.decode("ascii" if data.isascii() else "utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
        if data.translate(None, WRITTEN):
            raise ValueError(f"{path}: not a text table: neither UTF-8 nor Latin-1") from None
        return text.encode(), "Latin-1"
    if data.translate(None, WRITTEN):
        raise ValueError(f"{path}: not a text table: it holds control characters")
    return data, "UTF-8"


def _names_row(path: str, text: bytes) -> tuple[str, bytes, int]:
    """The row of names, what follows it, and the line number of what follows. Lines that begin with # stand before the
    names; where no names come after them, the last of them has the names."""
    place, line_number, comment = 0, 0, ""
    while place < len(text):
        end = text.find(b"\n", place)
        end = len(text) if end < 0 else end
        line = text[place:end].decode()
        line_number += 1
        if line.strip() and not line.lstrip().startswith("#"):
            if comment and all(NUMBER.fullmatch(part) for part in re.split(r"[;\t|, ]+", line.strip())):
                return comment, text[place:], line_number
            return line, text[end + 1:], line_number + 1
        if line.strip():
            comment = line.lstrip().lstrip("#").strip()
        place = end + 1
    raise ValueError(f"{path}: not a CSV table: it has no row of names")


def _fields(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        line = re.sub(r"[ \t]+", " ", line.strip())
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True), [])
    except csv.Error:
        return []


def _delimiter(path: str, names: str, sample: list[str]) -> str:
    """The delimiter by which names and rows have the same number of fields. Raises ValueError where there is none."""
    counts = {mark: len(_fields(names, mark)) for mark in DELIMITERS}
    possible = [mark for mark, count in counts.items() if count > 1]
    fitting = [mark for mark in possible if sample and all(len(_fields(line, mark)) == counts[mark] for line in sample)]
    if fitting:
        # a space or a comma also stands inside names and values: the first that fits, in the order of DELIMITERS
        return fitting[0]
    written = [mark for mark in possible if mark != " "]
    if written:  # which one is meant is clear, and a row does not fit: its place is named when it is read
        return max(written, key=lambda mark: counts[mark])
    raise ValueError(f"{path}: not a CSV table: no delimiter found (tried {', '.join(DELIMITERS.values())}) by which "
                     f"names and rows have the same number of fields, two or more; the first line is {names[:80]!r}")


def _mismatch(path: str, names: list[str], body: bytes, delimiter: str, first: int) -> str:
    """Which line has another number of fields than there are names."""
    for number, line in enumerate(io.StringIO(body.decode()), first):
        if not line.strip():
            continue
        count = len(_fields(line.rstrip("\n"), delimiter))
        if count != len(names):
            commas = delimiter == "," and count > len(names)
            hint = (" (decimal commas without quotes, or a comma at the end of each row?)" if commas
                    else " (cut off?)" if count < len(names) else "")
            return f"{path}: line {number} has {count} fields, but there are {len(names)} names{hint}"
    return ""

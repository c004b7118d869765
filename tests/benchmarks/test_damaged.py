"""Results folders that somebody damaged or forged: every command that reads them ends with one message or is right.

Damage is drawn by seeds from the kinds of `KINDS`; the long form is a study of 500."""

from __future__ import annotations

import json
import os
import random
import shutil
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from railstate.benchmarks.store.lock import LOCK

from ..conftest import Command, Outcome
from .test_run import rows, same

ODD = (None, -1, 10**30, 0.5, "", "x\n\x1b[31m", "../../X", [], {}, [[]], {"a": 1}, True, "<script>", "=cmd()",
       "\ud800", float("nan"), float("inf"), "2020-01-01", [1] * 50, "v/../../../X", "é" * 300)


def _anywhere(rng: random.Random, found: Any) -> tuple[Any, Any]:
    """A container of nested data and one of its keys."""
    spots = [(found, key) for key in found] if isinstance(found, dict) else [(found, n) for n in range(len(found))]
    spots += [spot for _, value in (found.items() if isinstance(found, dict) else enumerate(found))
              if isinstance(value, dict | list) and value for spot in [_anywhere(rng, value)]]
    return rng.choice(spots)


def _json(rng: random.Random, path: Path) -> None:
    content = json.loads(path.read_text())
    for _ in range(rng.randint(1, 2)):
        where, key = _anywhere(rng, content)
        action = rng.randrange(4)
        if action == 0:
            del where[key]
        elif action == 1 and isinstance(where, dict):
            where[rng.choice(["odd", "../x", "a/b", ""])] = where.pop(key)
        else:
            where[key] = rng.choice(ODD)
        if not content:
            break
    path.write_text(json.dumps(content))


def manifest(rng: random.Random, out: Path) -> None:
    _json(rng, out / "manifest.json")


def nested(rng: random.Random, out: Path) -> None:
    depth = rng.choice([50, 3000, 100_000])
    text = (out / "manifest.json").read_text()
    deep = rng.choice(["[" * depth, "[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth])
    (out / "manifest.json").write_text(rng.choice([deep, text.replace('"notes": []', f'"notes": {deep}', 1),
                                                   text.replace('"parameters": {}', f'"parameters": {deep}', 1)]))


def scrambled(rng: random.Random, out: Path) -> None:
    path = rng.choice(sorted(path for path in out.rglob("*") if path.is_file() and path.stat().st_size))
    data = bytearray(path.read_bytes())
    action = rng.randrange(4)
    if action == 0:
        data = data[:rng.randrange(len(data))]
    elif action == 1:
        data = bytearray(rng.randbytes(len(data)))
    else:
        for _ in range(rng.choice([1, 8, 64])):
            data[rng.randrange(len(data))] = rng.randrange(256)
    path.write_bytes(bytes(data))


def _column(rng: random.Random, path: Path) -> None:
    frame = pd.read_parquet(path)
    column = rng.choice(list(frame.columns))
    action = rng.randrange(6)
    if action == 0:
        frame = frame.drop(columns=column)
    elif action == 1:
        frame = frame.rename(columns={column: rng.choice(["odd", "rmse:x:m", "a:b:c", column.upper()])})
    elif action == 2:
        odd: Any = rng.choice([None, "odd", 3.5, -7, "../../X", [1, 2], {"a": 1}, True, "ok", float("inf")])
        frame[column] = [odd] * len(frame)
    elif action == 3:
        frame = pd.concat([frame, frame.head(rng.randint(1, 3))])
    elif action == 4:
        frame = frame.astype({name: "large_string[pyarrow]" for name in frame
                              if pd.api.types.is_string_dtype(frame[name])})
    else:
        frame = frame.head(0) if rng.random() < 0.3 else frame.sample(frac=0.6, random_state=rng.randrange(1000))
    frame.to_parquet(path, index=rng.random() < 0.5)


def part(rng: random.Random, out: Path) -> None:
    _column(rng, rng.choice(sorted(path for path in out.rglob("*.parquet") if path.parent != out)))


def judged(rng: random.Random, out: Path) -> None:
    """The verdict table with other types, values or columns than a table of verdicts has."""
    path = out / "verdicts.parquet"
    if rng.random() < 0.5:
        return _column(rng, path)
    table = pq.read_table(path)
    place = rng.randrange(table.num_columns)
    kind = rng.choice([pa.string(), pa.binary(), pa.bool_(), pa.timestamp("s"), pa.list_(pa.int8()), pa.null(),
                       pa.dictionary(pa.int8(), pa.string())])
    values = pa.nulls(table.num_rows, kind) if rng.random() < 0.5 else pa.array(["7"] * table.num_rows)
    pq.write_table(table.set_column(place, table.column_names[place], values), path)
    return None


def texts(rng: random.Random, out: Path) -> None:
    """A cell of a CSV file."""
    path = rng.choice([out / "timing.csv", out / "timing.csv", out / "verdicts.csv", out / "summary.csv"])
    lines = [line.split(",") for line in path.read_text().splitlines()]
    line = rng.choice(lines)
    line[rng.randrange(len(line))] = rng.choice(["", "odd", "1e999", '"', "-1", "\x00", "é", "../../X", "a,b", "nan"])
    if rng.random() < 0.2:
        lines.append(line)
    path.write_text("\n".join(",".join(line) for line in lines[:rng.choice([0, 1, len(lines), len(lines)])]) + "\n")


def files(rng: random.Random, out: Path) -> None:
    """A file or folder that is gone, or the other one of both."""
    path = rng.choice(sorted(path for path in out.rglob("*") if path.name != LOCK))
    if path.is_dir():
        shutil.rmtree(path)
        if rng.random() < 0.5:
            path.write_text("a file now")
    else:
        path.unlink()
        if rng.random() < 0.5:
            path.mkdir()


def links(rng: random.Random, out: Path) -> None:
    """A link out of the folder, to nothing or to itself; a pipe, at which a reader would wait."""
    path = rng.choice(sorted(out.rglob("*")))
    elsewhere = out.parent / "elsewhere" / path.name
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    action = rng.randrange(4)
    if action == 0:
        path.symlink_to(path.name)
    elif action == 1:
        path.symlink_to("../nowhere")
    elif action == 2:
        os.mkfifo(path)
    else:
        path.symlink_to(elsewhere if elsewhere.exists() else out.parent / "elsewhere")


def swept(rng: random.Random, out: Path) -> None:
    """A sweep's two files, in the place of the folder."""
    shutil.rmtree(out)
    shutil.copytree(out.with_name("swept"), out)
    if rng.random() < 0.6:
        return _json(rng, out / "sweep.json")
    path = out / "sweep.csv"
    frame = pd.read_csv(path, dtype=str)
    column = rng.choice(list(frame.columns))
    if rng.random() < 0.3:
        frame = frame.drop(columns=column)
    else:
        frame.loc[rng.randrange(len(frame)):, column] = rng.choice(["", "odd", "1e999", "-1", "../../X", "[1]"])
    frame.to_csv(path, index=False)
    return None


KINDS: tuple[Callable[[random.Random, Path], None], ...] = (
    manifest, manifest, nested, scrambled, scrambled, part, part, judged, texts, files, links, swept)
CART = ("run", "cart.toml", "-e", "kalman,ekf", "--jobs", 1, "--out", "out")
COMMANDS: tuple[tuple[str | int, ...], ...] = (
    ("report", "out"), ("plot", "out", "--figure", "error-over-time", "--format", "svg"), ("table", "out"),
    ("compare", "sound", "out"), ("compare", "out", "sound"), ("replay", "cart/calm/kalman/1", "--out", "out"),
    ("verify", "out", "--jobs", 1), (*CART, "--runs", 3), (*CART, "--runs", 3), (*CART, "--runs", 4),
    (*CART, "--runs", 3, "--overwrite"), (*CART, "--runs", 3, "--retry", "failed"), (*CART, "--runs", 3, "--json"),
    ("run", "cart.toml/calm", "-e", "kalman", "--runs", 3, "--jobs", 1, "--until", "decided", "--out", "out"))
FOR_SWEEPS = (("report", "out"), ("report", "out"), ("sweep", "cart.toml/calm", "--over", "channel.p=0.5,0.9", "-e",
                                                    "kalman", "--runs", 2, "--jobs", 1, "--out", "out"))


def content(folder: Path) -> dict[str, bytes | str]:
    """All that lies in a folder, by its path."""
    return {str(path.relative_to(folder)): os.readlink(path) if path.is_symlink() else path.read_bytes()
            if path.is_file() else "a folder" if path.is_dir() else "a pipe" for path in sorted(folder.rglob("*"))}


def whatever(railstate: Command, *words: Any) -> Outcome:
    """How a command ended, also where it raised what it should not."""
    try:
        return railstate(*words)
    except Exception:
        return Outcome(-1, "", traceback.format_exc())


@pytest.fixture
def places(railstate: Command, tmp_path: Path) -> Path:
    """sound: a results folder; swept: a sweep's; elsewhere: what is none of anybody's business."""
    assert railstate(*CART[:-1], "sound", "--runs", 3).code == 0
    assert railstate("sweep", "cart.toml/calm", "--over", "channel.p=0.5,0.9", "-e", "kalman", "--runs", 2, "--jobs", 1,
                     "--out", "swept").code == 0
    shutil.copytree(tmp_path / "sound", tmp_path / "elsewhere")
    for kind in ("rows", "curves", "trajectories", "tables", "."):
        (tmp_path / "elsewhere" / kind / ".rows.parquet.17").write_text("somebody's\n")
    return tmp_path


@pytest.mark.parametrize("number", [30, pytest.param(500, marks=pytest.mark.long)])
def test_damaged_folders_end_in_one_message_or_are_right(railstate: Command, places: Path, number: int) -> None:
    out, right = places / "out", rows("sound")
    wrong: list[str] = []
    ended: Counter[int] = Counter()
    for seed in range(number):
        rng = random.Random(seed)
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(places / "sound", out)
        kind = rng.choice(KINDS)
        kind(rng, out)
        words = rng.choice(FOR_SWEEPS if kind is swept else COMMANDS)
        before, outside = content(out), {key: value for key, value in content(places).items() if key[:4] != "out/"}
        done = whatever(railstate, *words)
        ended[done.code] += 1
        found = list(_faults(done.code, done.err, words, before, out, right))
        if {key: value for key, value in content(places).items() if key[:4] != "out/"} != outside:
            found.append("wrote outside of the folder")
        if found:
            wrong.append(f"seed {seed}, {kind.__name__}: {' '.join(map(str, words))}: {done.code}: {found}: "
                         f"{done.err[-1500:]}")
    assert not wrong, "\n\n".join(wrong)
    assert ended[2] > 0.3 * number and ended[0] > 0.15 * number


def _faults(code: int, err: str, words: tuple[Any, ...], before: dict[str, bytes | str], out: Path, right: pd.DataFrame
            ) -> Any:
    """What is wrong with the end of a command."""
    if code not in (0, 2) and (code, words[0]) != (1, "verify"):
        yield "another exit code"
    if "Traceback" in err or "\x1b" in err or len(err) > 3000:
        yield "no message"
    if code == 2:
        if sum(line.startswith("error: ") for line in err.splitlines()) != 1:
            yield "not one message"
        now = content(out)  # what adds rows makes what stands beside them anew
        lost = [name for name, was in before.items() if now.get(name) != was and Path(name).name != LOCK
                and (words[0] not in ("run", "sweep") or ("--overwrite" not in words and (
                    name not in now or Path(name).parent.name in ("rows", "curves", "trajectories"))))]
        if lost:
            yield f"lost: {lost}"
    elif words[0] in ("run", "verify") and code == 0:
        mine = rows(out)
        if words[0] == "verify":
            same(right, mine)  # all rows are in the sample
        elif "--until" not in words and len(mine) < len(right):
            yield "lost rows"

"""Designs on disk: where they are kept, what stands in a file, which files are not believed."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest
from railstate.estimators import design_cache
from railstate.scenarios.errors import Infeasible


def test_what_stands_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The digest of the rest, then the design or why there is none; written beside it first. In any order of keys the
    inputs are the same; what is damaged is designed anew."""
    folder, moved, replace = tmp_path / "a" / "b", list[tuple[Path, Path]](), os.replace

    def noted(source: str, to: Path) -> None:
        moved.append((Path(source), to))
        replace(source, to)

    def infeasible() -> dict[str, Any]:
        raise Infeasible("nowhere: größer")

    monkeypatch.setenv("RAILSTATE_CACHE", str(folder))
    monkeypatch.setattr(os, "replace", noted)
    for inputs, again, design, entry in (
            ({"x": [1.5, None], "y": 2}, {"y": 2, "x": [1.5, None]}, lambda: {"K": [[0.1]]}, {"value": {"K": [[0.1]]}}),
            ([1], [1], infeasible, {"infeasible": "nowhere: größer"})):
        path = folder / f"{hashlib.sha256(json.dumps(inputs).encode()).hexdigest()}.json"
        text = json.dumps(entry)
        whole = f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}".encode()
        for damage in (None, b"", whole[:-1], whole + b"\n", whole.replace(b"\n", b""), b"\xff" + whole,
                       b"0" + whole[1:]):
            if damage is not None:
                path.write_bytes(damage)
            for asked, make, cached in ((inputs, design, False), (again, None, True)):
                if "value" in entry:
                    found: Any = design_cache.remember(asked, make)  # pyright: ignore
                    assert found == design_cache.Cached(entry["value"], cached)
                else:
                    with pytest.raises(Infeasible, match=r"^nowhere: größer$"):
                        design_cache.remember(asked, make)  # pyright: ignore
                assert path.read_bytes() == whole
    assert all(source.parent == to.parent == folder and source.name.startswith(".design-") for source, to in moved)
    assert len(moved) == 14 and len(list(folder.iterdir())) == 2


def test_where_designs_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAILSTATE_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert design_cache.folder() == tmp_path / "railstate"
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("RAILSTATE_CACHE", str(tmp_path / "file" / "no"))
    assert design_cache.remember({"a": 1}, lambda: {"b": 2.5}) == design_cache.Cached({"b": 2.5}, False)


@pytest.mark.parametrize("swept", [True, False])
def test_a_design_that_cannot_be_written_leaves_nothing_behind(
        swept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where what was written so far has been swept away meanwhile."""
    monkeypatch.setenv("RAILSTATE_CACHE", str(tmp_path))

    def full(source: str, _: object) -> None:
        if swept:
            os.unlink(source)
        raise OSError("no space left")

    with monkeypatch.context() as disk:
        disk.setattr(os, "replace", full)
        assert design_cache.remember([1], lambda: {"a": 1}) == design_cache.Cached({"a": 1}, False)
        assert list(tmp_path.iterdir()) == []
    assert [design_cache.remember([1], lambda: {"a": 2}).cached for _ in range(2)] == [False, True]

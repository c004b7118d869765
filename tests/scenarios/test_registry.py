"""Which settings count of those that packages register, in which order, and what is said of the others."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
from railstate.scenarios import registry
from railstate.scenarios.errors import InputError
from railstate.scenarios.linear import LinearSystem
from railstate.scenarios.metro import Metro


@dataclass(frozen=True)
class Package:
    """A distribution."""

    name: str


class Point(SimpleNamespace):
    """An entry point."""

    def __lt__(self, other: Point) -> bool:
        return (self.name, self.value) < (other.name, other.value)

    def load(self) -> Any:
        """What it stands for, or what comes of it."""
        return self.what() if callable(self.what) and not isinstance(self.what, type) else self.what


class Own(LinearSystem):
    """A setting of somebody's."""

    kind = "own"


class Again(LinearSystem):
    """One of a kind that there is."""


class Nothing(LinearSystem):
    """One without a kind."""

    kind = None  # pyright: ignore[reportAssignmentType]


def raised(error: BaseException) -> Any:
    raise error


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the suite last: they come first all the same."""
    found = [("own", "theirs", Own), ("again", "theirs", Again), ("nothing", "theirs", Nothing),
             ("word", "theirs", "x"), ("a-leaving", "theirs", lambda: os._exit(3)),
             ("b-interrupted", "theirs", lambda: raised(KeyboardInterrupt("mine"))),
             ("linear", "theirs", Own), ("metro", registry.SUITE, Metro),
             ("linear", registry.SUITE, LinearSystem), ("nameless", "", Own)]
    every = [Point(name=name, value=f"{package}:{name}", what=what, dist=Package(package) if package else None)
             for name, package, what in found]
    monkeypatch.setattr(registry, "entry_points", lambda group: every if group == registry.GROUP else [])


@pytest.mark.usefixtures("points")
def test_which_settings_count(recwarn: pytest.WarningsRecorder) -> None:
    leave, usual = os._exit, signal.getsignal(signal.SIGTERM)
    found = registry.settings.__wrapped__()
    assert list(found.items()) == [("linear", LinearSystem), ("metro", Metro), ("own", Own)]
    assert [str(one.message) for one in recwarn.list] == [
        "plug-in a-leaving (theirs:a-leaving) is left out: SystemExit: 3",
        "plug-in b-interrupted (theirs:b-interrupted) is left out: KeyboardInterrupt: mine",
        "plug-in again is left out: there is a setting of kind linear already",
        "plug-in nothing is left out: no subclass of railstate.scenarios.setting.Setting",
        "plug-in own is left out: there is a setting of kind own already",
        "plug-in word is left out: no subclass of railstate.scenarios.setting.Setting"]
    assert [one.filename for one in recwarn.list] == [registry.__file__] * 2 + [__file__] * 4
    recwarn.clear()
    registry.load_group(registry.GROUP)
    assert [one.filename for one in recwarn.list] == [__file__] * 2
    assert os._exit is leave and signal.getsignal(signal.SIGTERM) is usual


@pytest.mark.usefixtures("points")
def test_whose_a_point_is() -> None:
    assert [registry.distribution(Point(dist=dist)) for dist in (Package("a"), None)] == [
        "a", "a package without a name"]
    assert list(registry.own_points.__wrapped__(registry.GROUP)) == ["linear", "metro"]


def test_a_kind_that_there_is_not() -> None:
    with pytest.raises(InputError) as caught:
        registry.setting_of({"plant": {"kind": "tram"}}, "a.toml")
    assert str(caught.value) == ("a.toml: plant.kind = \"tram\" is unknown; allowed: braking, coupled-cars, linear, "
                                 "metro, moving-block, odometry, recorded")
    for table in ({}, {"plant": 3}):
        with pytest.raises(InputError, match=r'^a\.toml: plant\.kind = "" is unknown; '):
            registry.setting_of(table, "a.toml")

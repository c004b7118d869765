"""Compare estimators of a train's state on the same simulated truths: `railstate.run("ningbo-metro", ["ekf", Mine])`.

This module is installed as `railstate` itself. It names what the modules of `railstate.benchmarks.api` offer, and
imports none of them before it is used."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from railstate.benchmarks.api.listing import estimators, scenarios  # pyright: ignore[reportMissingImports]
    from railstate.benchmarks.api.results import Results, load  # pyright: ignore[reportMissingImports]
    from railstate.benchmarks.api.runs import run  # pyright: ignore[reportMissingImports]
    from railstate.benchmarks.api.simulation import simulate  # pyright: ignore[reportMissingImports]
    from railstate.estimators.interface import Estimate, Estimator  # pyright: ignore[reportMissingImports]
    from railstate.scenarios.errors import InputError  # pyright: ignore[reportMissingImports]

    __version__: str

__all__ = ["Estimate", "Estimator", "InputError", "Results", "estimators", "load", "run", "scenarios", "simulate"]

_HOMES = {**dict.fromkeys(("Results", "load"), "railstate.benchmarks.api.results"),
          "run": "railstate.benchmarks.api.runs",
          "simulate": "railstate.benchmarks.api.simulation",
          **dict.fromkeys(("Estimate", "Estimator"), "railstate.estimators.interface"),
          "InputError": "railstate.scenarios.errors"}
_BOTH = ("estimators", "scenarios")
"""Packages that are called as well: `railstate.estimators()` lists what `railstate.estimators` holds."""


class _Module(ModuleType):
    """A module that goes by its name where a notebook's function that uses it is pickled."""

    def __reduce__(self) -> Any:
        return import_module, (self.__name__,)


class _Called(_Module):
    """A package that lists its content when it is called."""

    def __call__(self) -> Any:
        return getattr(import_module("railstate.benchmarks.api.listing"), self.__name__.rpartition(".")[2])()


class _Face(_Module):
    """`railstate`: its packages become attributes when they are imported, from wherever that is."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _BOTH and type(value) is ModuleType:
            value.__class__ = _Called
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        found = getattr(import_module(_HOMES[name]), name)
    elif name in (*_BOTH, "benchmarks"):
        return import_module(f"railstate.{name}")
    elif name == "__version__":
        from importlib.metadata import version

        found = version("railstate")
    else:
        raise AttributeError(f"module 'railstate' has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})

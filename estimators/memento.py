"""What an object is made of, remembered and put back in place: the snapshots of estimators.

Arrays are put back into themselves, so that whatever shares their memory (views, named tuples of them) still does."""

from __future__ import annotations

from collections.abc import Iterable
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
from pydantic import BaseModel

from ..scenarios.model import DesignModel

FIXED = (DesignModel, BaseModel, FunctionType, BuiltinFunctionType, MethodType, ModuleType, type, str, bytes, int,
         float, complex, bool, type(None), np.generic, np.dtype)
"""What no estimator changes: it is remembered by reference."""


class Memento:
    """All that can be reached from `thing` but for the design model and parameters; `restore` puts it back, any number
    of times. Arrays are copied, random generators remembered by their state."""

    def __init__(self, thing: object) -> None:
        self._arrays: list[tuple[np.ndarray, np.ndarray]] = []
        self._lists: list[tuple[Any, Any]] = []
        self._objects: list[tuple[dict[str, Any], dict[str, Any]]] = []
        self._generators: list[tuple[np.random.Generator, Any]] = []
        self._seen: dict[int, object] = {}
        left = [thing]  # not by recursion: chains of objects may be long
        while left:
            left += self._parts(left.pop())

    def _parts(self, thing: Any) -> Iterable[Any]:
        """What hangs on a thing, which is remembered."""
        if isinstance(thing, FIXED) or id(thing) in self._seen:
            return ()
        self._seen[id(thing)] = thing
        if isinstance(thing, np.ndarray):
            self._arrays.append((thing, thing.copy()))
        elif isinstance(thing, np.random.Generator):
            self._generators.append((thing, thing.bit_generator.state))
        elif isinstance(thing, list | dict | set):
            self._lists.append((thing, thing.copy()))
            return thing.values() if isinstance(thing, dict) else thing
        elif isinstance(thing, tuple | frozenset):
            return thing
        elif hasattr(thing, "__dict__") and not callable(thing) and not type(thing).__module__.startswith("cvxpy"):
            self._objects.append((vars(thing), dict(vars(thing))))
            return vars(thing).values()
        return ()

    def restore(self) -> None:
        """Everything as it was."""
        for attributes, before in self._objects:
            attributes.clear()
            attributes.update(before)
        for thing, before in self._lists:
            thing.clear()
            thing.extend(before) if isinstance(thing, list) else thing.update(before)
        for array, before in self._arrays:
            if array.flags.writeable:
                array[...] = before
        for generator, state in self._generators:
            generator.bit_generator.state = state

"""Every default and every constant of the three packages, whole: one that changes has to be meant.

Also that the tables of scenario files and the parameters of estimators admit what they did."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from enum import Enum
from types import ModuleType
from typing import Any

import railstate
from numba.core.ccallback import CFunc
from numba.core.dispatcher import Dispatcher
from pydantic import BaseModel

LEFT_OUT = ("templates", "published.computed")
"""What is text, and what repeats papers' tables."""


def modules() -> Iterator[ModuleType]:
    for package in ("benchmarks", "estimators", "scenarios"):
        top = importlib.import_module(f"railstate.{package}")
        for found in sorted(info.name for info in pkgutil.walk_packages(top.__path__, f"{top.__name__}.")):
            if not any(f".{word}" in found for word in LEFT_OUT) and not found.endswith("__main__"):
                yield importlib.import_module(found)


def plain(value: Any) -> bool:
    if isinstance(value, tuple | list | set | frozenset):
        return all(map(plain, value))
    if isinstance(value, dict):
        return all(plain(part) for pair in value.items() for part in pair)
    return value is None or (isinstance(value, str | int | float | bool) and not isinstance(value, Enum))


def shown(value: Any) -> str:
    if isinstance(value, set | frozenset):
        value = sorted(value)
    text = repr(value)
    text = text if plain(value) else getattr(value, "__qualname__", re.sub(r" at 0x\w+|<railstate.*", "", text))
    return text if len(text) < 400 else f"{text[:300]} .. {len(text)} .. {text[-60:]}"


def fields(model: type[BaseModel]) -> Iterator[str]:
    """The fields that a model adds to its base: what is admitted, and the default."""
    for name, field in model.model_fields.items():
        if name not in getattr(model, "__annotations__", {}):
            continue
        said = f"{field.annotation} {field.metadata or ''}"
        admitted = re.sub(r"\w+\.(?=\w)|FieldInfo\(|annotation=NoneType, required=True, |description=(['\"]).*?\1[,)]"
                          r"|json_schema_extra=\{.*?\}| at 0x\w+|\s+", " ", said)
        default = "" if field.is_required() else f" = {shown(field.get_default(call_default_factory=True))}"
        told = "" if field.description else " (not described)"
        yield f"  {name}:{re.sub(' +', ' ', ' ' + admitted)}{default}{told}".rstrip()


def defaults(name: str, thing: Callable[..., Any]) -> Iterator[str]:
    try:
        parameters = inspect.signature(getattr(thing, "py_func", thing)).parameters.values()
    except (TypeError, ValueError):
        return
    found = [f"{p.name}={shown(p.default)}" for p in parameters if p.default is not p.empty]
    if found:
        yield f"  {name}({', '.join(found)})"


def of(module: ModuleType) -> Iterator[str]:
    for name, value in vars(module).items():
        if name.startswith("__"):
            continue
        if name.isupper() and plain(value):
            yield f"  {name} = {shown(value)}"
        if getattr(value, "__module__", "") != module.__name__ or name != getattr(value, "__name__", ""):
            continue
        if inspect.isclass(value) and issubclass(value, BaseModel):
            usual = getattr(value.__base__, "model_config", {})
            config = {key: said for key, said in value.model_config.items() if usual.get(key) != said}
            yield from [f"  {name}: {config}"] if config else []
            yield from (f"  {name}.{line.strip()}" for line in fields(value))
        elif inspect.isclass(value):
            if is_dataclass(value):
                flags = value.__dataclass_params__  # pyright: ignore[reportAttributeAccessIssue]
                yield f"  {name}:{' frozen' * flags.frozen}{' eq' * flags.eq}{' order' * flags.order}"
            yield from defaults(name, value)
            for part, method in vars(value).items():
                method = getattr(method, "__func__", method)
                if inspect.isclass(method) and issubclass(method, BaseModel):
                    yield from (f"  {name}.{part}.{line.strip()}" for line in fields(method))
                elif inspect.isfunction(method) and (part == "__call__" or not part.startswith("__")):
                    yield from defaults(f"{name}.{part}", method)
                elif plain(method) and not part.startswith("__") and not hasattr(value, "__dataclass_fields__"):
                    yield f"  {name}.{part} = {shown(method)}"
        elif callable(value):
            yield from defaults(name, value)


def compiled(module: ModuleType) -> Iterator[str]:
    """How what is compiled in a module is compiled, and whether its machine code is kept."""
    kinds = dict[str, list[str]]()
    for name, value in vars(module).items():
        if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__:
            options = {key: said for key, said in value.targetoptions.items() if said not in (None, True)}
            kept = type(value._cache).__name__, type(getattr(value._cache, "_cache", None)).__name__
            kinds.setdefault(f"{type(value).__name__} {kept} {options}", []).append(name)
        elif isinstance(value, CFunc) and value._pyfunc.__module__ == module.__name__:
            kinds.setdefault(f"cfunc {type(value._cache).__name__} {value._sig}", []).append(name)
    yield from (f"  {kind}: {' '.join(names)}" for kind, names in kinds.items())


def test_defaults_and_constants(expected: Callable[[str, str], None]) -> None:
    lines = list[str]()
    for module in modules():
        if found := [*of(module), *compiled(module)]:
            lines += [module.__name__.removeprefix("railstate."), *found]
    assert railstate.__name__ == "railstate"
    expected("defaults", "\n".join(lines))

"""The base of every table of a scenario file. Under the schema, since what all settings share is made of it too."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Strict(BaseModel):
    """Base of every table of a scenario file: no unknown keys, no changes after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=(),
                              defer_build=True)  # made when a file is read, not on import


def key(text: str, unit: str = "") -> Any:
    """What a key of a scenario file says, and in which unit ("1": a plain number, "": no number)."""
    shown = "" if unit in ("", "1") else f" {unit}" if unit.startswith("[") else f" [{unit}]"
    return Field(description=text + shown, json_schema_extra={"unit": unit} if unit else None)


KIND = key("which of several this is")

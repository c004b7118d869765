"""What there is: scenarios with their variants, estimators with what they need and claim."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from ...scenarios.errors import InputError
from ...scenarios.files import outline
from ...scenarios.registry import scenario_files
from ..planning.catalogue import Catalogue

if TYPE_CHECKING:
    import pandas as pd


def scenarios() -> pd.DataFrame:
    """A line per built-in or plugged-in scenario: what it is about, its variants (the first is the default), those that
    run on request alone, its estimators."""
    import pandas as pd

    return pd.DataFrame(scenario_lines())


def estimators() -> pd.DataFrame:
    """A line per installed estimator: what it is, its family, what it needs of a design model, what it claims. One that
    does not import is left out, with a warning."""
    import pandas as pd

    return pd.DataFrame(estimator_lines())


def scenario_lines() -> list[dict[str, Any]]:
    """The lines of `scenarios`."""
    rows = []
    for name in scenario_files():
        table, variants = outline(name)
        rows.append({"scenario": name, "about": table.get("title", ""),
                     "variants": tuple(variant for variant, usual in variants.items() if usual),
                     "variants on request": tuple(variant for variant, usual in variants.items() if not usual),
                     "estimators": tuple(table.get("estimators", {}))})
    return rows


def estimator_lines() -> list[dict[str, Any]]:
    """The lines of `estimators`."""
    catalogue, lines = Catalogue(), []
    for name in catalogue.names():
        try:
            found = catalogue[name]
        except InputError as error:
            warnings.warn(f"{error}: left out", stacklevel=2)
        else:
            lines.append({"estimator": name, "about": found.summary, "family": found.family, "needs": found.needs,
                          "claims": ("mean", *found.claims), "source": found.source})
    return lines

"""Smoothers on built-in variants with Gaussian noise: less error than their filter, the whole trip less than a lag."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.scenarios.channels import Delay
from railstate.scenarios.files import load

from .test_floor import gaussian, table


def cases() -> list[object]:
    """Gaussian variants in which some packets come in time; those that run on request are long studies."""
    out: list[object] = []
    for name in gaussian():
        scenario, _, variant = name.partition("/")
        found = load(scenario)
        if not isinstance(getattr(found.setting(variant).config, "channel", None), Delay):
            out.append(pytest.param(name, marks=pytest.mark.long) if variant in found.requested else name)
    return out


def compare(name: str, *smoothers: str) -> None:
    """Their errors are under the filter's in every quantity, the whole trip's no more than a lag's (by chance 2 %)."""
    frame = table(name, range(25), ("ekf", *smoothers))
    assert set(frame["status"]) == {"ok"}
    for column in (column for column in frame.columns if column.startswith("rmse:") and frame[column].notna().any()):
        pooled = {label: np.sqrt((part[column] ** 2).mean()) for label, part in frame.groupby("estimator")}
        assert all(pooled[label] < pooled["ekf"] for label in smoothers), (column, pooled)
        assert pooled["rts"] <= 1.02 * pooled.get("fixed-lag", np.inf), (column, pooled)


@pytest.mark.parametrize("name", cases())
def test_a_smoother_errs_less_than_its_filter(name: str) -> None:
    compare(name, *(["fixed-lag"] if name.startswith("rap") else []), "rts")


@pytest.mark.long
def test_a_fixed_lag_errs_less_on_the_metro() -> None:
    compare("ningbo-metro/gaussian", "fixed-lag", "rts")

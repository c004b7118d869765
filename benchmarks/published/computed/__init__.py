"""Numbers of the papers that are no summary of rows: gains, bounds, ratios, claims. A module a paper.

A cell of a paper's file names one with its arguments; each names the rows it draws on."""

from . import base, faruqi2019, liu2025, zheng2015, zou2018, zou_rap
from .base import Computation

COMPUTATIONS: dict[str, Computation] = {
    name: one for module in (base, faruqi2019, liu2025, zheng2015, zou2018, zou_rap)
    for name, one in module.COMPUTATIONS.items()}

__all__ = ["COMPUTATIONS", "Computation"]

"""Compiled functions over small matrices with the runs as last axis."""

from .core import (
    apply,
    backward,
    cholesky,
    congruence,
    factorise,
    forward,
    gather2,
    gather3,
    kernel,
    scatter2,
    scatter3,
    tile_width,
)

__all__ = [
    "apply",
    "backward",
    "cholesky",
    "congruence",
    "factorise",
    "forward",
    "gather2",
    "gather3",
    "kernel",
    "scatter2",
    "scatter3",
    "tile_width",
]

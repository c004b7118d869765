"""Recordings as they are: one file format a module, told apart by what a file begins with, not by its name.

`read` turns any of them into a `Table` of named columns and says how it was read."""

from .reading import read
from .table import Table

__all__ = ["Table", "read"]

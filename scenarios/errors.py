"""The errors a user can meet, each with one clear message.

They live in the lowest layer because scenario files, plug-ins and results folders all raise them."""

from __future__ import annotations


class InputError(Exception):
    """Bad input: the message names the file, the field and what is allowed. The command line exits with 2."""


class Infeasible(Exception):
    """A design problem has no (trustworthy) solution. Every run of the estimator gets a row with status `infeasible`.

    The message says at which parameters, which constraint family, and what to try."""


class Unsupported(Infeasible):
    """An estimator cannot work with this design model: the message says what it needs and the model lacks."""

"""Channels between the sensors and the estimator: which readings arrive at which step of which run, and how late.

Shared by every plant, a kind a module; a channel only ever draws from the stream "channel" and those beside it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..arrays import Index, Mask
from .base import Arrived, Base, Sent
from .csma import Csma
from .delay import Delay
from .gilbert_elliott import GilbertElliott
from .loss import Bernoulli, Ideal
from .markov_random_access import MarkovRandomAccess
from .nodes import OneAtATime
from .random_access import RandomAccess
from .round_robin import RoundRobin
from .try_once_discard import TryOnceDiscard

Channel = Annotated[Ideal | Bernoulli | GilbertElliott | Csma | Delay | RandomAccess | MarkovRandomAccess | RoundRobin
                    | TryOnceDiscard, Field(discriminator="kind")]

__all__ = ["Arrived", "Base", "Bernoulli", "Channel", "Csma", "Delay", "GilbertElliott", "Ideal", "Index",
           "MarkovRandomAccess", "Mask", "OneAtATime", "RandomAccess", "RoundRobin", "Sent", "TryOnceDiscard"]

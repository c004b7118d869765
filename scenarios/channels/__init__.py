"""Channels between the sensors and the estimator: which measurement elements arrive at which step of which run.

Shared by every plant; a channel only ever draws from the stream "channel"."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..arrays import Index, Mask
from .base import Base
from .csma import Csma
from .loss import Bernoulli, Ideal
from .random_access import RandomAccess

Channel = Annotated[Ideal | Bernoulli | Csma | RandomAccess, Field(discriminator="kind")]

__all__ = ["Base", "Bernoulli", "Channel", "Csma", "Ideal", "Index", "Mask", "RandomAccess"]

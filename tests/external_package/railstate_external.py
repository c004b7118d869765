"""An alpha-beta filter as someone outside the suite would write it: innovations move position and speed by shares.

For models whose first two states are position and speed and whose first measurement is the position."""

import numpy as np
from pydantic import Field
from railstate.estimators.interface import Estimate, Estimator, Parameters
from railstate.scenarios.errors import Unsupported


class AlphaBetaParameters(Parameters):
    """Shares of the innovation."""

    alpha: float = Field(0.3, gt=0, le=1, description="share that moves the position")
    beta: float = Field(0.05, ge=0, le=1, description="share, per sampling period, that moves the speed")


class AlphaBeta(Estimator):
    """x- = f(x, u); position += alpha (y - position), speed += beta / T (y - position)."""

    Parameters = AlphaBetaParameters
    summary = "alpha-beta filter (external package)"
    source = "Bar-Shalom, Li, Kirubarajan 2001, section 6.5"

    @classmethod
    def require(cls, model):
        super().require(model)
        if model.states[:2] != ("position", "speed"):
            raise Unsupported(f"AlphaBeta needs states beginning with position, speed; here {', '.join(model.states)}")

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x = model.initial_mean.copy()
        self.shares = np.zeros((model.nx, 1))
        self.shares[0], self.shares[1] = self.parameters.alpha, self.parameters.beta / model.period

    def predict(self, u, interval):
        self.x = self.model.transition(self.x, u, interval)

    def update(self, measurement):
        self.x = self.x + self.shares * np.where(measurement.received[0], measurement.y[0] - self.x[0], 0.0)

    def estimate(self):
        return Estimate(self.x)

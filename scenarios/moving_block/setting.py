"""Two trains on a ring under moving or fixed block, localized by encoder and tags, controlled by the estimates.

After Faruqi et al., IJASEIT 9(6), 2019; the pieces are in moving_block_track, _control, _trains and _config."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, cast

import numpy as np

from ..arrays import Array
from ..augmented import Extra
from ..measurement import Interval
from ..measurement import told as told_covariance
from ..model import DesignModel
from ..randomness import Streams
from ..setting import Matched, Outcome, Quantity, Setting
from ..world import Sensing, World
from .config import Knowledge, MovingBlockConfig
from .matched import matched
from .track import StadiumTrack, travelled
from .trains import TwoTrains


class MovingBlock(Setting[MovingBlockConfig]):
    """State: map position x, y of the leader A, then of the follower B, m; input: each train's measured distance, m.

    One state of both trains, whose models do not touch, lets every generic estimator localize both. x and y are scored
    over both trains together, each until its own laps are done: squared errors averaged over trains and steps."""

    kind: ClassVar[str] = "moving-block"
    Config = MovingBlockConfig
    files: ClassVar[tuple[str, ...]] = ("moving-block.toml",)
    following: ClassVar[bool] = False
    shown: ClassVar[dict[str, tuple[str, float]]] = {"gap": ("cm", 100.0)}

    def __init__(self, config: MovingBlockConfig) -> None:
        super().__init__(config)
        self.track = StadiumTrack(config.plant.track.straight, config.plant.track.radius)

    def quantities(self) -> tuple[Quantity, ...]:
        shown = ("cm", 100.0)
        return (Quantity("x", "m", ((0, 1.0), (2, 1.0)), shown=shown),
                Quantity("y", "m", ((1, 1.0), (3, 1.0)), shown=shown))

    def table(self) -> tuple[tuple[str, str], ...]:
        """RMSE of the map position, the gap and whether it was ever too small, the lap time."""
        return (*(("rmse", item.name) for item in self.quantities()), ("mean", "gap"), ("min", "gap"),
                ("violations", "gap"), ("mean", "lap"), ("nees", "state"))

    def world(self, streams: Streams) -> World:
        return TwoTrains(self.config, self.track, streams, self.sensing())

    def matched(self, runs: int) -> Matched | None:
        return matched(self.config, self.track, runs)

    def sensing(self) -> Sensing:
        return Sensing(("x-a", "y-a", "x-b", "y-b"), np.full(4, max(self.config.sensors.tags.sd, 1e-3)))

    def design_model(self, knowledge: Mapping[str, Any], initial_mean: Array) -> DesignModel:
        """Eq. (30) with the heading at the midpoint; process noise per metre travelled, tags' noise isotropic (m^2)."""
        told: Knowledge = self.resolve_knowledge(knowledge)
        identity = np.eye(4)[:, :, None]

        def process_covariance(x: Array, u: Array, interval: Interval) -> Array:
            variance = told.process_variance * np.abs(travelled(u, interval.share))
            out = np.zeros((4, 4, u.shape[1]))
            for i in range(4):
                out[i, i] = variance[i // 2]
            return out

        return DesignModel(
            states=("x-a", "y-a", "x-b", "y-b"),
            measurements=("x-a", "y-a", "x-b", "y-b"),
            period=self.config.time.period,
            transition=self.track.transition,
            measurement=lambda x, step: x,
            transition_jacobian=self.track.jacobian,
            input_jacobian=self.track.input_jacobian,
            measurement_jacobian=lambda x, step: identity,
            linear_measurement=True,
            process_covariance=process_covariance,
            measurement_covariance=told_covariance(lambda step: told.tag_variance * identity),
            initial_mean=initial_mean,
            initial_covariance=told.start_variance * identity,
        )

    def extras(self, knowledge: Mapping[str, Any]) -> dict[str, tuple[Extra, ...]]:
        """The scale of each train's encoder: it counts 1 + s metres a metre."""
        encoder = self.config.sensors.encoder
        return {"encoder-scale": tuple(
            Extra(f"encoder-scale-{train}", "1", "constant", encoder.bias_sd, mean=encoder.bias_mean, input=i)
            for i, train in enumerate("ab"))}

    def outcomes(self, world: World, metrics: Mapping[tuple[str, str], Array]) -> dict[Outcome, Array]:
        """rmse-per-train of x, y (m): the mean of the two trains' own RMSE, as the paper's Table II averages.

        x-a .. y-b: of the leader and of the follower alone.

        mean gap (m, time mean of the true gap), least gap (m), violations (1 where the true gap was ever under d_M),
        mean lap (s, over both trains; NaN where a run ran out of steps, which `unfinished` counts)."""
        trains = cast(TwoTrains, world)
        records = trains.records
        own = np.sqrt(records.squared / np.maximum(records.counted, 1))
        laps = (trains.lap_times[0] + trains.lap_times[1]) / (2 * self.config.plant.trains.laps)
        return {
            ("rmse-per-train", "x", "m"): (own[0] + own[2]) / 2,
            ("rmse-per-train", "y", "m"): (own[1] + own[3]) / 2,
            **{("rmse-per-train", f"{axis}-{train}", "m"): own[2 * t + i]
               for t, train in enumerate("ab") for i, axis in enumerate("xy")},
            ("mean", "gap", "m"): records.gap_sum / records.driven,
            ("min", "gap", "m"): records.gap_least,
            ("violations", "gap", "1"): (records.gap_least < self.config.plant.control.safe_gap - 1e-9).astype(float),
            ("mean", "lap", "s"): laps,
            ("unfinished", "lap", "1"): np.isnan(laps).astype(float),
        }

    def batch_bytes(self) -> int:
        return self.config.time.steps * 8 * (40 + 15)

"""Every kind of channel, fault, disturbance and sensor, its keys off their defaults: truth, readings, what is told of
them, whole, beside committed text (to renew it: `tests/expected.py`)."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

from railstate.benchmarks.api.simulation import simulated
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams

from ..benchmarks.test_expected import SHORT
from ..benchmarks.test_python_expected import columns_of
from ..expected import digest
from .test_models_expected import told

BASES: dict[str, tuple[str, dict[str, Any]]] = {
    "linear": ("rap-example-1/corrected", {"time.steps": 40}), "metro": ("ningbo-metro/gaussian", {}),
    "cars": ("cbtc-csma/uniform", {"time.steps": 30}), "moving": ("moving-block/law-p", {"time.steps": 40}),
    "braking": ("braking-rate/paper", {"time.steps": 30}),
    "odometry": ("odometry/wet-radar", SHORT["odometry/wet-radar"])}
KINDS = """
linear channel={"kind":"ideal"} channel={"kind":"bernoulli","p":0.3}
  channel={"kind":"bernoulli","p":0.3,"silent":"hold"}
  channel={"kind":"gilbert-elliott","p_good_bad":0.2,"p_bad_good":0.3,"p_good":0.9,"p_bad":0.1}
  channel={"kind":"gilbert-elliott","p_good_bad":0.2,"p_bad_good":0.3} channel={"kind":"csma","p":0.3,"trains":3}
  channel={"kind":"csma","p":0.3,"trains":[2,5],"traffic":"uniform"}
  channel={"kind":"csma","p":0.3,"trains":[2,5],"traffic":"birth-death","rate":0.2}
  channel={"kind":"delay","steps":2} channel={"kind":"delay","steps":[1,4]}
  channel={"kind":"delay","steps":[0,4],"reorder":False} channel={"kind":"delay","steps":[0,4],"reorder":True}
  channel={"kind":"delay","steps":[0,2],"loss":{"kind":"bernoulli","p":0.6}}
  channel={"kind":"random-access","p":[0.3,0.7],"nodes":[[0],[1]]} channel={"kind":"round-robin","nodes":[[1],[0]]}
  channel={"kind":"round-robin"} channel={"kind":"markov-random-access","stay":0.7}
  channel={"kind":"markov-random-access","transition":[[0.2,0.8],[0.5,0.5]],"nodes":[[1],[0]]}
  channel={"kind":"try-once-discard"} channel={"kind":"try-once-discard","nodes":[[1],[0]],"silent":"hold"}
  plant.index="arrival" score.skip=7.0 knowledge.R=[[2.0,0.0],[0.0,3.0]] knowledge.Q=2.0 knowledge.p=[0.4,0.6]
  faults=[{"kind":"outliers","sensors":["y1"],"share":0.5,"size":3.0,"sign":"plus"}]
metro faults=[{"kind":"stuck","sensors":["speed"],"from":10.0,"to":20.0}]
  faults=[{"kind":"stuck","sensors":["position"],"every":30.0,"lasts":5.0}]
  faults=[{"kind":"drift","sensors":["position"],"rate":0.3,"from":20.0,"to":60.0}]
  faults=[{"kind":"drift","sensors":["position","speed"],"every":20.0,"lasts":4.0,"told":True}]
  faults=[{"kind":"dropout","sensors":["speed"],"from":12.0,"to":13.0},{"kind":"outliers","sensors":["position"]}]
  faults=[{"kind":"burst","sensors":["position"],"p_good_bad":0.1,"p_bad_good":0.5}]
  faults=[{"kind":"outliers","sensors":["speed"],"share":0.3,"size":5.0,"sign":"plus","told":True}]
  faults=[{"kind":"student-t","sensors":["speed"],"dof":4.0}]
  faults=[{"kind":"student-t","sensors":["speed"],"dof":1.5}]
  faults=[{"kind":"jump","sensors":["position"],"size":-8.0,"from":40.0}]
  faults=[{"kind":"jump","size":5.0,"truth":True}]
  faults=[{"kind":"jump","size":5.0,"from":30.0,"truth":True}]
  faults=[{"kind":"stamps","sensors":["position"],"offset":0.6}]
  faults=[{"kind":"stamps","sensors":["speed"],"offset":-0.4,"from":30.0}]
  disturbance.form="constant" disturbance.form="white" disturbance.form="sinusoid" disturbance.form="switching"
  disturbance.form="physical" sensors.noise="biased" sensors.noise="uniform" sensors.use=["position"]
  plant.start_speed=2.0
  sensors.use=["wheel-a","balise"] knowledge.moments="uniform" knowledge.densities="uniform" knowledge.kappa=0.1
  sensors.use=["gnss","radar","accelerometer"] plant.start_error=[3.0,0.5] knowledge.initial_sd=[2.0,0.3]
  plant.start_speed=3.0 plant.controller.effort=[-0.5,0.5] plant.controller.overrun=4.0
  channel={"kind":"delay","steps":[0,3]} knowledge.w_bar=0.2 knowledge.sigma_w=0.3
cars channel.trains=3 channel.traffic="birth-death" channel.p=0.2 plant.start="zero" disturbance.scale=2.0
  disturbance.ramp=0.001 plant.slack=0.1
  plant.masses=[9e4,8e4,7e4,8e4,9e4,9e4] plant.drive="push-pull" knowledge.position_noise=0.5 performance.speed=2.0
  sensors.position_weight=2.0 knowledge.trains=[2,4] knowledge.initial_sd=[2.0,0.5] headway.reaction_time=3.0
  channel={"kind":"random-access-cars"} knowledge.theta=0.97 knowledge.delta=200.0 headway.speeds=[50.0]
  channel={"kind":"try-once-discard"} channel={"kind":"bernoulli","p":0.5} plant.cars=4
moving sensors.tags.count=20 sensors.tags.missed=0.3 sensors.tags.sd=0.05 sensors.encoder.pulse=0.01
  sensors.encoder.bias_sd=0.1 sensors.encoder.noise_sd=0.2 plant.control.law="R" plant.control.braking=0.5
  plant.control.leader_ratio=0.5 plant.control.safe_gap=0.3 plant.control.margin=0.3 plant.control.reserve=5.0
  plant.control.steered_by="tags" plant.trains.dwell=1.0 plant.trains.stops=[[0,2],[0,1]] plant.trains.top_speed=0.3
  plant.track.radius=0.6 channel={"kind":"bernoulli","p":0.6} channel={"kind":"delay","steps":[0,2]}
braking plant.rate_drift=0.01 plant.target=[[0.0,0.0],[2.0,-1.0],[4.0,0.5]] knowledge.grid=[1.0,0.5,0.0]
  sensors.speed_variance=0.5 sensors.displacement_variance=2.0 knowledge.rate_prior="normal" knowledge.nominal=0.5
  knowledge.model="augmented" knowledge.model="scheduled" plant.rate_steps=[[2.0,-0.4]] plant.until_standstill=True
  disturbance.hold="held" disturbance.speed_variance_rate=0.2 sensors.control_acceleration_variance=0.1
  plant.response_time=1.5 plant.pade_rate=2.0 knowledge.speed_variance=0.9 knowledge.rate_variance_rate=0.01
odometry plant.adhesion.low=[] plant.adhesion.friction=[0.04,0.06] plant.adhesion.strength=[0.1,0.2]
  plant.driver.asked=[-0.9,0.3] plant.driver.courage=[0.5,0.6] plant.driver.dwell=[3.0,5.0] sensors.balise.missed=0.5
  plant.driver.first=9.0 plant.tunnels=[[50.0,100.0],[200.0,380.0]] sensors.use=["gnss"]
  sensors.use=["wheel-a","radar"]
  sensors.use=["wheel-a","wheel-b","balise"] knowledge.motion="wheel-a" knowledge.motion="minmax"
  sensors.gnss.every=3.0 sensors.gnss.slow=9.0 sensors.gnss.memory=5.0 sensors.gnss.jump=0.3 sensors.gnss.size=30.0
  sensors.gnss.outage=[60.0,20.0] sensors.gnss.lasts=[1.0,2.0] sensors.radar.scale=0.05 sensors.radar.noise=0.5
  sensors.radar.least=5.0 sensors.accelerometer.bias=0.2 sensors.accelerometer.noise=0.3
  sensors.accelerometer.drift=0.1
  sensors.balise.detection=2.0 sensors.balise.location=[3.0,5.0] sensors.balise.reader=[0.5,1.0]
  sensors.wheel.pulses=20
  sensors.wheel.diameter_error=0.03 sensors.wheel.spread="gaussian" sensors.wheel.creep=0.01 sensors.wheel.quiet=3.0
  plant.train.mass=200000.0 channel={"kind":"bernoulli","p":0.8} sensors.wheel.phase=[0.5,0.6]
"""
"""Bases and KEY=VALUE, the value as Python writes it; a line that begins by a space goes on."""


def test_kinds(expected: Callable[[str, str], None]) -> None:
    out, base, seen = list[str](), "", {name: set[str]() for name in BASES}
    for line in KINDS.strip().splitlines():
        words = line.split()
        base = base if line.startswith(" ") else words.pop(0)
        name, common = BASES[base]
        for word in words:
            key, _, value = word.partition("=")
            overrides = {**common, key: ast.literal_eval(value)}
            out.append(f"{name} {word}")
            try:
                scenario, variant = name.split("/")
                setting = load(scenario, overrides, variant).setting(variant)
                found = simulated(setting, Streams(6, scenario, variant, (2,)))
                world = setting.world(Streams(6, scenario, variant, (0, 1, 2)))
                start = [f"start {digest(world.initial_mean)}"]
                lines = [*columns_of(found.truth), *columns_of(found.measurements), *told(
                    setting.told({}, {}, world.initial_mean), world.step(0, world.initial_mean))]
            except (InputError, Unsupported) as error:
                lines, start = [str(error)], []
            more = [line for line in dict.fromkeys([*lines, *start]) if line not in seen[base]]
            out += [str(len(lines)), *(f"  {line.strip()}" for line in more)]
            seen[base].update(more)
    expected("kinds", "\n".join(out))

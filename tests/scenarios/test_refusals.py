"""What scenario files may say at the edge of what they may not: each line refused with its whole message, or accepted.

The answers are in `tests/expected/refusals.txt`."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from railstate.benchmarks.planning.naming import find_one
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError
from railstate.scenarios.railway.line import read_line, read_train

CASES = """
ningbo-metro plant.line.stops=[0.0,0.0] plant.line.stops=[100.0,50.0] plant.line.stops=[-5.0,1900.0]
  plant.line.speed_limits=[[0.0,0.0]] plant.line.speed_limits=[[0.0,22.0],[0.05,21.0]]
  plant.line.speed_limits=[[0.0,22.0],[0.1,21.0]] plant.line.speed_limits=[[0.0,22.0],[900.0,1.1]]
  plant.line.gradients=[[0.0,0.2]] plant.line.gradients=[[0.0,0.21]] plant.line.gradients=[[0.0,0.09]]
  plant.line.gradients=[[0.0,-0.15]] plant.loads=[200000.0,210000.0] plant.start_speed=30.0 plant.start_speed=0.0
  plant.train.max_speed=1.0 plant.controller.effort=[0.1,0.9] plant.controller.effort=[-1.0,0.0]
  plant.controller.overrun=0.0 disturbance.period=[60.0,15.0] disturbance.period=[15.0,15.0]
  disturbance.amplitude=[0.5,1.1] disturbance.amplitude=[1.0,1.0] disturbance.amplitude=[0.9,0.5]
  sensors.use=["accelerometer"] sensors.use=["speed","accelerometer"] sensors.use=["speed","balise"]
  disturbance.w_bar=0.0 channel={"kind":"delay","steps":[3,1]} channel={"kind":"delay","steps":[1,1]}
  faults=[{"kind":"jump","sensors":["position"],"size":3.0,"truth":True}]
  faults=[{"kind":"jump","sensors":["position"],"size":3.0,"truth":False}]
  faults=[{"kind":"stuck","sensors":["sonar"],"from":1.0,"to":2.0}]
  faults=[{"kind":"stuck","sensors":["speed"],"from":2.0,"to":2.0}]
  faults=[{"kind":"stuck","sensors":["speed"],"from":1.0,"to":2.0,"lasts":3.0}]
  faults=[{"kind":"student-t","sensors":["speed"],"dof":3.0,"told":True}]
  faults=[{"kind":"drift","sensors":["speed"],"rate":0.1},{"kind":"drift","sensors":["speed"],"rate":0.1}]
  sensors=5
ningbo-metro/aboard plant.balises={"positions":[0.0]} plant.balises={"positions":[0.1]}
  plant.balises={"positions":[1900.0]} plant.balises={"positions":[1899.9]} plant.balises={"positions":[]}
  sensors.use=["wheel-a","balise"] knowledge.odometry.motion="minmax" knowledge.odometry.motion="accelerometer"
  channel={"kind":"round-robin","nodes":[[0,1,2,3]]}
ningbo-metro knowledge.odometry.motion="wheel-a" knowledge.odometry.motion="minmax"
  channel={"kind":"round-robin","nodes":[[0],[1]]} channel={"kind":"round-robin","nodes":[[0],[1,2]]}
odometry plant.driver.asked=[-0.9,0.05] plant.driver.asked=[-0.9,0.0] plant.line.gradients=[[0.0,0.0],[8900.0,0.15]]
  plant.line.gradients=[[0.0,0.0],[8899.0,0.15]] channel={"kind":"round-robin","nodes":[[0,1,2]]}
  channel={"kind":"round-robin","nodes":[[0,1,2,3]]} plant.balises.platforms=[8884.0]
  plant.balises.positions=[10.0,12.0] plant.balises.positions=[10.0,11.9]
  plant.balises.every=500.0 plant.driver.asked=[0.0,0.8] plant.driver.asked=[-0.85,0.8] plant.driver.asked=[-0.86,0.8]
  plant.driver.courage=[1.0,0.9] plant.driver.dwell=[20.0,20.0] plant.tunnels=[[5.0,5.0]]
  plant.tunnels=[[5.0,9.0],[8.0,10.0]] plant.adhesion.friction=[0.0,0.1] plant.adhesion.friction=[0.1,0.05]
  plant.adhesion.friction=[0.05,0.05] plant.adhesion.strength=[-0.1,0.3] plant.line.gradients=[[0.0,0.15]]
  plant.adhesion=5 plant.tunnels=5
  sensors.use=["sonar"] requirements=[{"name":"a","form":"speed","points":[[0.0,1.0],[0.0,2.0]]}]
  requirements=[{"name":"a","form":"speed","points":[[0.0,1.0],[9.0,0.0]]}]
  requirements=[{"name":"a","form":"speed","points":[[0.0,1.0],[9.0,0.5]]}]
  requirements=[{"name":"a","form":"stop","within":1.0,"quantity":"scale"}]
  requirements=[{"name":"a","form":"stop","within":1.0},{"name":"a","form":"stop","within":2.0}]
cbtc-csma requirements=[{"name":"a","form":"allowance","constant":1.0,"share":0.1}]
  plant.commands=[{"start":1,"end":1.0,"middle":1.0}]
  plant.commands=[{"start":0,"end":1.0,"middle":1.0},{"start":0,"end":1.0,"middle":1.0}]
  plant.commands=[{"start":0,"end":1,"middle":1},{"start":5,"end":1,"middle":1},{"start":4,"end":1,"middle":1}]
  knowledge.trains=[5,2] knowledge.trains=[2,2]
  plant.cars=3 plant.masses=[1.0] plant.commands=[[1,0.5]] channel.trains=[5,2] channel.trains=[2,2]
  channel.traffic=constant headway.speeds=[65.0,65.5] channel={"kind":"try-once-discard","nodes":[[0],[0]]}
  channel={"kind":"random-access","nodes":[[0],[1]],"p":[0.5,0.6]}
  channel={"kind":"random-access","nodes":[[0]],"p":[0.5,0.5]}
  channel={"kind":"markov-random-access","nodes":[[0],[1]]}
  channel={"kind":"markov-random-access","nodes":[[0],[1]],"transition":[[0.5,0.5]]}
  channel={"kind":"markov-random-access","nodes":[[0],[1]],"transition":[[1.0,0.0],[0.0,1.0]]}
  channel={"kind":"markov-random-access","nodes":[[0],[1]],"transition":[[0.5,0.5],[0.5,0.6]]}
  channel={"kind":"markov-random-access","nodes":[[0],[1]],"stay":0.5}
  channel={"kind":"round-robin","nodes":[[0],[0]]} channel={"kind":"round-robin","nodes":[[0],[7]]}
moving-block plant.trains.stops=[[0,99],[0]] plant.trains.stops=[[1,0],[0]] plant.trains.start=[0.0,0.01]
  plant.trains.start=[99.0,0.0] sensors.tags.count=1 sensors.tags.count=400
  channel={"kind":"bernoulli","p":0.5,"silent":"hold"} channel={"kind":"try-once-discard"}
  channel={"kind":"delay","steps":1,"loss":{"kind":"bernoulli","p":0.5,"silent":"hold"}}
  channel={"kind":"round-robin","nodes":[[0,1],[2,3]]} channel={"kind":"round-robin","nodes":[[0,1],[2,3,4]]}
  plant.trains.start=[0.0,-4.941592653589793] plant.trains.start=[0.0,-4.941592653589792]
  plant.trains.start=[0.0,-0.5399999988] plant.trains.start=[0.0,-0.5399999992] plant.trains.start=[0.043,-0.496999999]
  plant.trains.top_speed=8.235987755982988 plant.trains.top_speed=8.23
  faults=[{"kind":"stuck","sensors":["x-a"],"from":1.0,"to":2.0}]
  faults=[{"kind":"student-t","sensors":["x-a"],"dof":3.0}]
  faults=[{"kind":"jump","sensors":["x-a"],"size":3.0,"truth":True}]
  faults=[{"kind":"stamps","sensors":["x-a"],"offset":0.1}]
braking-rate plant.target=[[0.0,1.0],[0.0,2.0]] knowledge.grid=[1.0,0.5,0.7] knowledge.grid=[1.0,1.0]
  channel={"kind":"round-robin","nodes":[[0],[1,2]]} channel={"kind":"round-robin","nodes":[[0],[1]]}
  knowledge.grid=[1.0,0.5] plant.rate_drift=-1.0 plant.target=[[1.0,1.0],[0.0,2.0]] time.steps=1 score.skip=150.0
  score.skip=149.0
braking-rate/static plant.rate_start=0.0 plant.rate_start=0.1 plant.rate_drift=-0.006
rap-example-1 knowledge.p=[0.5,0.5] knowledge.p=[0.5,0.6] plant.P0=[["k",0.0,0.0],[0.0,1.0,0.0],[0.0,0.0,1.0]]
  plant.A=[] plant.A=[1.0,0.0]
  plant.A=[[[1.0,0.0],[0.0,1.0]],[[1.0]]] plant.A=[[1.0,"x"],[0.0,1.0]] plant.A=[[1.0,True],[0.0,1.0]]
  plant.R=[[1.0,0.0],[0.0,1e-12]] plant.R=[[1.0,0.0],[0.0,1e-9]] plant.Q=[[-1e-12,0.0,0.0],[0.0,1.0,0.0],[0.0,0.0,1.0]]
  plant.Q=[[-1e-9,0.0,0.0],[0.0,1.0,0.0],[0.0,0.0,1.0]] plant.P0=[[0.0,0.0,0.0],[0.0,1.0,0.0],[0.0,0.0,1.0]]
  plant.P0=[[1.0,2e-10,0.0],[0.0,1.0,0.0],[0.0,0.0,1.0]] plant.P0=[[1.0,5e-11,0.0],[0.0,1.0,0.0],[0.0,0.0,1.0]]
  plant.states=["a","a"]
  plant.units=["m"] plant.x0=[0.0] plant.A=[[1.0]] plant.A=[[1.0,2.0],[3.0]] plant.A=[[1.0,"sin(k)"],[0.0,"1/k"]]
  plant.A=[[1.0,"open(k)"],[0.0,1.0]] plant.A=[[1.0,"9**9**9"],[0.0,1.0]] plant.A=[["",1.0],[0.0,1.0]]
  plant.P0=[[[1.0]],[[1.0]]] plant.Q=[[-1.0]] plant.R=[[0.0,0.0],[0.0,0.0]] plant.R=[[1.0,0.5],[0.4,1.0]]
  plant.states=["a","a","b"] plant.A=[[1.0,None],[0.0,1.0]] channel={"kind":"bernoulli","p":0.0}
  channel={"kind":"bernoulli","p":1.0} channel={"kind":"gilbert-elliott"}
recorded sensors.outage={"place":"windows"} sensors.outage={"place":"windows","windows":[[5.0,5.0]]}
  sensors.outage={"windows":[[5.0,6.0]],"sensors":[]}
"""
"""Lines of a setting and KEY=VALUE, the value as Python writes it; a line that begins by a space goes on."""


def cases() -> list[tuple[str, str]]:
    found, setting = list[tuple[str, str]](), ""
    for line in CASES.strip().splitlines():
        words = line.split()
        setting = setting if line.startswith(" ") else words.pop(0)
        found += [(setting, word) for word in words]
    return found


def _value(text: str) -> object:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def test_what_is_refused_and_what_is_not(expected: Callable[[str, str], None]) -> None:
    said = []
    for setting, case in cases():
        key, _, value = case.partition("=")
        said.append(f"{setting} {case}")
        try:
            scenario, variant = find_one(setting, {key: _value(value)})
            scenario.setting(variant)
            said.append("  accepted")
        except InputError as error:
            said += [f"  {line}" for line in str(error).splitlines()[:3]]
    expected("refusals", "\n".join(said))


TRACK: dict[str, Any] = {
    "stops": {"unit": "km", "values": [0, 1.3]},
    "speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 80], [650, 60]]},
    "gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0, 2]]}}
TRAIN: dict[str, Any] = {
    "mass": {"value": 200, "unit": "t"}, "rho": {"value": 6, "unit": "%"}, "max speed": {"value": 120, "unit": "km/h"},
    "max traction force": {"value": 200, "unit": "kN"}, "max reg braking force": {"value": 150, "unit": "kN"},
    "max pn braking force": {"value": 50, "unit": "kN"}, "max acceleration": {"value": 1.0, "unit": "m/s^2"},
    "max deceleration": {"value": 0.9, "unit": "m/s^2"}, "max traction power": {"value": 3, "unit": "MW"},
    "max reg braking power": {"value": 2, "unit": "MW"}, "rolling resistance r0": {"value": 2000, "unit": "N"},
    "rolling resistance r1": {"value": 30, "unit": "N/(km/h)"},
    "rolling resistance r2": {"value": 0.5, "unit": "N/(km/h)^2"}}
PARTS: tuple[object, ...] = (
    None, 7, {}, {"unit": "m"}, {"unit": 3, "values": [1], "value": 1}, {"unit": "ell", "values": [1], "value": 1},
    {"unit": "m", "values": []}, {"unit": "m", "values": [0, True]}, {"unit": "m", "values": [0, 2e15]},
    {"unit": "m", "values": [9, 3]}, {"unit": "t", "value": 0}, {"unit": "kg", "value": -5},
    {"unit": "kN", "value": "1"},
    {"units": {"position": "m"}, "values": [[0, 1]]}, {"units": {"position": "m", "velocity": "km/h", "slope": "%"}},
    {"units": {"position": "m", "velocity": "km/h", "slope": "%"}, "values": [[0, 1], [2]]},
    {"units": {"position": "m", "velocity": "m/s", "slope": "permil"}, "values": [[1, 30], [650, 20]]})
"""What may stand in place of an entry; None: it is left out."""


def test_lines_and_trains_in_files(tmp_path: Path, expected: Callable[[str, str], None]) -> None:
    """Whole, with one entry after the other replaced by each of what it may and may not be."""
    said = list[str]()

    def told(what: str, text: str, read: Callable[[str], object]) -> None:
        path = tmp_path / "file.json"
        path.write_text(text)
        try:
            said.append(f"{what}: {read(str(path))}")
        except ValueError as error:
            said.append(f"{what}: refused: {str(error).replace(str(path), 'FILE')}")

    for read, whole in ((read_line, TRACK), (read_train, TRAIN)):
        told(read.__name__, json.dumps(whole), read)
        for text in ("", "[]", "{}"):
            told(f"{read.__name__} {text}", text, read)
        for key in whole:
            for part in PARTS:
                changed = {name: value for name, value in {**whole, key: part}.items() if value is not None}
                told(f"{key} = {json.dumps(part)}", json.dumps(changed), read)
    expected("track-and-train-entries", "\n".join(said))


def test_parameters_one_at_a_time(expected: Callable[[str, str], None]) -> None:
    """Each parameter of each estimator by values that it may and may not have, the others at their defaults."""
    said = list[str]()
    for name, cls in sorted(estimators().items()):
        for field in cls.Parameters.model_fields:
            taken = dict[str, list[str]]()
            for value in (-1, 0, 0.5, 1, 2, 40, True, "no", [], [0.5], ["position"], [[0.9, 0.1], [0.5, 0.5]]):
                try:
                    cls.Parameters.model_validate({field: value})
                    word = "taken"
                except ValueError as error:
                    word = "; ".join(part["msg"] for part in error.errors())  # pyright: ignore
                taken.setdefault(word, []).append(json.dumps(value))
            said += [f"{name}.{field}: {word}: {' '.join(values)}" for word, values in taken.items()]
    expected("parameters", "\n".join(said))

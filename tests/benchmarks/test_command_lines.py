"""Command lines that are seldom or wrong: whatever each says, and how it ends, beside committed text (to renew it:
`tests/expected.py`). What a usual session says: `test_expected.py`."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.studies import complete

from ..conftest import Command
from .test_expected import CART, EXAMPLES, _timing

LINES = """
run cart.toml -e , : run cart.toml --set x : run cart.toml --set =3 : run cart.toml --set channel.p : run nobody
run cart.toml/calm --retry ok --out X : run cart.toml --retry , : run cart.toml --retry failed,crashed,odd
run cart.toml/calm -e kalman,nobody : run cart.toml/none : run cart.toml --set channel.p=1.5
run cart.toml --set a.b=1 : run cart.toml/calm --until rmse : run cart.toml/calm --until rmse:position=0%
run cart.toml/calm --until rmse:place=1% -j 1 -n 20 -e held
run cart.toml/calm --runs 1 --jobs 1 --out one -e kalman,held --keep 0
run cart.toml/calm --jobs 1 --runs 1 --out one -e kalman,held --keep 0 -q
run cart.toml/calm -n 3 -j 1 --out two -e kalman,held --keep 2 --batch 2 --json : run cart.toml --backend mpi
run cart.toml/calm -n 3 -j 1 --out one -e kalman --keep 2 -q
run cart.toml/calm -n 2 -j 1 --out one -e kalman --seed 2
run cart.toml/calm -n 2 -j 1 --out one -e kalman --seed 2 --overwrite : run cart.toml --jobs -1
run cart.toml --runs 0 : run cart.toml --batch -1 : run cart.toml --timeout 0 : run cart.toml --scheduler tcp://x:1
run cart.toml --memory -1 : run cart.toml --plugin none.py : run cart.toml --plugin cart.toml
run cart.toml --line none : run cart.toml --train none
run loose.toml/calm -n 6 -j 1 --out loose --plugin half.py -e half,wanders,raises,kalman
run recorded --recording none.csv : run recorded --recording tram.csv --map time : run recorded --map time=
run recorded --quality good : run recorded --without 1-2 : run recorded --without 5..x : run recorded --track none
compare A A : compare A kalman : compare kalman kalman : compare one A --fail-on worse
compare kalman held --scenario cart.toml/calm -n 4 -j 1 --out K : compare A two --json : compare A two --quiet
compare kalman held --scenario cart.toml/calm -n 4 -j 1 --out K --fail-on rmse:position>5% --fail-on worse --json
compare kalman held --scenario cart.toml/calm -n 4 -j 1 --out K --fail-on different
compare A two --fail-on different : compare A two --fail-on rmse:place>5% : compare A one --fail-on larger
compare two A --fail-on rmse:position>0.1% : verify A --rows 3 : verify one --rows 0 : verify loose --rows 2
verify loose --rows 2 --plugin half.py : verify none : replay cart/calm/kalman : replay cart/calm/kalman/x --out A
replay cart/calm/kalman/99 --out A : replay cart/calm/nobody/1 --out A : replay cart.toml/calm/kalman/1
replay cart/none/kalman/1 --out A : replay cart/calm/half/2 --out loose
replay cart/calm/wanders/2 --out loose --plugin half.py : show nobody : show kalman --set a=1
show cart.toml --set channel.p=0.25 : show cart.toml/rough : show cart.toml --set x : show half --plugin half.py
show ekf-known --out A : show kalman --out two : show cart.toml --set channel.q=1
design cart.toml/calm -e certified,ukf : design cart.toml/calm -e kalman : design cart.toml/calm -e nobody
design cart.toml/calm --plot x.svg : design cart.toml/calm --trade-off 2 : design cart.toml/calm --losses 0.5,0.9
design cart.toml/calm --trade-off 0.5,0.9,0.99 --plot t.svg : design cart.toml/calm --losses a
design rap-example-1 -e kalman,augmented-kalman : design cart.toml/calm --losses 0.9,0.6 --plot l.svg
certify cart.toml/calm --gain gain.csv : certify cbtc-csma --gain wide.csv : certify cart.toml/calm --gain none.csv
certify cart.toml/calm --gain text.csv : design cart.toml/calm -e certified --out D : design ningbo-metro --losses 0.5
design cart.toml/calm --theta 0.9 --delta 1 : inspect none.csv : inspect tram.csv --from 30 --to 60
inspect tram.csv --without 20..30 --without 50..60 : inspect tram.csv --map time=t_s,position=s_gnss_m,speed=v_kmh
inspect tram.csv --map time=t : inspect tram.csv --map speed : inspect tram.csv --missing -9999,NA --set order=sort
inspect tram.csv --set colour=1 : inspect tram.csv --to 0
inspect metro.csv --balises balises.csv --out my-metro.toml : inspect tram.csv --out no/where.toml
inspect fixes.csv --quality NARROW_INT=0.05,SINGLE=missing : inspect tram.csv --out "a trip.toml"
check nobody : check kalman --scenario ningbo-metro : check kalman --parameter gain=1
check ukf --scenario cart.toml/calm --parameter alpha=0.5 : check ukf --parameter alpha=-1 : check cart.toml
sweep cart.toml/calm --over channel.p : sweep cart.toml/calm --over channel.p= : sweep cart.toml --over =1
sweep cart.toml/calm --over channel.p=0.5,0.5 --over time.steps=5,9 -n 2 -j 1 -e kalman,held --out G --metric rmse:speed
sweep cart.toml/calm --over channel.p=0.5 --metric rmse:place -n 2 -j 1 --out G2 -e kalman
sweep cart.toml --over x=1 : tune cart.toml/calm --estimator held : tune cart.toml/calm --estimator kalman --over Q
tune cart.toml/calm --estimator nobody : tune cart.toml/calm --estimator ukf --over alpha=0:1
report A --published none.json : report none : report A --published cart.toml : report one --out page.html
plot A --figure nobody : plot A --entries nobody : plot A --quantities place : plot A --format gif : plot none
plot two --figure error-over-time --out P --format svg --width 5 --run 1 --entries held
plot two --run 2 --figure error-over-time : table A --format doc : table A --scenarios none : table A -e nobody
table A --quantities place : table none : table A --format csv --scenarios cart/calm --entries held,kalman
table A --format tex --out no/where.tex : table A --format html --out t.html : table loose --format md
reproduce --runs 1 : reproduce nobody : new estimator 3x : new estimator kalman : new estimator numpy --in new
new estimator mine --in none : new scenario cart : new estimator mine --in new : new estimator mine --in new
new recording --in new : new scenario rap-example-1 : nonsense
design cart.toml/calm --losses 0.5 --plot no/where.svg : design cart.toml/calm --trade-off 0.9 --plot no/where.svg
design cart.toml/calm -e certified --out gain.csv/x : new line --in none : new line --in new : new line --in new
compare kalman held --scenario cart.toml/calm -n 1 -j 1 --out K1 : show ckf --out two : timing --repeats 0
timing --processes 0 : timing --only nothing
tune cart.toml/calm --estimator ukf --over parameters.alpha=0.5..1 --objective rmse
tune cart.toml/calm --estimator ukf --over parameters.alpha=0.5..1 --objective rmse:position --budget 2
tune cart.toml/calm --estimator ukf --over parameters.alpha=0.5..1 --objective nees:state
tune cart.toml/calm --estimator ukf --over parameters.alpha=0.5..1 --objective mae:speed,log-likelihood:innovation
report A --published gain.csv : design cart.toml/calm --trade-off 0.5,2
"""
"""Separated by ` : ` and ends of lines."""


def _folder(name: str) -> str:
    """What a results folder holds: files, the columns of its tables, the manifest but for the machine."""
    out = list[str]()
    for path in sorted(Path(name).rglob("*")):
        about = ""
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
            about = f"{len(table)}: {' '.join(f'{column}={n}' for column, n in table.count().items())}"
            if "run" in table:
                about += f" {table.groupby(['estimator', 'run'], observed=True).size().to_dict()}"
        out.append(f"{path} {path.read_text().partition(chr(10))[0] if path.suffix == '.csv' else about}")
    told = {key: value for key, value in json.loads(Path(name, "manifest.json").read_text()).items()
            if key not in ("environment", "started", "finished", "railstate")}
    return re.sub(r"\b([0-9a-f]{8}){1,2}\b", "HASH", "\n".join([*out, json.dumps(told, indent=0)]))


def test_command_lines(railstate: Command, expected: Callable[[str, str], None],
                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(complete, "timing_table", _timing)
    Path("cart.toml").write_text(CART)
    Path("loose.toml").write_text(CART.replace("[variants.calm]", "\n".join([
        *(f'[estimators.{name}]\nplugin = "{name}"' for name in ("half", "wanders", "raises")), "[variants.calm]"])))
    for item in EXAMPLES.iterdir():
        Path(item.name).write_bytes(item.read_bytes())
    Path("new").mkdir()
    np.savetxt("gain.csv", [[0.5], [0.1]], delimiter=",")
    np.savetxt("wide.csv", np.ones((2, 2)), delimiter=",")
    Path("text.csv").write_text("a,b\n")
    known = "kalman,ukf,held,certified"
    assert railstate("run", "cart.toml/calm", "-n", 4, "-j", 1, "-q", "--out", "A", "-e", known).code == 0
    out = []
    for words in (part.split() if '"' not in part else shlex.split(part) for line in LINES.strip().splitlines()
                  for part in line.split(" : ")):
        done = railstate(*words)
        out += [f"$ railstate {' '.join(words)} # {done.code}", done.out, done.err]
    for path in map(Path, ("my-metro.toml", "t.svg", "l.svg", "t.html", "D/certified.csv", "P", "G/rmse-speed.svg")):
        out.append(f"{path} {path.exists()}")
    for name in ("A", "two"):
        out.append(_folder(name))
    out.append(json.dumps(json.loads(railstate("schema").out), indent=0)[:4000])
    expected("command-lines", "\n".join(out).replace(str(Path.cwd()), "."))

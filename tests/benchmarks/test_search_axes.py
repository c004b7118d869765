"""What is searched, as it is written on the command line: axes of every scale, and those that there are not."""

import pytest
from railstate.benchmarks.studies.search import Axis, parse_axis
from railstate.scenarios.errors import InputError


@pytest.mark.parametrize(("text", "message"), [
    ("disturbance.w_bar=0.1..1", "not the truth"), ("sigma_w=0.1..1", "not the truth"),
    ("knowledge.sigma_w", "expected KEY=LOW..HIGH"), ("knowledge.sigma_w=0.1", "expected KEY=LOW..HIGH"),
    ("knowledge.sigma_w=1..0.1", "expected KEY=LOW..HIGH"), ("knowledge.sigma_w=0..1:log", "LOW above 0"),
    ("parameters.stay=0.5..1:log1m", "HIGH below 1"), ("knowledge.sigma_w=0.1..1:cubic", "expected KEY=LOW..HIGH")])
def test_what_cannot_be_searched_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse_axis(text)


def test_axes_as_they_are_written():
    for text, found in {
            "parameters.a=1|2.5|true": Axis(("parameters.a",), scale="choice", choices=(1, 2.5, True)),
            "parameters.a=x|y": Axis(("parameters.a",), scale="choice", choices=("x", "y")),
            "augment.b.sd + knowledge.c=0.5..2": Axis(("augment.b.sd", "knowledge.c"), 0.5, 2.0, "linear"),
            "knowledge.c=1..2:log": Axis(("knowledge.c",), 1.0, 2.0, "log"),
            "knowledge.c=-1..0.5:log1m": Axis(("knowledge.c",), -1.0, 0.5, "log1m"),
            "parameters.n=1..9:int": Axis(("parameters.n",), 1, 9, "int")}.items():
        assert parse_axis(text) == found

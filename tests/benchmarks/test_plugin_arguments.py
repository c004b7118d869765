"""Odd words behind `--plugin` and odd things that a file does when it is imported: one message, or a run beside `ekf`.

Each kind is a line of a table: how the words are made, the exit code, and what is said of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from ..conftest import PLUGIN, Command
from .test_run import rows, same

HALF = PLUGIN.split("\n\nclass Raises")[0]
FIRST = "from railstate.estimators.interface import Estimator\n\n\nclass Old(Estimator):\n    def predict(self, u):\n" \
        "        pass\n\n    def update(self, y, received):\n        pass\n\n    def estimate(self):\n        pass\n"


def text(content: str | bytes, name: str = "half.py") -> Callable[[], list[str]]:
    """A file of this content."""
    def make() -> list[str]:
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return [name]

    return make


def act(line: str, name: str = "half.py") -> Callable[[], list[str]]:
    """A sound file that does something first."""
    return text(f"{line}\n{HALF}", name)


def words(*found: str) -> Callable[[], list[str]]:
    return lambda: list(found)


def linked(*names: str, to: str = "half.py") -> Callable[[], list[str]]:
    def make() -> list[str]:
        for name in names:
            os.symlink(to, name)
        return list(names)

    return make


def pipe() -> list[str]:
    os.mkfifo("pipe.py")
    return ["pipe.py"]


def twins() -> list[str]:
    return [*text(HALF, "a/half.py")(), *text(HALF, "b/half.py")()]


def helped() -> list[str]:
    text("GAIN = 1", "beside.py")()
    return act("import beside")()


Case = tuple[Callable[[], list[str]], str]
REFUSED: dict[str, Case] = {
    # the word
    "missing": (words("none.py"), "none.py: no such file; --plugin takes a Python file"),
    "nothing": (words(""), "no such file"),
    "a folder": (words("."), "no such file"),
    "without its ending": (words("half"), "half: no such file"),
    "module:Class": (words("half:Half"), "half:Half: no such file"),
    "file:Class": (words("half.py:Half"), "half.py:Half: no such file"),
    "a home": (words("~/half.py"), "no such file"),
    "a link to nothing": (linked("link.py", to="nothing.py"), "nothing.py: no such file"),
    "a link to itself": (linked("link.py", to="link.py"), "link.py: no such file"),
    "a pipe": (pipe, "pipe.py: no such file"),
    "a long name": (words(f"{'x' * 300}.py"), "no such file"),
    "another ending": (text(HALF, "half.txt"), "half.txt: not a Python file"),
    "no ending": (text(HALF, "filter"), "filter: not a Python file"),
    "a pickle": (text(b"\x80\x04odd", "half.pickle"), "cannot be handed to a process of its own: UnpicklingError"),
    # the name
    "two of one name": (twins, "an estimator named half is in"),
    "the suite's name": (text(HALF, "ekf.py"), "ekf.py: an estimator named ekf is installed already; rename the file"),
    "letters that are none": (text(HALF, "hälfte.py"), "hälfte.py: 'hälfte' is no name for an estimator"),
    "a space": (text(HALF, "my half.py"), "'my half' is no name for an estimator"),
    "a formula": (text(HALF, "=cmd().py"), "'=cmd()' is no name for an estimator"),
    "what steers": (text(HALF, "x\x1b[31m.py"), r"is no name for an estimator"),
    "a tab": (text(HALF, "x\ty.py"), r"'x\ty' is no name for an estimator"),
    "an option": (text(HALF, "./-half.py"), "'-half' is no name for an estimator"),
    "two classes of one name": (text(HALF + "\n\nclass HALF(Half):\n    pass\n"),
                                "'half' is no name for an estimator, or that of two"),
    "a class of other letters": (text(HALF + "\n\nclass Größe(Half):\n    pass\n"), "is no name for an estimator"),
    # the content
    "empty": (text(""), "half.py: holds no subclass of railstate.estimators.interface.Estimator"),
    "another's class": (text("from railstate.estimators.kalman import Kalman\n"), "holds no subclass"),
    "an abstract class": (text("from railstate.estimators.interface import Estimator\n\n\nclass X(Estimator):\n"
                               "    pass\n"), "holds no subclass"),
    "first edition": (text(FIRST), "half.py: "),
    "a syntax error": (text("class (:\n"), "half.py: does not import: SyntaxError: invalid syntax"),
    "no text": (text(b"\x00\x01\x02"), "half.py: does not import: SyntaxError: source code string cannot contain null"),
    "another encoding": (text("x = 'größe'\n".encode("latin-1")),
                         "half.py: does not import: SyntaxError: (unicode error)"),
    "deep": (text("x = " + "(" * 5000 + ")" * 5000), "half.py: does not import: "),
    "a package": (act("from . import other"), "does not import: ImportError: attempted relative import"),
    "a module that is missing": (act("import nowhere_to_be_found"), "ModuleNotFoundError: No module named 'nowhere_to"),
    # the import
    "leaves": (act("import sys; sys.exit(0)"), "half.py: does not import: SystemExit: 0"),
    "ends": (act("import os; os._exit(0)"), "half.py: cannot be imported: the process running it died (exit code 0)"),
    "kills itself": (act("import os, signal; os.kill(os.getpid(), signal.SIGKILL)"),
                     "half.py: cannot be imported: the process running it died (Killed)"),
    "crashes": (act("import ctypes; ctypes.string_at(0)"),
                "half.py: cannot be imported: the process running it died (Segmentation fault)"),
    "interrupts": (act("raise KeyboardInterrupt"), "half.py: does not import: KeyboardInterrupt: "),
    "raises another": (act("raise type('Odd', (BaseException,), {})('x\\x1b[31m' * 10_000)"),
                       r"half.py: does not import: Odd: x\x1b[31mx"),
    "raises what cannot be said": (act("class Odd(Exception):\n    def __str__(self): 1 / 0\nraise Odd"), "half.py: "),
    "takes memory": (act("x = bytearray(10 ** 15)"), "half.py: does not import: MemoryError: "),
    "patches builtins": (act("import builtins; builtins.len = lambda x: 7"),
                         "half.py: cannot be imported: the process running it answered nonsense"),
    "says nonsense": (text(f"{HALF}\n\nHalf.claims = 7\n"), "half.py: "),
    "has no words": (text(f"{HALF}\n\nclass Odd:\n    __str__ = None\n\n\nHalf.summary = Odd()\n"), "half.py: "),
}
RUN: dict[str, Callable[[], list[str]]] = {
    "twice": words("half.py", "half.py"),
    "twice, in two ways": words("half.py", "./half.py"),
    "a link": linked("other.py", to="half.py"),
    "a link and what it leads to": lambda: ["half.py", *linked("other.py", to="half.py")()],
    "a dash": text(HALF, "my-half.py"),
    "an underscore": text(HALF, "my_half.py"),
    "a mark": text(b"\xef\xbb\xbf" + HALF.encode()),
    "ends of lines": text(HALF.replace("\n", "\r\n")),
    "its own encoding": text(f"# coding: latin-1\n# größe\n{HALF}".encode("latin-1")),
    "a helper": helped,
    "prints": act("import sys; print('odd' * 1000); print('odd', file=sys.stderr)"),
    "closes outputs": act("import sys; sys.stdout.close(); sys.stderr = None"),
    "goes elsewhere": act("import os; os.chdir('/')"),
    "empties the environment": act("import os, sys; os.environ.clear(); sys.path.clear()"),
    "patches the suite": act("from railstate.estimators.kalman import ExtendedKalman; ExtendedKalman.update = None"),
    "writes to the registry": act("from railstate.estimators import registry\n"
                                  "registry.estimators()['ekf'] = registry.estimators()['direct']"),
    "patches numpy": act("import numpy; numpy.array = numpy.asarray = None") ,
    "starts threads": act("import threading, time\nfor _ in range(20):\n"
                          "    threading.Thread(target=time.sleep, args=(99,)).start()"),
    "leaves a process": act("import os, time\nif not os.fork():\n    time.sleep(99)\n    os._exit(0)"),
    "is slow": act("import time; time.sleep(11)"),
    "warns": act("import warnings; warnings.warn('old')"),
    "says too much": text(f"{HALF}\n\nHalf.summary = Half.source = Half.__doc__ = Half.family = 'x' * 10 ** 5\n"),
    "says half letters": text(f"{HALF}\n\nHalf.summary = '\\ud800'\n"),
    "says what steers": text(f"{HALF}\n\nHalf.summary = '\\x1b[31m<script>'\n"),
    "ends badly": act("import atexit, os; atexit.register(os.abort)"),
}


HARMED = ("patches numpy", "empties the environment")
"""Those that may lose their own rows."""


def test_there_are_enough() -> None:
    assert len(REFUSED) + len(RUN) >= 44


def test_what_cannot_be_used_is_one_message(railstate: Command) -> None:
    wrong = {}
    for number, (name, (make, expected)) in enumerate(REFUSED.items()):
        os.makedirs(f"{number}")
        os.chdir(f"{number}")
        Path("cart.toml").write_bytes((railstate.folder / "cart.toml").read_bytes())
        given = make()
        try:
            done = railstate("run", "cart.toml/calm", "-e", "ekf", "--runs", 2, "--out", "out",
                             *(word for one in given for word in ("--plugin", one)))
            told = (done.code, done.err, done.out)
        except Exception as error:
            told = (-1, repr(error), "")
        if (told[0] != 2 or expected not in told[1] or len(told[1].splitlines()) != 1 or len(told[1]) > 6000 or told[2]
                or "\x1b" in told[1] or not told[1].startswith("error: ") or Path("out").exists()):
            wrong[name] = told[0], told[1][:300]
        os.chdir("..")
    assert not wrong, "\n".join(f"{name}: {what}" for name, what in wrong.items())


@pytest.mark.long
def test_what_is_odd_and_sound_runs_beside_others(railstate: Command) -> None:
    common = ("run", "cart.toml/calm", "--runs", 2, "--jobs", 1, "--keep", 0)
    assert railstate(*common, "-e", "ekf", "--out", "alone").code == 0
    alone, wrong = rows("alone"), {}
    for number, (name, make) in enumerate(RUN.items()):
        os.makedirs(f"{number}")
        os.chdir(f"{number}")
        for file in ("cart.toml", "half.py"):
            Path(file).write_bytes((railstate.folder / file).read_bytes())
        Path("half.py").write_text(HALF)
        given = make()
        label = Path(given[-1]).resolve().stem.replace("_", "-")
        try:
            done = railstate(*common, "-e", f"ekf,{label}", *(word for one in given for word in ("--plugin", one)),
                             "--timeout", 10, "--out", "out")
            assert done.code == 0, done.err
            found = rows("out")
            theirs = found[found["estimator"] != "ekf"]
            told = theirs[["status", "reason"]].to_numpy().tolist()
            assert len(theirs) == 2 and (name in HARMED or (theirs["status"] == "ok").all()), told
            same(alone, found[found["estimator"] == "ekf"].reset_index(drop=True).astype(alone.dtypes.to_dict()))
            assert "odd" not in done.out
        except Exception as error:
            wrong[name] = repr(error)[:500]
        os.chdir("..")
    assert not wrong, "\n".join(f"{name}: {what}" for name, what in wrong.items())


def test_an_import_without_an_end_is_one_message(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    from railstate.benchmarks.planning import catalogue

    monkeypatch.setattr(catalogue, "IMPORT", 0.3)
    act("import time; time.sleep(999)")()
    done = railstate("run", "cart.toml/calm", "-e", "ekf", "--plugin", "half.py", "--runs", 2)
    assert done.code == 2 and done.err == "error: half.py: cannot be imported: did not finish within 0.3 s\n"

"""Machine code is never older than its source, wherever the helper stands, and there is a place for it."""

from __future__ import annotations

import fcntl
import gc
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from railstate.scenarios import machine_code

HELPER = ("from railstate.scenarios.machine_code import njit\n\n@njit(cache=True)\ndef helper(x):\n    return x + {}\n")
CALLER = ("from railstate.scenarios.machine_code import njit\n\nfrom .helper import helper\n\n@njit(cache=True)\n"
          "def caller(x):\n    return helper(x)\n")
PARTS = ("from railstate.scenarios.machine_code import njit\n\n@njit(cache=True, inner=True)\ndef half(x):\n"
         "    return x / 2\n\n@njit(cache=True, inner=True)\ndef over(x):\n    return 1 / x\n")
WHOLE = ("from railstate.scenarios.machine_code import njit\n\nfrom .parts import half, over\n\n@njit(cache=True)\n"
         "def whole(x):\n    return half(x) + over(x)\n")
MAIN = """
from small.caller import caller
from small.alone import alone
print(caller(1.0), len(caller.stats.cache_hits), len(alone.stats.cache_hits) if alone(1.0) else None)
"""
PLUGIN = ("from railstate.estimators.kernels import tile_width\nfrom numba import njit\n\n@njit(cache=True)\n"
          "def width(n):\n    return tile_width(n, n)\n")


def run(folder: Path, code: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True,
                          env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")})
    return done.stdout.split()


def test_what_uses_an_edited_helper_in_another_file_is_compiled_anew_and_nothing_else(tmp_path: Path) -> None:
    package = tmp_path / "small"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(CALLER)
    (package / "helper.py").write_text(HELPER.format("1.0"))
    (package / "alone.py").write_text(HELPER.format("1.0").replace("helper", "alone"))
    assert run(tmp_path, MAIN) == ["2.0", "0", "0"]
    assert run(tmp_path, MAIN) == ["2.0", "1", "1"]
    (package / "helper.py").write_text(HELPER.format("41.0"))
    assert run(tmp_path, MAIN) == ["42.0", "0", "1"]


def test_a_part_is_compiled_with_the_kernels_that_use_it(tmp_path: Path) -> None:
    """Two of one signature are told apart, from the cache as well, also by a kernel that is new; what a part raises is
    raised; Python has no way in."""
    package = tmp_path / "small"
    package.mkdir()
    for name, text in (("__init__", ""), ("parts", PARTS), ("first", WHOLE), ("second", WHOLE)):
        (package / f"{name}.py").write_text(text)
    for name, hits in (("first", ["0", "0"]), ("first", ["1", "0"]), ("second", ["0", "1"])):
        code = (f"from small.{name} import half, whole\nprint(whole(4.0), *(len(each.stats.cache_hits) for each "
                "in (whole, half)))\ntry: whole(0.0)\nexcept ZeroDivisionError: print('zero')\n"
                "try: half(1.0)\nexcept TypeError as error: print(str(error).replace(' ', '-'))")
        assert run(tmp_path, code) == ["2.25", *hits, "zero", "half-is-called-from-compiled-code-alone"]


def test_two_processes_do_not_compile_the_same(tmp_path: Path) -> None:
    (tmp_path / "alone.py").write_text(HELPER.format("1.0"))
    code = "from alone import helper; helper(1.0); print(len(helper.stats.cache_hits))"
    both = [subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, text=True,
                             env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}) for _ in range(2)]
    assert sorted(process.communicate(timeout=120)[0].strip() for process in both) == ["0", "1"]


def test_who_compiles_first_says_so_once(capfd: pytest.CaptureFixture[str]) -> None:
    with machine_code.told("compiling"):
        machine_code._tell()
        machine_code._tell()
    machine_code._tell()
    assert capfd.readouterr().err.count("compiling") == 1


def test_a_plug_ins_kernels_are_kept_where_any_edit_of_the_suite_counts(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(PLUGIN)
    code = "import mine; mine.width(3); print(len(mine.width.stats.cache_hits))"
    assert run(tmp_path, code) == ["0"]
    assert run(tmp_path, code) == ["1"]
    assert len(list((tmp_path / "cache" / "railstate").glob("plug-ins-*/*/mine.width-*.nbi"))) == 1


def test_the_key_is_that_of_what_is_compiled(tmp_path: Path) -> None:
    package = tmp_path / "small"
    package.mkdir()
    (package / "kernel.py").write_text("from ..machine_code import njit\nfrom .constants import HALF\n")
    (package / "constants.py").write_text("HALF = 0.5\n")
    (package / "words.py").write_text("HELLO = 'hello'\n")

    def key() -> str:
        machine_code._text.cache_clear()
        return machine_code.key(package / "kernel.py")

    before = key()
    (package / "words.py").write_text("HELLO = 'good day'\n")
    assert key() == before
    (package / "constants.py").write_text("HALF = 0.25\n")
    assert key() != before


def test_the_first_place_that_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file in the way of the user's cache stands for a HOME that cannot be written, for any user."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert machine_code.place("kernel", "0") == tmp_path / "home" / ".cache" / "railstate" / "kernel-0"
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    temporary = tmp_path / "temporary" / f"railstate-{os.getuid()}" / "railstate"
    assert machine_code.place("kernel", "0") == temporary / "kernel-0"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "given"))
    assert machine_code.place("kernel", "0") == tmp_path / "given" / "railstate" / "kernel-0"


def test_old_versions_are_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for name in ("another-00", *(f"kernel-{number:02d}" for number in range(20))):
        folder = tmp_path / "railstate" / name
        folder.mkdir(parents=True)
        used = int(name[-2:]) * 7 % 20
        os.utime(folder, (used, used))
    assert machine_code.place("kernel", "now") == tmp_path / "railstate" / "kernel-now"
    names = sorted(path.name for path in (tmp_path / "railstate").iterdir())
    last = sorted(range(20), key=lambda number: number * 7 % 20)[12:]
    assert names == ["another-00", *(f"kernel-{number:02d}" for number in sorted(last)), "kernel-now"]


def test_what_a_module_is_compiled_from(tmp_path: Path) -> None:
    """Relative imports at the top, however they are written, and what these import in turn; each once."""
    inner = tmp_path / "suite" / "inner"
    inner.mkdir(parents=True)
    files = {"inner/top": "from . import beside, missing\nfrom .beside import a\nfrom ..other import (\n    b,\n"
                          "    deep,\n)\nimport os\n    from .hidden import c\n",
             "inner/beside": "from .top import d\n", "inner/hidden": "",
             "other/__init__": "from .deep import b\n", "other/deep": "from ..far.away import e\n",
             "far/away": "", "far/__init__": "", "inner/__init__": ""}
    for name, text in files.items():
        path = tmp_path / "suite" / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    found = [str(path.relative_to(tmp_path / "suite")) for path in machine_code.closure(inner / "top.py")]
    assert found[0] == "inner/top.py" and sorted(found) == [
        "far/away.py", "inner/__init__.py", "inner/beside.py", "inner/top.py", "other/__init__.py", "other/deep.py"]
    at = machine_code.__file__
    kernels = Path(at).parents[1] / "estimators" / "kernels"
    under = machine_code.closure(kernels / "riccati.py")
    assert Path(at) not in under and kernels / "factors.py" in under


def test_one_process_at_a_time_has_a_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (machine_code._Lock(tmp_path / "kernel") for _ in range(2))

    def free() -> bool:
        fd = os.open(tmp_path / "kernel.lock", os.O_RDWR)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        finally:
            os.close(fd)
        return True

    one.__enter__()
    held = one._file
    one.__enter__()  # in itself: nobody waits
    assert one._file == held >= 0 and not free()
    assert (tmp_path / "kernel.lock").stat().st_mode & 0o777 == 0o600
    monkeypatch.setattr(machine_code, "PATIENCE", 0.05)
    other.__enter__()  # too long: goes on without
    other.__exit__()
    assert not free()
    one.__exit__()
    assert free() and (one._file, other._file) == (-1, -1)
    one.__exit__()
    for nowhere in (None, tmp_path / "none" / "kernel"):
        with machine_code._Lock(nowhere) as nothing:
            assert nothing is None


class Kept:
    """A cache in numba's form."""

    def __init__(self, *found: str | None) -> None:
        self.found, self.saved = list(found), list[tuple[str, str]]()

    def load_overload(self, signature: str, target: str) -> str | None:
        return self.found.pop(0)

    def save_overload(self, signature: str, data: str) -> None:
        self.saved.append((signature, data))
        if data == "bad":
            raise OSError


@pytest.mark.parametrize(("found", "locked", "told"), [
    (("code",), False, 0), ((None, "code"), False, 0), ((None, None), True, 1)])
def test_who_finds_nothing_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: tuple[str | None, ...],
                                    locked: bool, told: int) -> None:
    said = list[int]()
    monkeypatch.setattr(machine_code, "_tell", lambda: said.append(1))
    shared = machine_code._Shared(kept := Kept(*found), tmp_path / "kernel")
    assert shared.load_overload("f8", "cpu") == found[-1] and not kept.found and shared.found == []
    assert (shared._lock._file >= 0) == locked and len(said) == told
    for data in ("good", "bad"):
        with pytest.raises(OSError) if data == "bad" else nullcontext():
            shared.save_overload("f8", data)
        assert shared._lock._file == -1
        shared._lock.__enter__()
    shared._lock.__exit__()
    assert kept.saved == [("f8", "good"), ("f8", "bad")]


def test_nothing_is_collected_while_a_kernel_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[bool]()
    monkeypatch.setattr(machine_code.CPUDispatcher, "compile", lambda self, sig: seen.append(gc.isenabled()) or 1 / sig)
    kernel = machine_code.njit()(lambda x: x)
    assert gc.isenabled() and kernel.compile(2) == 0.5 and gc.isenabled()
    with pytest.raises(ZeroDivisionError):
        kernel.compile(0)
    assert gc.isenabled()
    gc.disable()
    try:
        kernel.compile(2)
        assert not gc.isenabled()
    finally:
        gc.enable()
    assert seen == [False] * 3

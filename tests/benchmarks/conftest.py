"""What several tests of the benchmarks read and none changes."""

from __future__ import annotations

import pytest
from railstate.benchmarks.telling.figures.data import Results, load_results

from ..synthetic_results import write_results


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """A written folder of rows without a run; its report may be written anew."""
    return load_results(write_results(tmp_path_factory.mktemp("results") / "run"))

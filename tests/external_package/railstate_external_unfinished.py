"""An estimator whose package cannot be imported: it must cost a warning and nothing else."""

import a_library_nobody_has_installed


class HalfFinished(a_library_nobody_has_installed.Filter):
    """Never reached."""

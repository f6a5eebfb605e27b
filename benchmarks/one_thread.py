"""One thread for BLAS, whatever the environment says: several would measure the machine's load."""

from __future__ import annotations

import os
import sys

from dlsc_qbs_ros.cli.spread import ONE_THREAD


def start_again_in_one_thread() -> None:
    """Start the program again where more are allowed: BLAS reads that as numpy is imported."""
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ONE_THREAD})

"""The code keeps ROS 2's own style: its linters find nothing."""

from pathlib import Path
import shutil
import subprocess

import pytest

ROOT = Path(__file__).parent.parent
LINTED = ('dlsc_qbs_ros', 'test', 'launch', 'scripts', 'benchmarks', 'setup.py')


@pytest.mark.parametrize('linter', ['ament_flake8', 'ament_pep257'])
def test_a_linter_finds_nothing(linter):
    executable = shutil.which(linter)
    if executable is None:
        pytest.skip(f'{linter} is not installed')
    done = subprocess.run(
        [executable, *(name for name in LINTED if (ROOT / name).exists())],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, '\n'.join(
        line for line in done.stdout.splitlines() if not line.startswith(('checking ', '* ')))

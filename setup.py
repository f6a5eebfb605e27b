"""All but the kernel stands in setup.cfg, where both colcon-core and colcon-ros read it."""

import os
from pathlib import Path
import shlex
import subprocess
from zlib import crc32

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.develop import develop

KERNEL = Path('dlsc_qbs_ros', 'core', '_kernel.c')
# Not -ffast-math: it would change the arithmetic of the whole process that loads the library.
FLAGS = ('-O3', '-fno-math-errno', '-fno-trapping-math', '-fno-signed-zeros', '-fassociative-math',
         '-shared', '-fPIC')


def build_kernel():
    """Compile the kernel beside its source; without a compiler, numpy does its work."""
    library = KERNEL.with_suffix('.so')
    compiler = shlex.split(os.environ.get('CC', 'cc'))
    source = f'-DSOURCE_CRC={crc32(KERNEL.read_bytes())}u'
    try:
        library.unlink(missing_ok=True)
        subprocess.run([*compiler, *FLAGS, source, KERNEL, '-o', library, '-lm'], check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f'the package goes without its compiled kernel: {error}')


def with_kernel(command):
    """Return a command of setuptools that compiles the kernel first."""
    def run(self):
        build_kernel()
        command.run(self)
    return type(command.__name__, (command,), {'run': run})


cmdclass = {command.__name__: with_kernel(command) for command in (build_py, develop)}
setup(cmdclass=cmdclass)

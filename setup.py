"""Everything stands in setup.cfg, where both colcon-core and colcon-ros read it."""

from setuptools import setup

setup()

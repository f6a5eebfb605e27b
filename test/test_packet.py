"""The packet: what power view cells have to move it."""

from math import exp

import numpy as np
import pytest

from dlsc_qbs_ros.config import PoseCellsConfig
from dlsc_qbs_ros.pipeline.packet import Packet

CONFIG = PoseCellsConfig(injection=0.3, active_decay=1.0)


def energies(n):
    """Return what a view cell that is met n times without a rest has power for."""
    packet = Packet(CONFIG)
    packet.add_view_cell()
    return [packet.spend(0) for _ in range(n)]


def test_a_view_that_is_met_again_and_again_loses_its_power():
    assert energies(2) == [
        pytest.approx(0.3 * (30.0 - exp(1.2 * decay)) / 30.0) for decay in (1.0, 2.0)]


def test_a_drone_that_hovers_over_one_view_for_long_spends_nothing_more():
    with np.errstate(all='raise'):
        assert energies(1000)[2:] == pytest.approx([0.0] * 998)

"""Where view cells stand in a row: what lies between them by the odometry."""

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import IDENTITY, Pose2
from dlsc_qbs_ros.pipeline.stations import Stations
from dlsc_qbs_ros.pipeline.visits import Visits

CONFIG = Config().ratslam
STEP = Pose2(0.3, 0.0, 0.0)


def stations(events, step=STEP):
    """
    Return the stations of view cells that visits made, and those of the same cells restored.

    Of the events, a step each, 'n' makes a cell, 'o' meets the oldest place, '.' passes by and
    '|' breaks the odometry.
    """
    visits = Visits()
    made = Stations(visits, CONFIG)
    cells = []
    for event in events:
        if event == '|':
            visits.odometry.cut()
            continue
        visits.odometry.move(step, 0.3)
        if event == 'n':
            visits.create(visits.pose() if cells else IDENTITY)
            cells.append(len(visits.birth.values) - 1)
            made.add(cells[-1])
        elif event == 'o':
            visits.add(0, IDENTITY, 1)
    again = Stations(visits, CONFIG)
    again.restore(np.array(cells))
    np.testing.assert_array_equal(again.of_cells.values, made.of_cells.values)
    return made.of_cells.values.tolist()


def test_cells_made_in_a_row_stand_in_a_row():
    assert stations('nnnn') == [0, 1, 2, 3]


@pytest.mark.parametrize('between', ['ooooo', '.....'], ids=['older_cells_met', 'views_missing'])
def test_there_is_room_for_what_is_not_there(between):
    assert stations(f'nnnnnn{between}nn') == [0, 1, 2, 3, 4, 5, 11, 12]


def test_on_the_spot_and_after_a_break_there_is_none():
    assert stations('nnn' + 'o' * 30 + 'nn', step=IDENTITY) == [0, 1, 2, 3, 4]
    assert stations('nnn.....|nn') == [0, 1, 2, 3, 4]


def test_there_is_no_more_room_than_no_run_reaches_over():
    n = CONFIG.sequence_length
    assert stations('nnnn' + 'o' * 300 + 'n')[-1] == 3 + 1 + 2 * n

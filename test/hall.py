"""The simulated hall, for the tests of what flies in it."""

import numpy as np

from dlsc_qbs_ros.sim import world


def assert_clear_of_walls_and_shelves(x, y):
    """Check that a path, in metres, comes near no wall and no shelf."""
    clear_m = 0.5
    assert x.min() > clear_m and x.max() < world.HALL_M[0] - clear_m
    assert y.min() > clear_m and y.max() < world.HALL_M[1] - clear_m
    west, east = world.SHELF_X_M
    for south, north in world.SHELF_Y_M:
        outside_m = np.hypot(np.maximum.reduce((west - x, x - east, 0 * x)),
                             np.maximum.reduce((south - y, y - north, 0 * y)))
        assert outside_m.min() > clear_m

"""A small flight round a circle for the tests of the pipeline: quick, seeded, free of ROS."""

from concurrent.futures import Future
from math import cos, pi, sin

import numpy as np

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Frame, OdometrySample, Pose2, RawOdometry

START_NS = 1_700_000_000_000_000_000
RADIUS_M = 2.0
SPEED_M_S = 1.0
LAP_S = 2 * pi * RADIUS_M / SPEED_M_S

# Small enough for a flight in a blink; a lap is long enough to be met again.
CONFIG = Config().override({
    'encoder.input': 'image', 'encoder.n_atoms': 16, 'view.width': 16, 'view.height': 12,
    'pose_cells.size_xy': 11, 'ratslam.sequence_length': 4, 'ratslam.min_age_s': 5.0})


def pose_at(time_s, yaw_bias_rad_s=0.0):
    """Return where the flight is; a bias bends what odometry believes."""
    rate = SPEED_M_S / RADIUS_M + yaw_bias_rad_s
    yaw_rad, radius_m = rate * time_s, SPEED_M_S / rate
    return Pose2(radius_m * sin(yaw_rad), radius_m * (1 - cos(yaw_rad)),
                 (yaw_rad + pi) % (2 * pi) - pi)


def panorama(seed):
    """Return smooth random wallpaper, uint8 of shape (24, 480), seamless from left to right."""
    noise = np.fft.rfft2(np.random.default_rng(seed).normal(size=(24, 480)))
    rows, columns = np.fft.fftfreq(24)[:, None], np.fft.rfftfreq(480)[None]
    smooth = np.fft.irfft2(noise * np.exp(-60 * rows ** 2 - 400 * columns ** 2), (24, 480))
    return np.interp(smooth, (smooth.min(), smooth.max()), (0, 255)).astype(np.uint8)


def stamp_ns(time_s):
    """Return the stamp of a time of the flight."""
    return START_NS + round(time_s * 1e9)


def frames(seconds, seed=0, period_s=0.1, phase_s=0.007):
    """Return what the camera saw: a window of the wallpaper that goes round once a lap."""
    wall = panorama(seed)
    wall = np.concatenate([wall, wall], axis=1)
    made = []
    for time_s in np.arange(phase_s, seconds, period_s).tolist():
        column = round(time_s / LAP_S * 480) % 480
        made.append(Frame(stamp_ns(time_s), wall[:, column:column + 120]))
    return made


def odometry(seconds, yaw_bias_rad_s=0.02, period_s=0.02):
    """Return what odometry believes, as raw samples without a twist."""
    return [RawOdometry(OdometrySample(stamp_ns(time_s), pose_at(time_s, yaw_bias_rad_s)),
                        float('nan'), float('nan'), float('nan'))
            for time_s in np.arange(0.0, seconds, period_s).tolist()]


def events(seconds, seed=0):
    """Return frames and odometry in stamp order."""
    return sorted([*frames(seconds, seed), *odometry(seconds)],
                  key=lambda event: getattr(event, 'sample', event).stamp_ns)


class LateExecutor:
    """Does what is submitted when it is told to."""

    def __init__(self):
        self._tasks = []

    def submit(self, task, *args):
        """Note a task and return its future."""
        self._tasks.append((Future(), task, args))
        return self._tasks[-1][0]

    def complete(self):
        """Do all that was submitted; return whether there was anything."""
        tasks, self._tasks = self._tasks, []
        for future, task, args in tasks:
            if future.set_running_or_notify_cancel():
                future.set_result(task(*args))
        return bool(tasks)

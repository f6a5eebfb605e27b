"""What the turns that views tell make of the error of the odometry's yaw rate."""

from __future__ import annotations

from math import exp, inf, sqrt

import numpy as np

from ..config import OdometryConfig

# Deviation of the focal length, as a share of the nominal one.
FOCAL_SIGMA = 0.3
# Of the turns that views tell: a constant error, in rad/s, what adds up in a second, and a share
# of the turn.
VISUAL_SIGMA_RAD_S, VISUAL_NOISE, TURN_SHARE = 0.003, 0.006, 0.15
# The errors of neighbouring pixels go together, and those of successive views, of near things to
# one side: the deviation is so many times what the pixels of one pair tell.
TOGETHER = 6.0
# An error of odometry stays about what it is for so long.
STEADY_S = 300.0
# For so long, the noise is taken for what is configured; then for what it was in as much time.
NOISE_S = 2.0
NOISE_MEMORY_S = 20.0
# Times the nominal focal length, or a share of it as small: what would need more is no lens, but a
# camera that looks elsewhere.
LARGEST_SCALE = 2.5
# More deviations than these are an outlier, of one pair of views,
OUTLIER = 3.0
# and no error of an odometry that is believed to have errors of that deviation.
LARGEST_ERROR = 3.0
# What is left after the error was taken out wanders: it is as much noise as that which is seen.
LEFT = 1.5


class YawRateError:
    """
    A Kalman filter of the error of the odometry's yaw rate, and of the camera's focal length.

    A turn by odometry is y = scale * s + error * dt + noise, with s the turn as views tell it at
    the nominal focal length. How large the noise is, is told by how far the turns are off.
    """

    def __init__(self, config: OdometryConfig):
        self._config = config
        self._state = np.array([1.0, 0.0])
        self._covariance = np.diag([FOCAL_SIGMA ** 2, 0.0])
        self.restart()

    def reconfigure(self, config: OdometryConfig) -> None:
        """Go on with the odometry; one of other deviations is another."""
        known, self._config = self._config, config
        if (config.yaw_bias_rad_s, config.yaw_noise) != (known.yaw_bias_rad_s, known.yaw_noise):
            self.restart()

    def state(self) -> np.ndarray:
        """Return what `restore` takes, (6,)."""
        return np.array([*self._state, *np.diag(self._covariance), self._seen, self._seen_s])

    def restore(self, state: np.ndarray) -> None:
        """Go on from what `state` returned; how lens and error go together, is yet to be told."""
        self._state, self._covariance = state[:2].copy(), np.diag(state[2:4])
        self._seen, self._seen_s = state[4:].tolist()

    def restart(self) -> None:
        """Begin with another odometry; the camera stays."""
        self.age(inf)
        self._seen = (self._config.yaw_noise ** 2 + VISUAL_NOISE ** 2) * NOISE_S
        self._seen_s = NOISE_S

    @property
    def scale(self) -> float:
        """Return the nominal focal length over the true one, as far as that may be a lens."""
        return min(max(float(self._state[0]), 1.0 / LARGEST_SCALE), LARGEST_SCALE)

    @property
    def is_told(self) -> bool:
        """Whether the views agree with some lens, and with odometry but for a small error."""
        scale, error = self._state.tolist()
        return scale == self.scale and abs(error) < LARGEST_ERROR * self._config.yaw_bias_rad_s

    def rad_s(self) -> float:
        """
        Return the error, too much to the left; 0 where it is not told.

        What may be an error of the views alone is none of the odometry: that of a compass stays.
        """
        error = float(self._state[1])
        if not self.is_told or abs(error) <= VISUAL_SIGMA_RAD_S:
            return 0.0
        return error - VISUAL_SIGMA_RAD_S ** 2 / error

    def yaw_noise(self) -> float:
        """Return the noise of the odometry, in rad/sqrt(s), as far as it is less than believed."""
        told = LEFT * sqrt(self._seen / self._seen_s) if self.is_told else inf
        return min(told, self._config.yaw_noise)

    def age(self, seconds: float) -> None:
        """Let time pass, with views or without."""
        keep = exp(-seconds / STEADY_S)
        self._state[1] *= keep
        self._covariance[1] *= keep
        self._covariance[:, 1] *= keep
        self._covariance[1, 1] += (1.0 - keep ** 2) * self._config.yaw_bias_rad_s ** 2

    def update(self, turn_rad: float, visual_rad: float, sigma_rad: float, seconds: float) -> None:
        """
        Take in a turn by odometry, and the same as views tell it with the nominal focal length.

        Parameters
        ----------
        turn_rad, visual_rad : float
            To the left.
        sigma_rad : float
            Deviation of the second, if the errors of the pixels were independent.
        seconds : float
            How long it took.

        """
        by_state = np.array([visual_rad, seconds])
        noise = self._seen / self._seen_s
        variance = (noise * seconds + (TURN_SHARE * self.scale * visual_rad) ** 2
                    + (TOGETHER * sigma_rad) ** 2)
        spread = self._covariance @ by_state
        innovation = turn_rad - by_state @ self._state
        total = variance + by_state @ spread
        limit = OUTLIER * np.sqrt(total)
        self._state += spread * (np.clip(innovation, -limit, limit) / total)
        self._covariance -= np.outer(spread, spread) / total
        # What this pair makes of the noise, as far as it is that by which the turns differ.
        share = noise * seconds / total
        seen = noise * (1.0 + share * (min(innovation ** 2 / total, OUTLIER ** 2) - 1.0))
        fade = exp(-seconds / NOISE_MEMORY_S)
        self._seen_s = fade * self._seen_s + seconds
        self._seen = fade * self._seen + max(seen, VISUAL_NOISE ** 2) * seconds

"""When a drone flies, stands, turns round and climbs, and when the lights go down."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from .variations import ALTITUDE_M, Variations

BRAKE_S = 2.0
TURN_S = 5.0
CLIMB_S = 4.0
DIM_S = 1.5

REVERSED_LAPS = (1.0, 2.0)
PAUSE_LAPS = 1.25


def ramp(share: np.ndarray) -> np.ndarray:
    """Rise smoothly from 0 at 0 to 1 at 1, half a cosine; constant before and after."""
    return (1.0 - np.cos(pi * np.clip(share, 0.0, 1.0))) / 2.0


def _ramp_integral(share: np.ndarray) -> np.ndarray:
    """Return the integral of `ramp` from 0."""
    rising = np.clip(share, 0.0, 1.0)
    return (rising - np.sin(pi * rising) / pi) / 2.0 + np.maximum(share - 1.0, 0.0)


def lamps(times_s: np.ndarray, dimmed_to: float) -> np.ndarray:
    """Return the share of the hall's lamps that is on: `dimmed_to` in the second half."""
    return 1.0 - (1.0 - dimmed_to) * ramp((times_s - times_s[-1] / 2) / DIM_S)


@dataclass(frozen=True)
class Stop:
    """Brake from `brake_s` on for BRAKE_S, stand and turn, speed up again for BRAKE_S."""

    brake_s: float
    stand_s: float
    turn_rad: float

    @property
    def cost_s(self) -> float:
        """Return by how much a flight is longer for it: each BRAKE_S still counts half."""
        return self.stand_s + BRAKE_S

    def standing(self, times_s: np.ndarray) -> np.ndarray:
        """Return 0 in full flight and 1 at a stand; what the speed lacks, as a share."""
        since = (times_s - self.brake_s) / BRAKE_S
        return ramp(since) - ramp(since - self.cost_s / BRAKE_S)

    def lost_s(self, times_s: np.ndarray) -> np.ndarray:
        """Return the integral of `standing`: the time not spent flying so far."""
        since = (times_s - self.brake_s) / BRAKE_S
        return BRAKE_S * (_ramp_integral(since) - _ramp_integral(since - self.cost_s / BRAKE_S))

    def turned_rad(self, times_s: np.ndarray) -> np.ndarray:
        """Return how far the drone has turned on the spot."""
        return self.turn_rad * ramp((times_s - self.brake_s - BRAKE_S) / self.stand_s)


class Schedule:
    """
    The time-table of a flight: what its variations do, at any time.

    Events have their places in the time in flight, `flown_s`, of which a lap takes `lap_s` and a
    stop nothing: wherever the drone stops, it climbs and turns where it would have.
    """

    def __init__(self, lap_s: float, variations: Variations):
        self.lap_s = lap_s
        self._variations = variations
        stands = {laps: (TURN_S, pi) for laps in REVERSED_LAPS if variations.reversed_lap}
        if variations.pause_s:
            stands[PAUSE_LAPS] = (variations.pause_s, 0.0)
        self._stops: list[Stop] = []
        for laps, (stand_s, turn_rad) in sorted(stands.items()):
            self._stops.append(Stop(laps * lap_s + self.stopped_s - BRAKE_S / 2,
                                    stand_s, turn_rad))

    @property
    def stopped_s(self) -> float:
        """Return the time that all stops take."""
        return sum(stop.cost_s for stop in self._stops)

    @property
    def extra_s(self) -> float:
        """Return the time that a flight needs for its stops and for a lap unlike the others."""
        unlike = self._variations.reversed_lap or self._climb_m != 0.0
        return self.stopped_s + self.lap_s * unlike

    @property
    def complete_s(self) -> float:
        """Return the time at which all that makes the flight vary has happened once."""
        varied = self._variations
        asked = ((self._climb_m != 0.0, self.lap_s + CLIMB_S),
                 (varied.reversed_lap, REVERSED_LAPS[-1] * self.lap_s),
                 (varied.pause_s > 0.0, PAUSE_LAPS * self.lap_s))
        return max((at_s for is_asked, at_s in asked if is_asked), default=0.0) + self.stopped_s

    @property
    def _climb_m(self) -> float:
        return self._variations.second_altitude_m - ALTITUDE_M

    def flown_s(self, times_s: np.ndarray) -> np.ndarray:
        """Return the time in flight, which passes more slowly the slower the drone is."""
        return times_s - sum(stop.lost_s(times_s) for stop in self._stops)

    def course_s(self, times_s: np.ndarray) -> np.ndarray:
        """Return the time in flight, less what is flown the other way round."""
        flown_s = self.flown_s(times_s)
        if not self._variations.reversed_lap:
            return flown_s
        start_s, end_s = (laps * self.lap_s for laps in REVERSED_LAPS)
        return flown_s - 2.0 * np.clip(flown_s - start_s, 0.0, end_s - start_s)

    def standing(self, times_s: np.ndarray) -> np.ndarray | float:
        """Return 0 in full flight and 1 at a stand."""
        return sum(stop.standing(times_s) for stop in self._stops)

    def turned_rad(self, times_s: np.ndarray) -> np.ndarray | float:
        """Return by how much the camera is turned from the loop's tangent, not wrapped."""
        return sum(stop.turned_rad(times_s) for stop in self._stops)

    def altitude_m(self, times_s: np.ndarray) -> np.ndarray:
        """Return the height: it changes in the first CLIMB_S of each lap but the first."""
        lap, into_lap_s = np.divmod(self.flown_s(times_s), self.lap_s)
        changed = ramp(into_lap_s / CLIMB_S)
        changed = np.where(lap % 2 == 1, changed, (1.0 - changed) * (lap > 0))
        return ALTITUDE_M + self._climb_m * changed
